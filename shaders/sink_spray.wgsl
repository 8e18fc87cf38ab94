// exchange with sinks and a level, after sink_markers: spray that sank is lost, and no spray afterwards. One thread per used slot.
// step. markers: x, y, z (m), w = 1 alive, 0 deleted. marker_velocity: m/s, w = 1 for spray, of deleted markers for those that
// sank; in place. marker_counts: see marker_counts.
#import dispatch
#import step
#import marker_counts

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> markers: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> marker_velocity: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> marker_counts: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn sink_spray(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= step.n_markers || markers[index].w != 0.0 || marker_velocity[index].w == 0.0 {
        return;
    }
    marker_velocity[index].w = 0.0;
    atomicSub(&marker_counts[FLYING], 1u);
    atomicAdd(&marker_counts[LOST_SPRAY], 1u);
    atomicAdd(&marker_counts[SUNK_SPRAY], 1u);
}
