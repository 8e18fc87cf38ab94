// A probe at a point: stages::ProbePoint on the host.
struct ProbePoint {
    // position, m
    point: vec3<f32>,
    // Quantity in bits 0 and 1. For a height, bits 2 and 3 contain its axis, and bit 4 is set where coordinates
    // decrease upwards.
    kind: u32,
}
const HEIGHT = 0u;
const PRESSURE = 1u;
const VELOCITY = 2u;
