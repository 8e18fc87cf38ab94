// What the condensed form has of the wetted nodes: solver::Wetted is the same struct on the host.
struct Wetted {
    // wetted nodes
    n: u32,
    pad_0: u32,
    pad_1: u32,
    pad_2: u32,
}
