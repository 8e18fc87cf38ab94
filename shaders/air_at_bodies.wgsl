// advect_level, with separation and bodies at rest: bounds of the level in air whose path back enters a body (equation in the twin,
// reference/air_at_bodies.rs). One thread per quad of the band.
// level, step. band_args, band_list: the band. velocity: faces, m/s. distances: liquid distance at cell centres, m. solid_distance: m.
// separation_bounds: cells; in place.
#import dispatch
#import lanes
#import layout
#import level_path
#import sample_distance
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> velocity: array<f32>;
@group(0) @binding(5) var<storage, read> distances: array<f32>;
@group(0) @binding(6) var<storage, read> solid_distance: array<f32>;
@group(0) @binding(7) var<storage, read_write> separation_bounds: array<vec4<f32>>;

// The constants of reference/air_at_bodies.rs.
// Distance from bodies from which no path enters them, cells.
const PATH_REACH = 2.99;
// Samples of a path.
const SAMPLES = 4u;

// Distance of a position from bodies, cells.
fn body_distance(at: vec3<f32>) -> f32 {
    let corner = centres_around(at);
    let points = corner_points(corner);
    let near = points[0];
    let far = points[1];
    return step.inv_dx * mix_points(
        vec4<f32>(solid_distance[near.x], solid_distance[near.y], solid_distance[near.z], solid_distance[near.w]),
        vec4<f32>(solid_distance[far.x], solid_distance[far.y], solid_distance[far.z], solid_distance[far.w]),
        corner.f,
    );
}

// The level where the path of a cell of air at x enters a body; -1 where it enters none. distance: of the cell from bodies, cells.
fn level_at_body(cell: u32, x: vec3<f32>, distance: f32) -> f32 {
    let way = traced(x, velocity_in(cell), -step.dt * step.inv_dx) - x;
    var outside = distance;
    for (var n = 0u; n < SAMPLES; n++) {
        let inside = body_distance(x + f32(n + 1u) / f32(SAMPLES) * way);
        if inside < 0.0 {
            let t = (f32(n) + outside / (outside - inside)) / f32(SAMPLES);
            return step.inv_dx * sample_distance(x + t * way).x;
        }
        outside = inside;
    }
    return -1.0;
}

@compute @workgroup_size(WG_SIZE)
fn air_at_bodies(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let first = quad_cell(level, quad);
    let inside = lanes_inside(first, vec3<i32>(level.cells));
    for (var n = 0u; n < 4u; n++) {
        let cell = 4u * quad + n;
        let distance = step.inv_dx * solid_distance[cell];
        if !inside[n] || distances[cell] < 0.0 || distance < 0.0 || distance >= PATH_REACH {
            continue;
        }
        let phi = level_at_body(cell, vec3<f32>(first) + vec3<f32>(f32(n), 0.0, 0.0) + 0.5, distance);
        if phi >= 0.0 {
            separation_bounds[quad][n] = max(separation_bounds[quad][n], phi);
        }
    }
}
