// What the sources do in a sub-step: fields::SourceStep is the same struct on the host.
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

// Markers that a cell within a source has at least, one in each eighth.
const PER_CELL = 8u;

// A cell of a source in a word: its source in the low byte, the eighths to keep full of markers in the next (bit i + 2 j + 4 k for
// the upper half along x, y, z).
fn source_of(word: u32) -> u32 {
    return word & 255u;
}

fn eighths_of(word: u32) -> u32 {
    return word >> 8u & 255u;
}

fn runs(source: u32, running: u32) -> bool {
    return source < 32u && (running >> source & 1u) == 1u;
}
