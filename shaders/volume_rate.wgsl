// liquid_distance, after measure_volume: volume and growth rate of volume control, (V_0/V - 1) over half a control
// time or one and a half sub-steps, at most 10 % per control time, 1/s.
// Markers that leave or are deleted in this sub-step reduce V_0 by their share and are added to the total. One
// workgroup.
// step: volume_0 before, 0 without control. partials: volume, potential energy. report: see report.
#import step
#import report
#import report_sum
#import fold
#import real

// Smallest numbers of control times and sub-steps over which the correction is spread, and the largest relative change
// of volume per control time (reasons in the twin, reference/right_hand_side.rs).
const CONTROL_TIMES = 0.5;
const STEPS = 1.5;
const LARGEST_CHANGE = 0.1;

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> partials: array<Real4>;
@group(0) @binding(2) var<storage, read_write> report: array<u32>;

@compute @workgroup_size(FOLD_SIZE)
fn volume_rate(@builtin(local_invocation_index) lane: u32) {
    let sums = fold(arrayLength(&partials), lane);
    if lane != 0u {
        return;
    }
    report_sum(VOLUME, sums.x);
    report_sum(VOLUME + 2u, sums.y);
    var volume_0 = Real(step.volume_0);
    var going = 0u;
    if arrayLength(&report) > ROOM {
        report[LEFT_NOW] = report[LEAVING];
        report[SUNK_NOW] = report[SINKING];
        report[LEAVING] = 0u;
        report[SINKING] = 0u;
        going = report[LEFT_NOW] + report[SUNK_NOW];
    }
    if going > 0u {
        let before = step.n_markers - report[ROOM] - report[DROPPED] - report[GONE];
        volume_0 *= Real(before - going) / Real(before);
        report[GONE] += going;
    }
    var rate = 0.0;
    if volume_0 > Real() && sums.x > Real() {
        let deficit = f32(volume_0 / sums.x - Real(1.0));
        rate = clamp(
            deficit / max(CONTROL_TIMES * step.control_time, STEPS * step.dt),
            -LARGEST_CHANGE / step.control_time,
            LARGEST_CHANGE / step.control_time,
        );
    }
    report[RATE] = bitcast<u32>(rate);
}
