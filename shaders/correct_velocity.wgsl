// advect_velocity by MacCormack's method (Selle et al. 2008), after carry_velocity: u*(x) = a(x) + (u(x) - a(x + dt u)) / 2
// where this is within the range of the taps of a(x), else limited (see the twin). With cut cells u are the blended velocities.
// One thread per quad of the band and its 12 minus faces. a is 0 outside the band.
// level, step, level_step. band_args, band_list, band_flags: the band. velocity: faces, m/s (velocity_quads: the same).
// carried_velocity: a, m/s. velocity_next: departure points as words of carry_velocity in, u* out, m/s.
#import advect_quad
#import corner
#import departure_words
#import dispatch
#import fall
#import lanes
#import layout
#import level_step
#import step
#import trace

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> band_flags: array<u32>;
@group(0) @binding(5) var<storage, read> velocity: array<f32>;
@group(0) @binding(6) var<storage, read> velocity_quads: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> carried_velocity: array<f32>;
@group(0) @binding(8) var<storage, read_write> velocity_next: array<vec4<f32>>;
@group(0) @binding(9) var<uniform> level_step: LevelStep;

// Overshoot of a relaxed limit beyond the taps, over their range.
const OVERSHOOT = 0.5;
// Courant number up to which the relaxation is 1. From there it falls to 0 at twice this.
const RELAXED = 1.5;

// a of faces of an axis by their index within its section, m/s.
fn carried(section: u32, face: u32) -> f32 {
    return select(0.0, carried_velocity[section + face], band_flags[face / 4u] != 0u);
}

fn sample_carried(section: u32, corner: Corner) -> f32 {
    let points = corner_points(corner);
    let near = points[0];
    let far = points[1];
    return mix_points(
        vec4<f32>(carried(section, near.x), carried(section, near.y), carried(section, near.z), carried(section, near.w)),
        vec4<f32>(carried(section, far.x), carried(section, far.y), carried(section, far.z), carried(section, far.w)),
        corner.f,
    );
}

// Smallest and largest velocity at the faces around a position, m/s.
fn range_at(section: u32, corner: Corner) -> vec2<f32> {
    let points = corner_points(corner);
    let near = points[0] + section;
    let far = points[1] + section;
    return range_of(
        vec4<f32>(velocity[near.x], velocity[near.y], velocity[near.z], velocity[near.w]),
        vec4<f32>(velocity[far.x], velocity[far.y], velocity[far.z], velocity[far.w]),
    );
}

// u* of a face by its index, at a position with its velocity. word: see departure_words.
fn corrected(axis: u32, face: u32, word: u32, at: vec3<f32>, here: vec3<f32>) -> f32 {
    let section = 4u * axis * level.quads;
    var end = traced(at, here, step.dt * step.inv_dx);
    if (word & FALLS) != 0u {
        end += fall();
    }
    let first_order = carried_velocity[face];
    let result = first_order + 0.5 * (velocity[face] - sample_carried(section, faces_around(axis, end)));
    let range = range_at(section, corner_of(word & LOWEST_POINT, face_tops(axis)));
    if range.x <= result && result <= range.y {
        return result;
    }
    let relaxation = clamp(2.0 - level_step.courant / RELAXED, 0.0, 1.0);
    if relaxation == 0.0 {
        return first_order;
    }
    let beyond = relaxation * OVERSHOOT * (range.y - range.x);
    return mix(first_order, clamp(result, range.x - beyond, range.y + beyond), relaxation);
}

fn advect(axis: u32, quad: u32, cell: vec3<i32>, u: vec4<f32>, v: vec4<f32>, w: vec4<f32>) {
    let here = axis * level.quads + quad;
    let words = bitcast<vec4<u32>>(velocity_next[here]);
    var moves = lane_bits(words != vec4<u32>());
    var result = vec4<f32>();
    while moves != 0u {
        let l = firstTrailingBit(moves);
        moves &= moves - 1u;
        result[l] = corrected(axis, 4u * here + l, words[l], face_at(axis, cell, l), vec3<f32>(u[l], v[l], w[l]));
    }
    velocity_next[here] = result;
}

@compute @workgroup_size(WG_SIZE)
fn correct_velocity(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index < band_args[3] {
        advect_quad(band_list[index]);
    }
}
