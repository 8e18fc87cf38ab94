// What a quad has of solids, a word: bits 0-3, lanes with a place on a surface nearby; bit 4, whether patches lie in it; above, the place of
// the first of those lanes. After the words of all quads stand the velocities of the places, three words each, m/s.
const WET = 16u;
const FIRST_PLACE = 5u;

fn has_place(word: u32, lane: u32) -> bool {
    return (word >> lane & 1u) == 1u;
}

// Of a lane that has one.
fn place_of(word: u32, lane: u32) -> u32 {
    return (word >> FIRST_PLACE) + countOneBits(word & ((1u << lane) - 1u));
}
