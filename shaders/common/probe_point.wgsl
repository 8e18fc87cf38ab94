// A probe at a point: stages::ProbePoint is the same struct on the host.
struct ProbePoint {
    // m
    point: vec3<f32>,
    kind: u32,
}
const HEIGHT = 0u;
const PRESSURE = 1u;
const VELOCITY = 2u;
