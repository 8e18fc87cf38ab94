// liquid_components with sources: cells of each source that have a component. One thread per source cell.
// level. cells: x, y, z and word (see source_step) of each. component: labels. labelled: per source, incremented.
#import dispatch
#import layout
#import source_step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> cells: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> component: array<u32>;
@group(0) @binding(3) var<storage, read_write> labelled: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn count_labelled(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index < arrayLength(&cells) && component[cell_index(level, cells[index].xyz)] > 0u {
        atomicAdd(&labelled[source_of(cells[index].w)], 1u);
    }
}
