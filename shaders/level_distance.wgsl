// liquid_distance with a level: dx times the level, which is air in cells of bodies that no pass of the extension reached
// and in spare lanes. One thread per quad of the band.
// level, step. band_args, band_list: the band. new_level: cells, in place. liquid_distance: m, out.
#import dispatch
#import lanes
#import layout
#import level_values
#import step
#import unknown

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read_write> new_level: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> liquid_distance: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn level_distance(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let exists = lanes_inside(quad_cell(level, quad), vec3<i32>(level.cells));
    let extended = new_level[quad];
    let reached = select(extended, vec4<f32>(AIR_IN_BODIES), extended >= vec4<f32>(UNKNOWN));
    let phi = select(vec4<f32>(REACH), reached, exists);
    if any(phi != extended) {
        new_level[quad] = phi;
    }
    liquid_distance[quad] = step.dx * phi;
}
