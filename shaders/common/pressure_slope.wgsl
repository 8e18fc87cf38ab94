// What pressure does within cells: solver::PressureSlope is the same struct on the host.
struct PressureSlope {
    // of liquid at rest, Pa/m
    at_rest: vec3<f32>,
    // rho / dt of the last sub-step, Pa/m per m/s of the potential; 0 before the first
    scale: f32,
}
