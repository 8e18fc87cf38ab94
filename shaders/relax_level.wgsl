// redistance, last: one relaxation step of the mixed level f (equations in the twin, reference/redistance.rs). Cells in
// bodies keep their level. One thread per quad of the band; outside it there is air.
// level, step. band_args, band_list, band_flags: the band. valid, occupied: see level_cells. solid_distance: m. mixed: f,
// cells. new_level: cells, in place.
#import dispatch
#import layout
#import lanes
#import level_cells
#import quad_rooms
#import quad_sides
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> band_flags: array<u32>;
@group(0) @binding(5) var<storage, read> valid: array<u32>;
@group(0) @binding(6) var<storage, read> occupied: array<u32>;
@group(0) @binding(7) var<storage, read> mixed: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> new_level: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read> solid_distance: array<vec4<f32>>;

// The constants of reference/redistance.rs.
// Level within which it is relaxed, cells.
const NEAR = 2.5;
// Step of the relaxation, cells.
const STEP = 0.4;
// Gradients of interface cells that stay; at kinks only the upper limit holds.
const LEAST_GRADIENT = 0.7;
const LARGEST_GRADIENT = 1.4;
// Slope below which the interface is hidden behind a body.
const LEAST_SLOPE = 0.5;
// Steepness of both sides of a kink, and of a slope to a cell of a body that counts.
const STEEP = 0.1;

fn values(quad: u32) -> vec4<f32> {
    return select(vec4<f32>(REACH), mixed[quad], band_flags[quad] != 0u);
}
fn value(cell: u32) -> f32 {
    return select(REACH, mixed[cell / 4u][cell % 4u], band_flags[cell / 4u] != 0u);
}

// Whether a cell is at a kink: one-sided slopes of opposite sign along an axis, both steep.
fn at_kink(cell: u32) -> bool {
    let here = value(cell);
    var found = false;
    for (var axis = 0u; axis < 3u; axis++) {
        let low = here - value(across(cell, axis, 0u));
        let high = value(across(cell, axis, 1u)) - here;
        found |= low * high < 0.0 && min(abs(low), abs(high)) > STEEP;
    }
    return found;
}

// Differences of four cells to the minus and to the plus side along an axis.
struct Slopes {
    low: vec4<f32>,
    high: vec4<f32>,
}

fn kinks(s: Slopes) -> vec4<bool> {
    return (s.low * s.high < vec4<f32>()) & (min(abs(s.low), abs(s.high)) > vec4<f32>(STEEP));
}

// The slope along an axis for |grad f|: the central one where both one-sided ones agree in sign, else the largest.
fn steepness(s: Slopes) -> vec4<f32> {
    let central = 0.5 * abs(s.low + s.high);
    let largest = max(max(abs(s.low), abs(s.high)), central);
    return select(largest, central, s.low * s.high > vec4<f32>());
}

// The slope along an axis for |grad f| of Godunov. way: 1 outside liquid, -1 inside.
fn upwind(s: Slopes, way: vec4<f32>) -> vec4<f32> {
    return max(max(way * s.low, vec4<f32>()), -min(way * s.high, vec4<f32>()));
}

// Whether that slope is a steep one to a cell of a body. bodies: sides to such cells. axis: 0, 1 or 2.
fn upwind_in_body(s: Slopes, way: vec4<f32>, bodies: u32, axis: u32) -> vec4<bool> {
    let low = max(way * s.low, vec4<f32>());
    let high = max(-way * s.high, vec4<f32>());
    let side = select(side_lanes(bodies, 2u * axis + 1u), side_lanes(bodies, 2u * axis), low >= high);
    return side & (max(low, high) > vec4<f32>(STEEP));
}

fn lengths(x: vec4<f32>, y: vec4<f32>, z: vec4<f32>) -> vec4<f32> {
    return vec4<f32>(length(vec3<f32>(x.x, y.x, z.x)), length(vec3<f32>(x.y, y.y, z.y)),
        length(vec3<f32>(x.z, y.z, z.z)), length(vec3<f32>(x.w, y.w, z.w)));
}

