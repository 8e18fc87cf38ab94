// advect_velocity by MacCormack's method, first: a(x) = u(x - dt u), semi-Lagrangian (see face_departure), and the departure points.
// One thread per quad of the band and its 12 minus faces.
// level, step. band_args, band_list: the band. velocity: faces, m/s (velocity_quads: the same). flags: see active.
// carried_velocity: a, m/s. departures: see departure_words, 0 for faces at rest; lowest points around the departure points plus NUDGE.
#import advect_quad
#import departure_words
#import dispatch
#import face_departure
#import falling
#import lanes
#import layout
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> velocity: array<f32>;
@group(0) @binding(5) var<storage, read> velocity_quads: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> flags: array<u32>;
@group(0) @binding(7) var<storage, read_write> carried_velocity: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> departures: array<vec4<u32>>;

// Cells. Departure points are often on the border between two sets of taps, where a rounding must not choose.
const NUDGE = 0.0009765625;

// See falling.
var<private> falls: u32;

fn advect(axis: u32, quad: u32, cell: vec3<i32>, u: vec4<f32>, v: vec4<f32>, w: vec4<f32>) {
    var moves = lane_bits(moving(axis, cell, u, v, w));
    var result = vec4<f32>();
    var words = vec4<u32>();
    while moves != 0u {
        let l = firstTrailingBit(moves);
        moves &= moves - 1u;
        let at = face_at(axis, cell, l);
        let origin = departure(at, vec3<f32>(u[l], v[l], w[l]));
        result[l] = sample_corner(axis, faces_around(axis, origin));
        words[l] = faces_around(axis, origin + NUDGE).low | select(0u, FALLS, (falls >> (4u * axis + l) & 1u) != 0u);
    }
    let here = axis * level.quads + quad;
    carried_velocity[here] = result;
    departures[here] = words;
}

@compute @workgroup_size(WG_SIZE)
fn carry_velocity(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index < band_args[3] {
        let quad = band_list[index];
        falls = falling(quad, quad_cell(level, quad));
        advect_quad(quad);
    }
}
