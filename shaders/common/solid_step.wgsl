// Parameters of a sub-step for the solids: fields::SolidStep on the host.
struct SolidStep {
    // m/s^2
    gravity: vec3<f32>,
    // s
    dt: f32,
    // Size of the domain, m.
    size: vec3<f32>,
    // m
    dx: f32,
    // 1/m
    inv_dx: f32,
    n_nodes: u32,
    n_elements: u32,
    // 0 in every step, unknown to the compiler: see pair_f32.
    zero: u32,
    // 1, or 0 in a system without elasticity and loads: factor of dt in zeta_K and of all forces but inertia
    elastic: f32,
    // 1, or 0 in a system without damping: factor of tau_M in zeta_M and of tau_K in zeta_K
    damped: f32,
    pad_0: u32,
    pad_1: u32,
}
