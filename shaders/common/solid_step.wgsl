// What a sub-step knows of the solids: fields::SolidStep fills it on the host.
struct SolidStep {
    // m/s^2
    gravity: vec3<f32>,
    // s
    dt: f32,
    // Domain, m.
    size: vec3<f32>,
    // m
    dx: f32,
    // 1/m
    inv_dx: f32,
    n_nodes: u32,
    n_elements: u32,
    // 0 in every step; compilers do not know.
    zero: u32,
    // 1, or 0 in a system without elasticity and loads: share of dt in zeta_K, and of all forces but inertia
    elastic: f32,
    // 1, or 0 in a system without damping: share of tau_M in zeta_M and of tau_K in zeta_K
    damped: f32,
    pad_0: u32,
    pad_1: u32,
}
