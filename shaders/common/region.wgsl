// A box of cells around a source or a sink: fields::Region on the host.
struct Region {
    low: vec3<u32>,
    // Index of the box's first word in map, x fastest.
    first: u32,
    n: vec3<u32>,
    // Number of the source; unused for sinks.
    number: u32,
}

const NOWHERE = 0xffffffffu;

// Index in map of the word of a cell; NOWHERE outside the box.
fn word_of(region: Region, cell: vec3<u32>) -> u32 {
    // Below the low corner this wraps to a value above any n.
    let at = cell - region.low;
    if any(at >= region.n) {
        return NOWHERE;
    }
    return region.first + at.x + region.n.x * (at.y + region.n.y * at.z);
}
