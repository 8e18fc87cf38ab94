// What the liquid distance knows of the cells of a quad, 4 bits each, lane 0 lowest.
// Classes: empty (in the domain, outside solids, without a marker), near (27 cells around hold an empty one), wanting (near, in
// the domain and outside solids: its distance comes from markers).
const EMPTY = 0u;
const NEAR = 4u;
const WANTING = 8u;
// occupied: no room (beyond the domain or centre in a solid; static), marked (holds a marker), spreading (holds a marker and the
// 125 cells around hold an empty one).
const NO_ROOM = 0u;
const MARKED = 4u;
const SPREADING = 8u;
// For cells up to two before and behind the quad along x too, 8 bits each from the second cell before: wanting, empty.
const WANTING_ROW = 12u;
const EMPTY_ROW = 20u;

fn lanes_of(word: u32, kind: u32) -> u32 {
    return (word >> kind) & 15u;
}

// Lanes next to a set one along x, or set themselves.
fn dilate_row(before: u32, here: u32, after: u32) -> u32 {
    return (here | here << 1u | here >> 1u | (before >> 3u & 1u) | (after & 1u) << 3u) & 15u;
}
