// advect_level with sinks: removes the volume that came into their cells by the transport, and empties them. One thread per cell
// of a sink.
// step, level_step. cells: padded indices. band_flags: the band, outside which there is air. liquid_distance: before the sub-step, m.
// solid_distance: m, cell centres; one quad far outside in a scene without bodies. component: labels before the sub-step.
// carried_level: cells, in place. component_removed: see removed. exchange_totals: see exchange_totals.
#import dispatch
#import filled_part
#import level_step
#import removed
#import sink_level
#import step

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<uniform> level_step: LevelStep;
@group(0) @binding(2) var<storage, read> cells: array<u32>;
@group(0) @binding(3) var<storage, read> band_flags: array<u32>;
@group(0) @binding(4) var<storage, read> liquid_distance: array<f32>;
@group(0) @binding(5) var<storage, read> solid_distance: array<f32>;
@group(0) @binding(6) var<storage, read> component: array<u32>;
@group(0) @binding(7) var<storage, read_write> carried_level: array<f32>;
@group(0) @binding(8) var<storage, read_write> component_removed: array<atomic<u32>>;
@group(0) @binding(9) var<storage, read_write> exchange_totals: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn sink_volumes(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= arrayLength(&cells) {
        return;
    }
    let cell = cells[index];
    if band_flags[cell / 4u] == 0u {
        return;
    }
    let distance = solid_distance[min(cell, arrayLength(&solid_distance) - 1u)];
    let open_volume = filled_part(-distance / step.dx);
    // Initial liquid in a sink sinks in the first sub-step.
    let before = select(filled_part(liquid_distance[cell] / step.dx), 0.0, level_step.number == 0u);
    let came = filled_part(carried_level[cell]) - before;
    carried_level[cell] = max(carried_level[cell], SINK_LEVEL);
    remove_volume(component[cell], SUNK_VOLUME, open_volume * max(came, 0.0));
}
