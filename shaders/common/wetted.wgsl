// Wet nodes of the Schur-complement form: solver::Wetted on the host.
struct Wetted {
    // wetted nodes
    n: u32,
    pad_0: u32,
    pad_1: u32,
    pad_2: u32,
}
