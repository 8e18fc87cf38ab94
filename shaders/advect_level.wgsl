// advect_level, first of two: a(x) = phi(x - dt u), semi-Lagrangian with the midpoint rule (equation in the twin,
// reference/advect_level.rs). Beyond open sides the level is at least the distance to them.
// One thread per quad of the band.
// level, step. band_args, band_list: the band. velocity: faces, m/s. distances: liquid distance at cell centres, m, that
// of air outside the band. flags: see active. next_level: a, cells.
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
@group(0) @binding(6) var<storage, read> flags: array<u32>;
@group(0) @binding(7) var<storage, read_write> next_level: array<f32>;

@compute @workgroup_size(WG_SIZE)
fn advect_level(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let first = quad_cell(level, quad);
    let inside = lanes_inside(first, vec3<i32>(level.cells));
    for (var l = 0u; l < 4u; l++) {
        if !inside[l] {
            continue;
        }
        let cell = 4u * quad + l;
        let origin = level_origin(vec3<f32>(first) + vec3<f32>(f32(l), 0.0, 0.0) + 0.5, velocity_in(cell));
        var phi = step.inv_dx * sample_distance(origin).x;
        let beyond = beyond_side(origin);
        if beyond > 0.0 {
            phi = max(phi, beyond);
        }
        next_level[cell] = phi;
    }
}
