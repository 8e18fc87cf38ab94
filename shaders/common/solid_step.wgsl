// What a sub-step knows of the solids: stages::SolidStep fills it on the host.
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
}
