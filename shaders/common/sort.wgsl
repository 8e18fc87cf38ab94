#import dispatch

// One pass of a sort: gpu::SortPass on the host. shift: lowest bit of its digit. args: index of the first of the
// list's four arguments; the fourth is its length.
struct SortPass {
    shift: u32,
    args: u32,
}

const DIGIT_BITS = 4u;
const DIGITS = 16u;
// Consecutive entries of a thread, and of a workgroup: also gpu::TILE.
const RUN = 16u;
const TILE = 1024u;

fn n_tiles(length: u32) -> u32 {
    return (length + TILE - 1u) / TILE;
}

fn digit_of(key: u32, shift: u32) -> u32 {
    return (key >> shift) & (DIGITS - 1u);
}
