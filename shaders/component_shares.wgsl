// liquid_components: shares the targets V0_l of the components before the sub-step among those after it, V0_l w_c / W_l
// for every cell c that comes from l. One thread per quad of the band.
// band_args, band_list: the band. liquid_volumes: w, volumes of a cell. component: labels. component_origin: see
// component_origins. component_volume: V0 at the old labels, volumes of a cell. overlaps: W, see component_sums. sums:
// shares, see component_sums.
#import dispatch
#import tally

@group(0) @binding(0) var<storage, read> band_args: array<u32>;
@group(0) @binding(1) var<storage, read> band_list: array<u32>;
@group(0) @binding(2) var<storage, read> liquid_volumes: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> component: array<vec4<u32>>;
@group(0) @binding(4) var<storage, read> component_origin: array<vec4<u32>>;
@group(0) @binding(5) var<storage, read> component_volume: array<f32>;
@group(0) @binding(6) var<storage, read> overlaps: array<vec2<u32>>;
@group(0) @binding(7) var<storage, read_write> sums: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn component_shares(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    var label = vec4<u32>();
    var share = vec4<f32>();
    if index < band_args[3] {
        let quad = band_list[index];
        let volume = liquid_volumes[quad];
        if any(volume > vec4<f32>()) {
            label = component[quad];
            let origin = component_origin[quad];
            var last = 0u;
            var target_volume = 0.0;
            var overlap = 0.0;
            for (var l = 0u; l < 4u; l++) {
                if volume[l] <= 0.0 || origin[l] == 0u {
                    continue;
                }
                if origin[l] != last {
                    last = origin[l];
                    target_volume = component_volume[last];
                    overlap = value_of(overlaps[last]);
                }
                if overlap > 0.0 {
                    share[l] = target_volume * (volume[l] / overlap);
                }
            }
        }
    }
    tally(label, share, lane);
}
