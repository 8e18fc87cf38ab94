// liquid_distance with sinks and a level: the cells of sinks are air. One thread per cell of a sink.
// step. cells: padded indices. liquid_distance: m, in place.
#import dispatch
#import sink_level
#import step

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> cells: array<u32>;
@group(0) @binding(2) var<storage, read_write> liquid_distance: array<f32>;

@compute @workgroup_size(WG_SIZE)
fn empty_level_sinks(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index < arrayLength(&cells) {
        let cell = cells[index];
        liquid_distance[cell] = max(liquid_distance[cell], SINK_LEVEL * step.dx);
    }
}
