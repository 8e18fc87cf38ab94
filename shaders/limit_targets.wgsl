// liquid_components with open sides, after component_targets: limits every target to the surroundings of the volume of its
// component. One thread per quad of the band.
// band_args, band_list: the band. component: labels. component_sums: volumes at the roots. component_volume: targets at the
// roots, volumes of a cell; in place. exchange_totals: see exchange_totals.
#import component_sums
#import controlled_part
#import dispatch
#import exchange_totals

@group(0) @binding(0) var<uniform> level_step: LevelStep;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> component: array<vec4<u32>>;
@group(0) @binding(4) var<storage, read> component_sums: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read_write> component_volume: array<f32>;
@group(0) @binding(6) var<storage, read_write> exchange_totals: array<atomic<u32>>;

// Largest relative difference, as in reference/level_exchange.rs.
const LARGEST_DIFFERENCE = 0.1;

@compute @workgroup_size(WG_SIZE)
fn limit_targets(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let label = component[quad];
    for (var l = 0u; l < 4u; l++) {
        let root = 4u * quad + l;
        if label[l] != root {
            continue;
        }
        let volume = volume_of(component_sums[root]);
        let before = component_volume[root];
        let largest = controlled_part(volume) * LARGEST_DIFFERENCE;
        let limited = clamp(before, (1.0 - largest) * volume, (1.0 + largest) * volume);
        if limited != before {
            component_volume[root] = limited;
            add_total(LIMITED_VOLUME, fixed(limited - before));
        }
    }
}
