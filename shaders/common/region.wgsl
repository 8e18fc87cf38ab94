// A box of cells around a source or a sink: fields::Region is the same struct on the host.
struct Region {
    low: vec3<u32>,
    // First word of the box in map, x fastest.
    first: u32,
    n: vec3<u32>,
    // Number of the source; means nothing of sinks.
    number: u32,
}

const NOWHERE = 0xffffffffu;

// Index in map of the word of a cell; NOWHERE beyond the box.
fn word_of(region: Region, cell: vec3<u32>) -> u32 {
    // Below the low corner this wraps to more than any n.
    let at = cell - region.low;
    if any(at >= region.n) {
        return NOWHERE;
    }
    return region.first + at.x + region.n.x * (at.y + region.n.y * at.z);
}
