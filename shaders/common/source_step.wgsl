// What the sources do in a sub-step: stages::SourceStep is the same struct on the host.
struct SourceStep {
    // Sets of sources, a bit for each: those that run, and those of them that did not in the sub-step before.
    running: u32,
    starting: u32,
    // First slot for new markers.
    first: u32,
    // Of the jitter, and the sub-step's number.
    seed: u32,
    number: u32,
    pad_0: u32,
    pad_1: u32,
    pad_2: u32,
}

// Markers that a cell of a source has at least.
const PER_CELL = 8u;

fn runs(source: u32, running: u32) -> bool {
    return source < 32u && (running >> source & 1u) == 1u;
}
