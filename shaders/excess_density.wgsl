// excess, first: (F - 1) w and w per cell, w = clamp(d, 0, 1) with d the distance to bodies, cells, more than one cell below
// the surface where F is known, else 0. One thread per quad of the band.
// level, step. band_args, band_list: the band. liquid_distance, solid_distance: m. occupancy: F. density_now: out.
#import dispatch
#import lanes
#import layout
#import level_values
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> liquid_distance: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> solid_distance: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> occupancy: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> density_now: array<vec2<f32>>;

// Depth below which the density counts, cells, and F where it is unknown: as in reference.
const DEPTH = 1.0;

@compute @workgroup_size(WG_SIZE)
fn excess_density(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let fraction = occupancy[quad];
    let distance = solid_distance[min(quad, arrayLength(&solid_distance) - 1u)];
    let weight = clamp(distance / step.dx, vec4<f32>(), vec4<f32>(1.0));
    let deep = liquid_distance[quad] / step.dx < vec4<f32>(-DEPTH);
    let known = fraction != vec4<f32>(UNKNOWN_OCCUPANCY);
    let counts = deep & known & lanes_inside(quad_cell(level, quad), vec3<i32>(level.cells));
    for (var l = 0u; l < 4u; l++) {
        density_now[4u * quad + l] = select(vec2<f32>(), weight[l] * vec2<f32>(fraction[l] - 1.0, 1.0), counts[l]);
    }
}
