// advect_level, first of three: a(x) = phi(x - dt u), semi-Lagrangian with the midpoint rule (equation in the twin,
// reference/advect_level.rs), and the departure points. Beyond open sides the level is at least the distance to them.
// Cells at rest with no liquid around stay. One thread per quad of the band.
// level, step. band_args, band_list: the band. velocity: faces, m/s (velocity_quads: the same). distances: liquid distance at cell centres, m, that
// of air outside the band. flags: see active. next_level: a, cells. departures: see departure_words.
#import departure_words
#import dispatch
#import falling
#import lanes
#import layout
#import level_origin
#import sample_distance
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> velocity: array<f32>;
@group(0) @binding(5) var<storage, read> velocity_quads: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> distances: array<f32>;
@group(0) @binding(7) var<storage, read> flags: array<u32>;
@group(0) @binding(8) var<storage, read_write> next_level: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read_write> departures: array<vec4<u32>>;

// Distance from which no liquid is around a cell that could fall into it, cells.
const FAR = 4.0;

// Lanes with a face that moves.
fn moving_lanes(quad: u32) -> vec4<bool> {
    let still = vec4<f32>();
    let x = velocity_quads[quad] != still;
    let y = level.quads + quad;
    let z = 2u * level.quads + quad;
    return x | vec4<bool>(x.yzw, velocity_quads[quad + 1u].x != 0.0)
        | (velocity_quads[y] != still) | (velocity_quads[y + level.stride_y] != still)
        | (velocity_quads[z] != still) | (velocity_quads[z + level.stride_z] != still);
}

@compute @workgroup_size(WG_SIZE)
fn advect_level(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let first = quad_cell(level, quad);
    let cell = 4u * quad;
    var phi = step.inv_dx * vec4<f32>(distances[cell], distances[cell + 1u], distances[cell + 2u], distances[cell + 3u]);
    var words = (vec4<u32>(cell) + vec4<u32>(0u, 1u, 2u, 3u)) | vec4<u32>(KEEPS | AT_SIDE);
    let inside = lanes_inside(first, vec3<i32>(level.cells));
    var moves = lane_bits(inside & (moving_lanes(quad) | (phi < vec4<f32>(FAR))));
    let falls = falling(quad, first) >> 12u;
    while moves != 0u {
        let l = firstTrailingBit(moves);
        moves &= moves - 1u;
        let at = vec3<f32>(first) + vec3<f32>(f32(l), 0.0, 0.0) + 0.5;
        let origin = level_origin(at, velocity_in(cell + l));
        let beyond = beyond_side(origin);
        phi[l] = step.inv_dx * sample_distance(origin).x;
        let within = all(origin >= vec3<f32>(0.5)) && all(origin < vec3<f32>(level.cells) - 0.5);
        words[l] = centres_around(origin).low | select(AT_SIDE, 0u, within) | select(0u, FALLS, (falls >> l & 1u) != 0u);
        if beyond > 0.0 {
            phi[l] = max(phi[l], beyond);
            words[l] |= KEEPS;
        }
    }
    next_level[quad] = phi;
    departures[quad] = words;
}
