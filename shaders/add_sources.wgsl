// liquid_components with sources, after component_shares: adds their volumes to the targets of the components in their cells,
// that of the sub-step by the number of cells. One thread per source cell.
// level. cells: x, y, z and word (see source_step) of each. component: labels. labelled: see count_labelled. inflows: per source,
// volumes of a cell. first_fill: per source cell, volumes of a cell. sums: shares, see component_sums.
#import dispatch
#import layout
#import source_step
#import tally

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> cells: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> component: array<u32>;
@group(0) @binding(3) var<storage, read> labelled: array<u32>;
@group(0) @binding(4) var<storage, read> inflows: array<f32>;
@group(0) @binding(5) var<storage, read> first_fill: array<f32>;
@group(0) @binding(6) var<storage, read_write> sums: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn add_sources(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    var label = 0u;
    var volume = 0.0;
    if index < arrayLength(&cells) {
        let source = source_of(cells[index].w);
        label = component[cell_index(level, cells[index].xyz)];
        volume = first_fill[index] + inflows[source] / f32(max(labelled[source], 1u));
    }
    tally(vec4<u32>(label, 0u, 0u, 0u), vec4<f32>(volume, 0.0, 0.0, 0.0), lane);
}
