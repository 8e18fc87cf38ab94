// Classes of the cells of a quad for the liquid distance, 4 bits each, lane 0 lowest: empty (in the domain, outside
// solids, without a marker), near (one of the 27 cells around is empty), wanting (near, in the domain and outside
// solids: its distance comes from markers).
const EMPTY = 0u;
const NEAR = 4u;
const WANTING = 8u;
// occupied: no room (outside the domain or centre in a solid; static), marked (contains a marker), spreading
// (contains a marker and one of the 125 cells around is empty).
const NO_ROOM = 0u;
const MARKED = 4u;
const SPREADING = 8u;
// 8 bits each for the cells from two before to two behind the quad along x: wanting, empty.
const WANTING_ROW = 12u;
const EMPTY_ROW = 20u;

fn lanes_of(word: u32, kind: u32) -> u32 {
    return (word >> kind) & 15u;
}

// Lanes that are set, or next to a set one along x.
fn dilate_row(before: u32, here: u32, after: u32) -> u32 {
    return (here | here << 1u | here >> 1u | (before >> 3u & 1u) | (after & 1u) << 3u) & 15u;
}
