// exchange, with sources only, second of three: how many markers each cell of a source lacks, and where its new ones begin among all
// new ones: a sum over the cells in their order. One workgroup.
// source_step: what the sources do. cells: x, y, z and source of each. chunks: markers that the cells have, in; sums of what those
// before lack, out. report: see report.
#import scan
#import report
#import source_step

@group(0) @binding(0) var<uniform> source_step: SourceStep;
@group(0) @binding(1) var<storage, read> cells: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read_write> chunks: array<u32>;
@group(0) @binding(3) var<storage, read_write> report: array<u32>;

var<workgroup> sh_filled: atomic<u32>;

@compute @workgroup_size(SCAN_SIZE)
fn plan_seeds(@builtin(local_invocation_index) lane: u32) {
    let n = arrayLength(&cells);
    // The share of a thread in the scan.
    let share = (n + SCAN_SIZE - 1u) / SCAN_SIZE;
    let end = min(min(lane * share, n) + share, n);
    var filled = 0u;
    for (var c = min(lane * share, n); c < end; c++) {
        let source = cells[c].w;
        let lacks = select(0u, PER_CELL - min(chunks[c], PER_CELL), runs(source, source_step.running));
        filled += select(0u, lacks, runs(source, source_step.starting));
        chunks[c] = lacks;
    }
    atomicAdd(&sh_filled, filled);
    let total = scan(n, lane);
    if lane == 0u {
        report[EMITTED_NOW] = total;
        report[FILLED_NOW] = atomicLoad(&sh_filled);
        report[ROOM] = PER_CELL * n;
    }
}
