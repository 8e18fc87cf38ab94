// Word of a quad. Bits 0-3: lanes with a closest point on a surface; bit 4: the quad contains patches; above: index
// of the closest point of the first such lane. The velocities of the closest points follow the words of all quads,
// three words each, m/s.
const WET = 16u;
const FIRST_PLACE = 5u;

fn has_place(word: u32, lane: u32) -> bool {
    return (word >> lane & 1u) == 1u;
}

// Index of the closest point of a lane that has one.
fn place_of(word: u32, lane: u32) -> u32 {
    return (word >> FIRST_PLACE) + countOneBits(word & ((1u << lane) - 1u));
}
