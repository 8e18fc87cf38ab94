// The sparse rows of the solids: solver::Rows is the same struct on the host.
struct Rows {
    n_nodes: u32,
    n_elements: u32,
    // blocks off the diagonal, padding counted
    n_entries: u32,
    // first word in list of where the slices start
    slices: u32,
    // first word in list of where the bodies start
    bodies: u32,
    // solids
    n_bodies: u32,
    pad_0: u32,
    pad_1: u32,
}

// Rows stand in slots, list[slot] is the node. A slice is SLICE slots; its blocks stand column after column, entry * SLICE + lane, as
// many for each slot as its longest row has. Entries that a row lacks have a zero block and the row's own node as column.
// blocks: the 3x3 blocks zeta_K K_ij, kg/s, three vectors each, its columns; those of SLICE entries stand one after another for each
// column, so that neighbouring threads read neighbouring vectors. The fourth number of the first column is the neighbour j.
const SLICE = 64u;

// First vector of the block of an entry; the next columns lie SLICE further.
fn block_at(entry: u32) -> u32 {
    return entry / SLICE * 3u * SLICE + entry % SLICE;
}
