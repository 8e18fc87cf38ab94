// liquid_components, last: target of every component, its share of the old targets and, in proportion to its volume, of
// what the whole liquid less the spray lacks; without open sides at most LARGEST_TARGET times its volume. Afterwards the shares are zero.
// One thread per quad of the band.
// step: volume_0, the target of the whole liquid. band_args, band_list: the band. component: labels. component_sums:
// volumes. shares: in place. component_totals: see sum_components. marker_counts: see marker_counts. component_volume: targets at the roots, volumes of a
// cell; out.
#import component_sums
#import dispatch
#import marker_counts
#import spray_sums
#import step

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> component: array<vec4<u32>>;
@group(0) @binding(4) var<storage, read> component_sums: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read_write> shares: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read> component_totals: array<u32>;
@group(0) @binding(7) var<storage, read> marker_counts: array<u32>;
@group(0) @binding(8) var<storage, read_write> component_volume: array<f32>;

// As in reference/liquid_components.rs.
const LARGEST_TARGET = 4.0;

@compute @workgroup_size(WG_SIZE)
fn component_targets(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let label = component[quad];
    let own = vec4<u32>(4u * quad) + vec4<u32>(0u, 1u, 2u, 3u);
    if all(label != own) {
        return;
    }
    let cell_volume = step.dx * step.dx * step.dx;
    let spray = MARKER_VOLUME * f32(marker_counts[FLYING] + marker_counts[LOST_SPRAY]);
    let whole = value_of(vec2<u32>(component_totals[0], component_totals[1]));
    let shared_volume = value_of(vec2<u32>(component_totals[2], component_totals[3]));
    let rest = step.volume_0 / cell_volume - spray - shared_volume;
    for (var l = 0u; l < 4u; l++) {
        let root = own[l];
        if label[l] != root {
            continue;
        }
        let volume = volume_of(component_sums[root]);
        var wanted = value_of(shares[root]);
        if whole > 0.0 {
            wanted += rest * (volume / whole);
        }
        component_volume[root] = select(wanted, min(wanted, LARGEST_TARGET * volume), step.open_sides == 0u);
        shares[root] = vec2<u32>();
    }
}
