// A probe at a point: fields::ProbePoint is the same struct on the host.
struct ProbePoint {
    // m
    point: vec3<f32>,
    // What it measures in bits 0 and 1; of a height its axis in bits 2 and 3, and bit 4 where coordinates fall on the way up.
    kind: u32,
}
const HEIGHT = 0u;
const PRESSURE = 1u;
const VELOCITY = 2u;
