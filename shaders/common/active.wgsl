// Words of the solver per active quad. Bits 0-3: active lanes; bits 4-7: lanes in closed components; bits 8-11: lanes
// in components without a free surface, which are closed or sealed by moving solids; bits 12-15: lanes with a face that
// is not all open; bits 16-19: lanes that are the root of a component with such a lane; bits 20-23: lanes in components
// without, which are ballistic; bits 24-27: filled lanes, which are the active ones, or before the first solve those with
// liquid. A list entry contains a tag of the solver above the quad's index.
const CLOSED = 4u;
const SURFACELESS = 8u;
const HELD = 12u;
const HELD_ROOT = 16u;
const BALLISTIC = 20u;
const FILLED = 24u;

// Lanes of a word in sealed components, as bits.
fn sealed_lanes(flag: u32) -> u32 {
    return (flag >> SURFACELESS) & ~(flag >> CLOSED) & 0xfu;
}

fn active_quad(entry: u32) -> u32 {
    return entry & 0x7fffffffu;
}
