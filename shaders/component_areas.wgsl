// volume_shift, first: A_k, the sum of open fractions times clamp(1 - |phi|, 0, 1) with phi in cells. One thread per quad
// of the band.
// step. band_args, band_list: the band. liquid_distance, solid_distance: m. component: labels. sums: areas, see
// component_sums.
#import dispatch
#import filled
#import tally

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> liquid_distance: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> solid_distance: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> component: array<vec4<u32>>;
@group(0) @binding(6) var<storage, read_write> sums: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn component_areas(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    var label = vec4<u32>();
    var area = vec4<f32>();
    if index < band_args[3] {
        let quad = band_list[index];
        let phi = abs(liquid_distance[quad]) / step.dx;
        if any(phi < vec4<f32>(1.0)) {
            label = select(vec4<u32>(), component[quad], phi < vec4<f32>(1.0));
            area = vec4<f32>(open_volume(quad)) * clamp(1.0 - phi, vec4<f32>(), vec4<f32>(1.0));
        }
    }
    tally(label, area, lane);
}
