// exchange with sources, first of three: counts the markers in the eighths to fill of the running sources' cells.
// One thread per marker.
// level, step. source_step: state of the sources. regions: boxes around the sources. map: per cell of the boxes, its
// index among source cells from 1, else 0. cells: x, y, z and word (see source_step) of each. markers: x, y, z (m), w
// = 1 alive. counts: per source cell, incremented.
#import dispatch
#import layout
#import step
#import region
#import source_step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<uniform> source_step: SourceStep;
@group(0) @binding(3) var<storage, read> regions: array<Region>;
@group(0) @binding(4) var<storage, read> map: array<u32>;
@group(0) @binding(5) var<storage, read> cells: array<vec4<u32>>;
@group(0) @binding(6) var<storage, read> markers: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> counts: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn count_in_sources(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= source_step.first {
        return;
    }
    let marker = markers[index];
    if marker.w == 0.0 {
        return;
    }
    let x = marker.xyz * step.inv_dx;
    let cell = cell_of(level, x);
    let upper = vec3<u32>(x - vec3<f32>(cell) >= vec3<f32>(0.5));
    let eighth = upper.x | upper.y << 1u | upper.z << 2u;
    for (var r = 0u; r < arrayLength(&regions); r++) {
        if !runs(regions[r].number, source_step.running) {
            continue;
        }
        let word = word_of(regions[r], cell);
        if word != NOWHERE && map[word] != 0u {
            let number = map[word] - 1u;
            if (eighths_of(cells[number].w) >> eighth & 1u) == 1u {
                atomicAdd(&counts[number], 1u);
            }
            return;
        }
    }
}
