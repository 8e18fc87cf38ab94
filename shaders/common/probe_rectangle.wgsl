// A rectangle of a flux probe: stages::ProbeRectangle on the host.
struct ProbeRectangle {
    // lowest corner, m
    low: vec3<f32>,
    // axis of its normal
    axis: u32,
    // highest corner, m
    high: vec3<f32>,
    // index of its value, in fours
    place: u32,
}
