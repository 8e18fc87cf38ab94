// write_back: u = u* - (phi_+ - phi_-) on every open face with an active side (thesis 4.36), phi = p dt / (rho dx).
// Across the free surface, and on open sides of the domain, the missing phi is 0 and the difference is divided by the
// matrix's theta. Other faces are 0 and not valid. One thread per quad of the band.
// level, step. band_args, band_list: the band. flags: see active. velocity_next: u*, faces, m/s. liquid_distance: m.
// potential: phi, m/s. velocity: u, m/s. valid: see valid; in place.
#import dispatch
#import layout
#import lanes
#import step
#import real
#import ghost_fluid
#import valid

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> flags: array<u32>;
@group(0) @binding(5) var<storage, read> velocity_next: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> liquid_distance: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> potential: array<Real4>;
@group(0) @binding(8) var<storage, read_write> velocity: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read_write> valid: array<u32>;

// Projection data of a quad of cells.
struct Cells {
    inside: vec4<bool>,
    phi: vec4<f32>,
    potential: Real4,
}

fn cells(quad: u32) -> Cells {
    return Cells(bit_lanes(flags[quad]), liquid_distance[quad], potential[quad]);
}

// Lanes whose minus face along an axis is on an open side of the domain.
fn on_open_side(axis: u32, quad: u32) -> vec4<bool> {
    if step.open_sides == 0u {
        return vec4<bool>(false);
    }
    let cell = quad_cell(level, quad);
    let along = select(vec4<i32>(cell[axis]), vec4<i32>(cell.x) + LANES, axis == 0u);
    return along == vec4<i32>() | along == vec4<i32>(i32(level.cells[axis]));
}

// phi_+ - phi_- across the faces between two quads of cells, m/s. Beyond a side of the domain the mirror image.
fn differences(minus: Cells, plus: Cells, update: vec4<bool>, on_side: vec4<bool>) -> Real4 {
    let one = vec4<f32>(1.0);
    var theta = one;
    let surface = update & (minus.inside != plus.inside);
    if any(surface) {
        for (var l = 0u; l < 4u; l++) {
            if surface[l] {
                let inside = select(plus.phi[l], minus.phi[l], minus.inside[l]);
                let outside = select(minus.phi[l], plus.phi[l], minus.inside[l]);
                theta[l] = ghost_theta(inside, select(outside, -inside, on_side[l]), step.theta_floor);
            }
        }
    }
    let high = select(Real4(), plus.potential, plus.inside);
    let low = select(Real4(), minus.potential, minus.inside);
    return (high - low) / Real4(theta);
}

fn update_faces(axis: u32, quad: u32, update: vec4<bool>, minus: Cells, plus: Cells) {
    let here = axis * level.quads + quad;
    let u = Real4(velocity_next[here]) - differences(minus, plus, update, on_open_side(axis, quad));
    velocity[here] = select(vec4<f32>(), vec4<f32>(u), update);
}

@compute @workgroup_size(WG_SIZE)
fn write_back(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let own = flags[quad] & 15u;
    let sides = vec3<u32>(
        own | (own << 1u & 15u) | (flags[quad - 1u] >> 3u & 1u),
        own | (flags[quad - level.stride_y] & 15u),
        own | (flags[quad - level.stride_z] & 15u));
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
        let minus = Cells(
            vec4<bool>(before.inside.w, here.inside.xyz), shift_up(before.phi, here.phi),
            Real4(before.potential.w, here.potential.xyz));
        update_faces(0u, quad, bit_lanes(update), minus, here);
    }
    if (update >> 4u & 15u) != 0u {
        update_faces(1u, quad, bit_lanes(update >> 4u), cells(quad - level.stride_y), here);
    }
    if (update >> 8u & 15u) != 0u {
        update_faces(2u, quad, bit_lanes(update >> 8u), cells(quad - level.stride_z), here);
    }
}
