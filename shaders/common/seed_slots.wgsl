// The importing kernel declares step and report: array<u32>.
#import report
#import step

// First slot for seeds of the band: that after the markers that sources emitted, which leave most of their slots free.
fn first_seed() -> u32 {
    return step.n_markers - report[ROOM] + report[EMITTED_NOW];
}
