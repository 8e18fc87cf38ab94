// exchange with sources and a level, second of three: an exclusive scan over the new markers of the source cells. One workgroup.
// cells: of the sources. chunks: new markers per cell in; new markers in earlier cells out. report: see report.
#import report
#import scan
#import source_step

@group(0) @binding(0) var<storage, read> cells: array<vec4<u32>>;
@group(0) @binding(1) var<storage, read_write> chunks: array<u32>;
@group(0) @binding(2) var<storage, read_write> report: array<u32>;

@compute @workgroup_size(SCAN_SIZE)
fn scan_emitted(@builtin(local_invocation_index) lane: u32) {
    let n = arrayLength(&cells);
    let total = scan(n, lane);
    if lane == 0u {
        report[EMITTED_NOW] = total;
        report[FILLED_NOW] = 0u;
        report[ROOM] = MOST_SITES * n;
    }
}
