// marker_band, third of four, one workgroup: an exclusive scan of the numbers of seeds, in the order of the band. Seeds without a slot are missing:
// the host stops with an error. They follow the markers that sources emitted. Reports the numbers of this sub-step, and writes the number of used slots with the seeds.
// step. level_step: capacity. band_args: the band. chunks: seeds per workgroup of count_seeds in, seeds before it out. marker_counts: see
// marker_counts. marker_args: workgroups x, y, z for the used slots, and their number. landing_args: those, and those of the band, if there is spray;
// else none. report: see report.
#import dispatch
#import step
#import scan
#import level_step
#import seed_slots
#import marker_counts

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<uniform> level_step: LevelStep;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read_write> chunks: array<u32>;
@group(0) @binding(4) var<storage, read> marker_counts: array<u32>;
@group(0) @binding(5) var<storage, read_write> marker_args: array<u32>;
@group(0) @binding(6) var<storage, read_write> landing_args: array<u32>;
@group(0) @binding(7) var<storage, read_write> report: array<u32>;

@compute @workgroup_size(SCAN_SIZE)
fn plan_band_seeds(@builtin(local_invocation_index) lane: u32) {
    let total = scan((band_args[3] + WG_SIZE - 1u) / WG_SIZE, lane);
    if lane != 0u {
        return;
    }
    let first = first_seed();
    let seeded = min(total, level_step.capacity - first);
    let used = first + seeded;
    let groups = workgroups_for(used);
    marker_args[0] = groups.x;
    marker_args[1] = groups.y;
    marker_args[2] = groups.z;
    marker_args[3] = used;
    let spray = u32(marker_counts[FLYING] > 0u);
    for (var n = 0u; n < 3u; n++) {
        landing_args[n] = spray * groups[n];
        landing_args[4u + n] = spray * band_args[n];
    }
    report[FLYING_NOW] = marker_counts[FLYING];
    report[LOST_SPRAY_NOW] = marker_counts[LOST_SPRAY];
    report[DELETED_NOW] = marker_counts[DELETED];
    report[SEEDED_NOW] = seeded;
    report[MISSING_NOW] = total - seeded;
}
