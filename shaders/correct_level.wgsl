// advect_level, last of two: phi*(x) = a(x) + (phi(x) - a(x + dt u)) / 2 where this is within the range of the taps of
// a(x), widened by OVERSHOOT, else a(x); MacCormack's method (Selle et al. 2008). Departures beyond open sides keep a.
// One thread per quad of the band. a is that of air outside the band.
// level, step. band_args, band_list, band_flags: the band. velocity: faces, m/s. distances: liquid distance at cell
// centres, m. flags: see active. next_level: a, cells. carried_level: phi*, cells, air in spare lanes.
#import corner
#import dispatch
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
@group(0) @binding(7) var<storage, read> flags: array<u32>;
@group(0) @binding(8) var<storage, read> next_level: array<f32>;
@group(0) @binding(9) var<storage, read_write> carried_level: array<f32>;

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

// Smallest and largest level at the cells around a position, cells.
fn range_at(at: vec3<f32>) -> vec2<f32> {
    let points = corner_points(centres_around(at));
    let near = points[0];
    let far = points[1];
    return step.inv_dx * range_of(
        vec4<f32>(distances[near.x], distances[near.y], distances[near.z], distances[near.w]),
        vec4<f32>(distances[far.x], distances[far.y], distances[far.z], distances[far.w]),
    );
}

fn corrected(cell: u32, at: vec3<f32>) -> f32 {
    let first_order = next_level[cell];
    let here = velocity_in(cell);
    let origin = level_origin(at, here);
    if beyond_side(origin) > 0.0 {
        return first_order;
    }
    var end = traced(at, here, step.dt * step.inv_dx);
    if is_ballistic_about(at) {
        end += fall();
    }
    let result = first_order + 0.5 * (step.inv_dx * distances[cell] - sample_carried(end));
    let range = range_at(origin);
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
    for (var l = 0u; l < 4u; l++) {
        let cell = 4u * quad + l;
        var phi = REACH;
        if inside[l] {
            phi = corrected(cell, vec3<f32>(first) + vec3<f32>(f32(l), 0.0, 0.0) + 0.5);
        }
        carried_level[cell] = phi;
    }
}
