// advect_level with open sides or sinks, after the volumes are summed: subtracts those of each component from its target, once,
// by the first thread that finds its mark; then they are zero. One thread per cell of an outlet or a sink.
// cells: padded indices. component: labels before the sub-step. component_removed: see removed. component_volume: targets at
// these labels, volumes of a cell; in place.
#import component_sums
#import dispatch

@group(0) @binding(0) var<storage, read> cells: array<u32>;
@group(0) @binding(1) var<storage, read> component: array<u32>;
@group(0) @binding(2) var<storage, read_write> component_removed: array<atomic<u32>>;
@group(0) @binding(3) var<storage, read_write> component_volume: array<f32>;

@compute @workgroup_size(WG_SIZE)
fn settle_removed(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= arrayLength(&cells) {
        return;
    }
    let label = component[cells[index]];
    if label == 0u {
        return;
    }
    let high = atomicAnd(&component_removed[2u * label + 1u], ~REMOVED);
    if (high & REMOVED) == 0u {
        return;
    }
    let removed = vec2<u32>(atomicLoad(&component_removed[2u * label]), high & ~REMOVED);
    component_volume[label] -= value_of(removed);
    atomicStore(&component_removed[2u * label], 0u);
    atomicStore(&component_removed[2u * label + 1u], 0u);
}
