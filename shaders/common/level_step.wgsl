// Parameters of a sub-step for the markers of a level: fields::LevelStep on the host.
struct LevelStep {
    // Seed of the jitter, and number of the sub-step.
    seed: u32,
    number: u32,
    // Slots for markers.
    capacity: u32,
    // Motion in the sub-step: TimeStep::motion in reference/time_step.rs.
    motion: f32,
}
