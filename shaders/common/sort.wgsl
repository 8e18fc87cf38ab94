#import dispatch

// One pass of a sort: gpu::SortPass is the same struct on the host. shift: lowest bit of its digit. args: first word of the
// list's arguments, whose fourth is its length.
struct SortPass {
    shift: u32,
    args: u32,
}

const DIGIT_BITS = 4u;
const DIGITS = 16u;
// Consecutive entries of a thread, and of a workgroup: gpu::TILE is the same number on the host.
const RUN = 16u;
const TILE = 1024u;

fn n_tiles(length: u32) -> u32 {
    return (length + TILE - 1u) / TILE;
}

fn digit_of(key: u32, shift: u32) -> u32 {
    return (key >> shift) & (DIGITS - 1u);
}
