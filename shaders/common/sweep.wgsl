// One relaxation sweep: solver::Sweep is the same struct on the host.
struct Sweep {
    omega: f32,
    // 1 when the sweep ends a V-cycle
    ends_cycle: u32,
    pad_0: u32,
    pad_1: u32,
}
