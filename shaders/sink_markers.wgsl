// exchange with sinks, first: deletes and counts markers in cells of sinks. One thread per marker.
// level, step. regions: boxes around the sinks. map: per cell of the boxes, 1 in a sink, else 0. markers: x, y, z
// (m), w = 1 alive, 0 deleted; in place. report: see report.
#import dispatch
#import layout
#import step
#import region
#import report

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> regions: array<Region>;
@group(0) @binding(3) var<storage, read> map: array<u32>;
@group(0) @binding(4) var<storage, read_write> markers: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> report: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn sink_markers(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= step.n_markers {
        return;
    }
    let marker = markers[index];
    if marker.w == 0.0 {
        return;
    }
    let cell = cell_of(level, marker.xyz * step.inv_dx);
    for (var r = 0u; r < arrayLength(&regions); r++) {
        let word = word_of(regions[r], cell);
        if word != NOWHERE && map[word] != 0u {
            markers[index] = vec4<f32>(marker.xyz, 0.0);
            atomicAdd(&report[SINKING], 1u);
            return;
        }
    }
}
