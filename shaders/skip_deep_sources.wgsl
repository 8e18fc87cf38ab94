// exchange with sources and a level, before plan_seeds: cells below the band of markers count as full, since marker_band would
// delete theirs. One thread per source cell.
// level, step. cells: x, y, z and word (see source_step) of each. liquid_distance: before the sub-step, m. counts: markers per
// source cell, in place.
#import dispatch
#import marker_depth
#import layout
#import source_step
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> cells: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> liquid_distance: array<f32>;
@group(0) @binding(4) var<storage, read_write> counts: array<u32>;

@compute @workgroup_size(WG_SIZE)
fn skip_deep_sources(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index < arrayLength(&cells) && liquid_distance[cell_index(level, cells[index].xyz)] < -MARKER_DEPTH * step.dx {
        counts[index] = PER_CELL;
    }
}
