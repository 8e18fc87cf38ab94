// diagnose with a level, before the sums: the distance of which clamp(1/2 - phi/dx, 0, 1) is the filled part of the cells. One thread per quad of
// the band.
// level, step. band_args, band_list: the band. liquid_distance: m. filled_distances: m, out.
#import dispatch
#import interpolant_part
#import layout
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> liquid_distance: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> filled_distances: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn filled_distance(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    filled_distances[quad] = step.dx * (0.5 - interpolant_parts(quad));
}
