// Words of the solver per active quad. Bits 0-3: active lanes; bits 4-7: lanes in closed components; bits 8-11: lanes
// in components without a free surface, which are closed or sealed by moving solids. A list entry contains a tag of
// the solver above the quad's index.
const CLOSED = 4u;
const SURFACELESS = 8u;

fn active_quad(entry: u32) -> u32 {
    return entry & 0x7fffffffu;
}
