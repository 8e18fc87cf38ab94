// J between liquid and solids: solver::Coupling is the same struct on the host. All in the units of the pressure's system: the unknown phi
// is a potential, m/s, so that J is an area over dx^2, and rows of the solids, kg/s times m/s, are divided by the mass rate of a cell.
struct Coupling {
    // quads with patches
    n_wet: u32,
    n_nodes: u32,
    // first word of where the pairs of the wet quads start, one more than there are; the quads themselves stand before
    quad_starts: u32,
    // first word of where the pairs of the nodes start, one more than there are
    node_starts: u32,
    // rho dx^3 / dt, kg/s
    mass: f32,
    // sigma: share of zeta_M M in Z1
    share: f32,
    pad_0: u32,
    pad_1: u32,
}
