// landing, first of four: marks spray with liquid around it, and counts it in the component beside it. One thread per used slot.
// level, step. liquid_distance: cell centres, m. labels: see label_at. markers: x, y, z (m), w = 1 alive. marker_velocity: m/s, w = 1 for spray, 2
// for spray that lands; in place. marker_args: see plan_band_seeds. marker_counts: see marker_counts. component_flights: per label, markers that
// landed less those that started to fly; in place.
#import dispatch
#import flies
#import label_at
#import layout
#import marker_counts
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> liquid_distance: array<f32>;
@group(0) @binding(3) var<storage, read> labels: array<u32>;
@group(0) @binding(4) var<storage, read> markers: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> marker_velocity: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> marker_args: array<u32>;
@group(0) @binding(7) var<storage, read_write> marker_counts: array<atomic<u32>>;
@group(0) @binding(8) var<storage, read_write> component_flights: array<atomic<i32>>;

@compute @workgroup_size(WG_SIZE)
fn land_markers(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= marker_args[3] || marker_velocity[index].w != 1.0 || markers[index].w == 0.0 {
        return;
    }
    let at = markers[index].xyz * step.inv_dx;
    if flies(at) {
        return;
    }
    marker_velocity[index].w = 2.0;
    atomicAdd(&marker_counts[LANDED], 1u);
    let label = label_at(at);
    if label > 0u {
        atomicAdd(&component_flights[label], 1);
    }
}
