// diagnose, last for the liquid: writes momentum, kinetic energy and maxima to the report. One workgroup.
// partials: momentum along x, y, z, kinetic energy. maxima: speed, divergence. report: see report.
#import fold
#import report
#import report_sum
#import real

@group(0) @binding(0) var<storage, read> partials: array<Real4>;
@group(0) @binding(1) var<storage, read> maxima: array<u32>;
@group(0) @binding(2) var<storage, read_write> report: array<u32>;

@compute @workgroup_size(FOLD_SIZE)
fn report_motion(@builtin(local_invocation_index) lane: u32) {
    let sums = fold(arrayLength(&partials), lane);
    if lane == 0u {
        for (var s = 0u; s < 4u; s++) {
            report_sum(MOMENTUM + 2u * s, sums[s]);
        }
        report[MAX_SPEED] = maxima[0];
        report[DIVERGENCE] = maxima[1];
    }
}
