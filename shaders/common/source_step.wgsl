// State of the sources in a sub-step: fields::SourceStep on the host.
struct SourceStep {
    // Bit sets of sources: those that run, and those of them that did not run in the last sub-step.
    running: u32,
    starting: u32,
    // First slot for new markers.
    first: u32,
    // Seed of the jitter, and number of the sub-step.
    seed: u32,
    number: u32,
    pad_0: u32,
    pad_1: u32,
    pad_2: u32,
}

// Markers of a full cell, one in each eighth.
const PER_CELL = 8u;

// With a level, most markers that a cell receives in a sub-step: cells of the lattice that meet it.
const MOST_SITES = 27u;

// Word of a source cell: the source in the low byte, the eighths to fill in the next (bit i + 2 j + 4 k for the upper
// half along x, y, z).
fn source_of(word: u32) -> u32 {
    return word & 255u;
}

fn eighths_of(word: u32) -> u32 {
    return word >> 8u & 255u;
}

fn runs(source: u32, running: u32) -> bool {
    return source < 32u && (running >> source & 1u) == 1u;
}
