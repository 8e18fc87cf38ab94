// marker_band, first of four: deletes markers more than three cells below the surface, unless they are spray or crowd in their cell: those have
// to expand first. One thread per used slot.
// level, step. liquid_distance: after all changes, cell centres, m. excess: e per cell. markers: x, y, z (m), w = 1 alive, 0 deleted; in place.
// marker_velocity: m/s, w = 1 for spray. marker_counts: see marker_counts.
#import corner
#import dispatch
#import layout
#import step
#import marker_counts
#import marker_depth

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> liquid_distance: array<f32>;
@group(0) @binding(3) var<storage, read> excess: array<f32>;
@group(0) @binding(4) var<storage, read_write> markers: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> marker_velocity: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> marker_counts: array<atomic<u32>>;

// Excess above which markers below the band stay.
const KEPT_EXCESS = 0.2;

@compute @workgroup_size(WG_SIZE)
fn delete_markers(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= step.n_markers {
        return;
    }
    let marker = markers[index];
    if marker.w == 0.0 || marker_velocity[index].w == 1.0 {
        return;
    }
    let at = marker.xyz * step.inv_dx;
    if level_at(centres_around(at)) >= -MARKER_DEPTH {
        return;
    }
    let cell = cell_of(level, at);
    if excess[cell_index(level, cell)] > KEPT_EXCESS {
        return;
    }
    markers[index] = vec4<f32>(marker.xyz, 0.0);
    atomicAdd(&marker_counts[DELETED], 1u);
}
