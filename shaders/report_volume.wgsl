// diagnose with a level, after the volumes: writes volume and potential energy to the report. One workgroup.
// partials: volume (m^3), potential energy (J). report: see report.
#import fold
#import report
#import report_sum
#import real

@group(0) @binding(0) var<storage, read> partials: array<Real4>;
@group(0) @binding(1) var<storage, read_write> report: array<u32>;

@compute @workgroup_size(FOLD_SIZE)
fn report_volume(@builtin(local_invocation_index) lane: u32) {
    let sums = fold(arrayLength(&partials), lane);
    if lane == 0u {
        report_sum(VOLUME, sums.x);
        report_sum(VOLUME + 2u, sums.y);
    }
}
