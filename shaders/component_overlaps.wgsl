// liquid_components: W_l, the volume that comes from each component before the sub-step. One thread per quad of the band.
// band_args, band_list: the band. liquid_volumes: volumes of a cell. component_origin: see component_origins. sums: see
// component_sums, at the old labels.
#import dispatch
#import tally

@group(0) @binding(0) var<storage, read> band_args: array<u32>;
@group(0) @binding(1) var<storage, read> band_list: array<u32>;
@group(0) @binding(2) var<storage, read> liquid_volumes: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> component_origin: array<vec4<u32>>;
@group(0) @binding(4) var<storage, read_write> sums: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn component_overlaps(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    var origin = vec4<u32>();
    var volume = vec4<f32>();
    if index < band_args[3] {
        let quad = band_list[index];
        volume = liquid_volumes[quad];
        origin = component_origin[quad];
    }
    // A label without volume would only occupy the sum of the workgroup.
    tally(select(vec4<u32>(), origin, volume > vec4<f32>()), volume, lane);
}
