// write_back: u = u* - (phi_+ - phi_-) on every open face with an active side (thesis 4.36), phi = p dt / (rho dx).
// Across the free surface, and on open sides of the domain, the missing phi is 0 and the difference is divided by the
// matrix's theta. Other faces are 0 and not valid. One thread per quad of the band.
// A cell with liquid beside an open face is active.
// level, settings. band_args, band_list: the band. open: apertures. velocity_next: u*, faces, m/s. liquid_distance: m.
// potential: phi, m/s. velocity: u, m/s. valid: see valid; in place.
#import dispatch
#import layout
#import lanes
#import real
#import ghost_fluid
#import valid

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> settings: ActiveSettings;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> open: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> velocity_next: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> liquid_distance: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> potential: array<Real4>;
@group(0) @binding(8) var<storage, read_write> velocity: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read_write> valid: array<u32>;

// Projection data of a quad of cells.
struct Cells {
    phi: vec4<f32>,
    potential: Real4,
}

fn cells(quad: u32) -> Cells {
    return Cells(liquid_distance[quad], potential[quad]);
}

// Lanes whose minus face along an axis is on an open side of the domain.
fn on_open_side(axis: u32, quad: u32) -> vec4<bool> {
    if settings.open_sides == 0u {
        return vec4<bool>(false);
    }
    let cell = quad_cell(level, quad);
    let along = select(vec4<i32>(cell[axis]), vec4<i32>(cell.x) + LANES, axis == 0u);
    return along == vec4<i32>() | along == vec4<i32>(i32(level.cells[axis]));
}

// phi_+ - phi_- across the faces between two quads of cells, m/s. Beyond a side of the domain the mirror image.
fn differences(minus: Cells, plus: Cells, update: vec4<bool>, here: u32, on_side: vec4<bool>) -> Real4 {
    let liquid = array(minus.phi < vec4<f32>(), plus.phi < vec4<f32>());
    var theta = vec4<f32>(1.0);
    let surface = update & (liquid[0] != liquid[1]);
    if any(surface) {
        let aperture = open[here];
        for (var l = 0u; l < 4u; l++) {
            if surface[l] {
                let inside = min(minus.phi[l], plus.phi[l]);
                let outside = max(minus.phi[l], plus.phi[l]);
                let floor = face_theta_floor(settings, aperture[l]);
                theta[l] = ghost_theta(inside, select(outside, -inside, on_side[l]), floor);
            }
        }
    }
    let high = select(Real4(), plus.potential, liquid[1]);
    let low = select(Real4(), minus.potential, liquid[0]);
    return (high - low) / Real4(theta);
}

fn update_faces(axis: u32, quad: u32, update: vec4<bool>, minus: Cells, plus: Cells) {
    let here = axis * level.quads + quad;
    let u = Real4(velocity_next[here]) - differences(minus, plus, update, here, on_open_side(axis, quad));
    velocity[here] = select(vec4<f32>(), vec4<f32>(u), update);
}

@compute @workgroup_size(WG_SIZE)
fn write_back(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let phi = liquid_distance[quad];
    let own = lane_bits(phi < vec4<f32>());
    let sides = vec3<u32>(
        own | lane_bits(shift_up(liquid_distance[quad - 1u], phi) < vec4<f32>()),
        own | lane_bits(liquid_distance[quad - level.stride_y] < vec4<f32>()),
        own | lane_bits(liquid_distance[quad - level.stride_z] < vec4<f32>()));
    let word = valid[quad];
    let update = (sides.x | sides.y << 4u | sides.z << 8u) & (word >> OPEN);
    valid[quad] = (word & ~VALID) | update;
    for (var axis = 0u; axis < 3u; axis++) {
        if (update >> (4u * axis) & 15u) == 0u {
            velocity[axis * level.quads + quad] = vec4<f32>();
        }
    }
    if update == 0u {
        return;
    }
    let here = cells(quad);
    if (update & 15u) != 0u {
        let before = cells(quad - 1u);
        let minus = Cells(shift_up(before.phi, here.phi), Real4(before.potential.w, here.potential.xyz));
        update_faces(0u, quad, bit_lanes(update), minus, here);
    }
    if (update >> 4u & 15u) != 0u {
        update_faces(1u, quad, bit_lanes(update >> 4u), cells(quad - level.stride_y), here);
    }
    if (update >> 8u & 15u) != 0u {
        update_faces(2u, quad, bit_lanes(update >> 8u), cells(quad - level.stride_z), here);
    }
}
