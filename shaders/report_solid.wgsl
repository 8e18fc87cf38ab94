// diagnose, for solids, second of two: writes sums and extremes to the report. One workgroup.
// partials: three sections of sums. extremes: see extremes. report: see solid_report.
#import extremes
#import fold
#import real
#import report_sum
#import solid_report

@group(0) @binding(0) var<storage, read> partials: array<Real4>;
@group(0) @binding(1) var<storage, read> extremes: array<u32>;
@group(0) @binding(2) var<storage, read_write> report: array<u32>;

@compute @workgroup_size(FOLD_SIZE)
fn report_solid(@builtin(local_invocation_index) lane: u32) {
    let n = arrayLength(&partials) / 3u;
    for (var section = 0u; section < 3u; section++) {
        let sums = fold_from(section * n, n, lane);
        // All threads must read the sum before the next one overwrites it.
        workgroupBarrier();
        if lane == 0u {
            for (var s = 0u; s < 4u && 4u * section + s < N_SUMS; s++) {
                report_sum(SUMS + 2u * (4u * section + s), sums[s]);
            }
        }
    }
    if lane == 0u {
        report[MAX_SPEED] = extremes[FASTEST];
        report[MIN_DET] = of_smallness(extremes[WORST]);
        report[INVERTED] = extremes[N_INVERTED];
        report[CLOSING_RATE] = extremes[CLOSING];
    }
}