// Lanes with liquid as bits.
fn liquid(phi: vec4<f32>) -> u32 {
    return lane_bits(phi < vec4<f32>());
}

@compute @workgroup_size(WG_SIZE)
fn relax_level(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let phi = mixed[quad];
    let open_lanes = bit_lanes(rooms(quad));
    let near = open_lanes & (abs(phi) < vec4<f32>(NEAR));
    if !any(near) {
        new_level[quad] = select(new_level[quad], phi, open_lanes);
        return;
    }
    let sides = cells_across(quad);
    let y = vec2<u32>(quad - level.stride_y, quad + level.stride_y);
    let z = vec2<u32>(quad - level.stride_z, quad + level.stride_z);
    let before = select(phi, vec4<f32>(value(4u * quad - 1u), phi.xyz), side_lanes(sides, 0u));
    let after = select(phi, vec4<f32>(phi.yzw, value(4u * quad + 4u)), side_lanes(sides, 1u));
    let below = select(phi, values(y.x), side_lanes(sides, 2u));
    let above = select(phi, values(y.y), side_lanes(sides, 3u));
    let behind = select(phi, values(z.x), side_lanes(sides, 4u));
    let front = select(phi, values(z.y), side_lanes(sides, 5u));
    let along_x = Slopes(phi - before, after - phi);
    let along_y = Slopes(phi - below, above - phi);
    let along_z = Slopes(phi - behind, front - phi);
    let around = liquid(before) | liquid(after) << 4u | liquid(below) << 8u | liquid(above) << 12u
        | liquid(behind) << 16u | liquid(front) << 20u;
    // Neighbours across the interface.
    let differs = (around ^ liquid(phi) * 0x111111u) & rooms_beside(quad);
    let halves = differs | differs >> 12u;
    let at_interface = bit_lanes(halves | halves >> 4u | halves >> 8u);
    let way = select(vec4<f32>(1.0), vec4<f32>(-1.0), phi < vec4<f32>());
    let gradient = lengths(upwind(along_x, way), upwind(along_y, way), upwind(along_z, way));
    let m = lengths(steepness(along_x), steepness(along_y), steepness(along_z));
    let interface_lanes = near & at_interface;
    let steep = lane_bits(interface_lanes & (m >= vec4<f32>(LARGEST_GRADIENT)));
    let kept = (m > vec4<f32>(LEAST_GRADIENT)) | kinks(along_x) | kinks(along_y) | kinks(along_z);
    // Interface cells that change unless a neighbour across is at a kink.
    var changed = lane_bits(interface_lanes & !kept);
    var faces = differs & changed * 0x111111u;
    let strides = vec3<u32>(1u, 4u * level.stride_y, 4u * level.stride_z);
    while faces != 0u {
        let face = firstTrailingBit(faces);
        faces &= faces - 1u;
        let stride = strides[face / 8u];
        let cell = 4u * quad + face % 4u;
        if at_kink(select(cell - stride, cell + stride, (face / 4u & 1u) != 0u)) {
            changed &= ~(1u << (face % 4u));
        }
    }
    let of_bodies = solid_distance[min(quad, arrayLength(&solid_distance) - 1u)];
    let bodies = sides & ~rooms_beside(quad);
    let hidden = ((gradient < vec4<f32>(LEAST_SLOPE)) & (of_bodies < vec4<f32>(step.dx))) | upwind_in_body(along_x, way, bodies, 0u)
        | upwind_in_body(along_y, way, bodies, 1u) | upwind_in_body(along_z, way, bodies, 2u);
    let away = select(phi, phi - STEP * way * (gradient - 1.0), near & !at_interface & !hidden);
    let relaxed = select(away, phi - STEP * (phi - phi / max(m, vec4<f32>(1e-9))), bit_lanes(changed | steep));
    new_level[quad] = select(new_level[quad], relaxed, open_lanes);
}
