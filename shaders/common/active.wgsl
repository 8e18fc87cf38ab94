// The solver's words on active quads. Bits 0-3 of the word per quad: active lanes; bits 4-7: lanes in components without a free
// surface. A list entry carries a tag of the solver above the quad's index.
const CLOSED = 4u;

fn active_quad(entry: u32) -> u32 {
    return entry & 0x7fffffffu;
}
