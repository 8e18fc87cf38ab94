// The solver's words on active quads. Bits 0-3 of the word per quad: active lanes; bits 4-7: lanes in closed components; bits
// 8-11: in those without a free surface, which are closed or sealed by solids that give way. A list entry carries a tag of the solver above the quad's index.
const CLOSED = 4u;
const SURFACELESS = 8u;

fn active_quad(entry: u32) -> u32 {
    return entry & 0x7fffffffu;
}
