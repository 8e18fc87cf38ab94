// advect_level, with separation: bounds of the level where liquid leaves walls and bodies (equations in the twin,
// reference/separated_level.rs). One thread per quad of the band.
// level, step. band_args, band_list: the band. velocity: faces, m/s. distances: liquid distance at cell centres, m. solid_distance: m.
// valid: open faces. separated: see separation, of the last sub-step. separation_bounds: cells, NO_BOUND where no liquid leaves a wall; out.
#import dispatch
#import face_index
#import lanes
#import layout
#import level_path
#import level_values
#import sample_distance
#import step
#import valid

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> velocity: array<f32>;
@group(0) @binding(5) var<storage, read> distances: array<f32>;
@group(0) @binding(6) var<storage, read> solid_distance: array<f32>;
@group(0) @binding(7) var<storage, read> valid: array<u32>;
@group(0) @binding(8) var<storage, read> separated: array<u32>;
@group(0) @binding(9) var<storage, read_write> separation_bounds: array<vec4<f32>>;

// The constants of reference/separated_level.rs.
// Distance from a body up to which cells belong to its surface, cells.
const BODY_REACH = 1.25;
// Distance of a centre from a wall of the domain, cells.
const AT_WALL = 0.5;
// Gap over the way of the liquid up to which it moves along the wall.
const ALONG_WALL = 0.02;

fn separated_lanes(quad: u32) -> u32 {
    return separated[quad] & 15u;
}

// Separated cells on each side of the lanes, as cells_across.
fn separated_beside(quad: u32) -> u32 {
    let here = separated_lanes(quad);
    return (here << 1u & 15u) | separated_lanes(quad - 1u) >> 3u
        | (here >> 1u | (separated_lanes(quad + 1u) & 1u) << 3u) << 4u
        | separated_lanes(quad - level.stride_y) << 8u | separated_lanes(quad + level.stride_y) << 12u
        | separated_lanes(quad - level.stride_z) << 16u | separated_lanes(quad + level.stride_z) << 20u;
}

// Distance of a cell from the bodies, cells.
fn body_distance(cell: u32) -> f32 {
    return step.inv_dx * solid_distance[min(cell, arrayLength(&solid_distance) - 1u)];
}

// Direction away from the nearest body; 0 where the distance has no gradient.
fn body_normal(at: vec3<i32>) -> vec3<f32> {
    let top = vec3<i32>(level.cells) - 1;
    var n = vec3<f32>();
    for (var b = 0u; b < 3u; b++) {
        let high = cell_index(level, vec3<u32>(min(at + along(b), top)));
        let low = cell_index(level, vec3<u32>(max(at - along(b), vec3<i32>())));
        n[b] = body_distance(high) - body_distance(low);
    }
    let length = length(n);
    return select(vec3<f32>(), n / length, length > 0.0);
}

// The bound by a wall at a distance s with the normal n into the liquid. phi: level, motion: way of the liquid in the sub-step, both in cells.
fn from_wall(at: vec3<i32>, phi: f32, motion: vec3<f32>, n: vec3<f32>, s: f32) -> f32 {
    let inner = step.inv_dx * sample_distance(vec3<f32>(at) + 0.5 + n).x;
    let gap = max(phi + s, 0.0) * clamp(2.0 * (phi - inner), 0.0, 1.0);
    let opened = gap + dot(n, motion);
    return select(NO_BOUND, opened - s, opened > ALONG_WALL * length(motion));
}

// The bound at a cell. sides: separated cells beside it, a bit of four per side.
fn bound_at(cell: u32, at: vec3<i32>, separates: bool, sides: u32) -> f32 {
    let phi = step.inv_dx * distances[cell];
    let distance = body_distance(cell);
    if phi >= 0.0 || distance < 0.0 {
        return NO_BOUND;
    }
    let motion = step.dt * step.inv_dx * velocity_in(cell);
    var bound = NO_BOUND;
    var leaves_body = separates;
    for (var n = 0u; n < 6u; n++) {
        let axis = n / 2u;
        let side = n % 2u;
        let out = along(axis) * (2 * i32(side) - 1);
        let other = at + out;
        if all(other >= vec3<i32>()) && all(other < vec3<i32>(level.cells)) {
            let beside = (sides >> (4u * n) & 1u) != 0u;
            leaves_body |= beside && body_distance(cell_index(level, vec3<u32>(other))) < 0.0;
            continue;
        }
        let plus = cell + side * vec3<u32>(1u, 4u * level.stride_y, 4u * level.stride_z)[axis];
        let is_open = (valid[plus / 4u] >> (OPEN + 4u * axis + plus % 4u) & 1u) != 0u;
        if separates && !is_open {
            bound = max(bound, from_wall(at, phi, motion, -vec3<f32>(out), AT_WALL));
        }
    }
    if leaves_body && distance < BODY_REACH {
        let n = body_normal(at);
        if any(n != vec3<f32>()) {
            bound = max(bound, from_wall(at, phi, motion, n, distance));
        }
    }
    return bound;
}

@compute @workgroup_size(WG_SIZE)
fn separated_level(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let own = separated_lanes(quad);
    let beside = separated_beside(quad);
    var bounds = vec4<f32>(NO_BOUND);
    let first = quad_cell(level, quad);
    let inside = lane_bits(lanes_inside(first, vec3<i32>(level.cells)));
    let around = beside | beside >> 12u;
    var lanes = (own | around | around >> 4u | around >> 8u) & inside;
    while lanes != 0u {
        let n = firstTrailingBit(lanes);
        lanes &= lanes - 1u;
        let at = first + vec3<i32>(i32(n), 0, 0);
        bounds[n] = bound_at(4u * quad + n, at, (own >> n & 1u) != 0u, beside >> n);
    }
    separation_bounds[quad] = bounds;
}
