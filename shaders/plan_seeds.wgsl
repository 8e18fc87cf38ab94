// exchange with sources, second of three: number of new markers per source cell, and an exclusive scan over the cells
// in order. Cells with their centre in a body receive none (reason in the twin, reference/exchange.rs).
// One workgroup.
// level. source_step: state of the sources. cells: x, y, z and word (see source_step) of each. solid_distance: m,
// cell centres; one quad, far outside, in a scene without solids. chunks: present markers per cell in; new markers in
// earlier cells out. report: see report.
#import layout
#import scan
#import report
#import source_step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> source_step: SourceStep;
@group(0) @binding(2) var<storage, read> cells: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> solid_distance: array<f32>;
@group(0) @binding(4) var<storage, read_write> chunks: array<u32>;
@group(0) @binding(5) var<storage, read_write> report: array<u32>;

var<workgroup> sh_filled: atomic<u32>;

// Whether a body covers the centre of a cell.
fn covered(cell: vec3<u32>) -> bool {
    let index = cell_index(level, cell);
    return solid_distance[min(index, arrayLength(&solid_distance) - 1u)] < 0.0;
}

@compute @workgroup_size(SCAN_SIZE)
fn plan_seeds(@builtin(local_invocation_index) lane: u32) {
    let n = arrayLength(&cells);
    // The share of a thread in the scan.
    let share = (n + SCAN_SIZE - 1u) / SCAN_SIZE;
    let end = min(min(lane * share, n) + share, n);
    var filled = 0u;
    for (var c = min(lane * share, n); c < end; c++) {
        let source = source_of(cells[c].w);
        let full = countOneBits(eighths_of(cells[c].w));
        let lacks = select(0u, full - min(chunks[c], full), runs(source, source_step.running));
        filled += select(0u, lacks, runs(source, source_step.starting));
        chunks[c] = select(lacks, 0u, covered(cells[c].xyz));
    }
    atomicAdd(&sh_filled, filled);
    let total = scan(n, lane);
    if lane == 0u {
        report[EMITTED_NOW] = total;
        report[FILLED_NOW] = atomicLoad(&sh_filled);
        report[ROOM] = PER_CELL * n;
    }
}
