// advect_level, last of three: phi*(x) = a(x) + (phi(x) - a(x + dt u)) / 2 where this is within the range of the taps of
// a(x), widened by OVERSHOOT, else a(x); MacCormack's method (Selle et al. 2008). Departures beyond open sides, and cells at rest, keep a.
// One thread per quad of the band. a is that of air outside the band.
// level, step. band_args, band_list, band_flags: the band. velocity: faces, m/s. distances: liquid distance at cell
// centres, m. next_level: a, cells. carried_level: departure points as words of advect_level in, phi* out, cells, air in spare lanes.
#import corner
#import departure_words
#import dispatch
#import fall
#import lanes
#import layout
#import level_path
#import level_values
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> band_flags: array<u32>;
@group(0) @binding(5) var<storage, read> velocity: array<f32>;
@group(0) @binding(6) var<storage, read> distances: array<f32>;
@group(0) @binding(7) var<storage, read> next_level: array<f32>;
@group(0) @binding(8) var<storage, read_write> carried_level: array<vec4<f32>>;

// Overshoot beyond the taps, cells.
const OVERSHOOT = 0.1;

fn carried(cell: u32) -> f32 {
    return select(REACH, next_level[cell], band_flags[cell / 4u] != 0u);
}

fn sample_carried(at: vec3<f32>) -> f32 {
    let corner = centres_around(at);
    let points = corner_points(corner);
    let near = points[0];
    let far = points[1];
    return mix_points(
        vec4<f32>(carried(near.x), carried(near.y), carried(near.z), carried(near.w)),
        vec4<f32>(carried(far.x), carried(far.y), carried(far.z), carried(far.w)),
        corner.f,
    );
}

// Smallest and largest level at the cells around a position by the lowest of them, cells.
fn range_at(low: u32) -> vec2<f32> {
    let points = corner_points(corner_of(low, cell_tops()));
    let near = points[0];
    let far = points[1];
    return step.inv_dx * range_of(
        vec4<f32>(distances[near.x], distances[near.y], distances[near.z], distances[near.w]),
        vec4<f32>(distances[far.x], distances[far.y], distances[far.z], distances[far.w]),
    );
}

// phi* of a cell at a position. word: see departure_words.
fn corrected(cell: u32, at: vec3<f32>, word: u32) -> f32 {
    let first_order = next_level[cell];
    var end = traced(at, velocity_in(cell), step.dt * step.inv_dx);
    if (word & FALLS) != 0u {
        end += fall();
    }
    let result = first_order + 0.5 * (step.inv_dx * distances[cell] - sample_carried(end));
    let range = range_at(word & LOWEST_POINT);
    return select(first_order, result, range.x - OVERSHOOT <= result && result <= range.y + OVERSHOOT);
}

@compute @workgroup_size(WG_SIZE)
fn correct_level(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let first = quad_cell(level, quad);
    let inside = lanes_inside(first, vec3<i32>(level.cells));
    let words = bitcast<vec4<u32>>(carried_level[quad]);
    let cell = 4u * quad;
    let kept = vec4<f32>(next_level[cell], next_level[cell + 1u], next_level[cell + 2u], next_level[cell + 3u]);
    var phi = select(vec4<f32>(REACH), kept, inside);
    var moves = lane_bits(inside & ((words & vec4<u32>(KEEPS)) == vec4<u32>()));
    while moves != 0u {
        let l = firstTrailingBit(moves);
        moves &= moves - 1u;
        let at = vec3<f32>(first) + vec3<f32>(f32(l), 0.0, 0.0) + 0.5;
        phi[l] = corrected(cell + l, at, words[l]);
    }
    carried_level[quad] = phi;
}
