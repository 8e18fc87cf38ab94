// Parameters of a sub-step for a level: fields::LevelStep on the host.
struct LevelStep {
    // Seed of the jitter, and number of the sub-step.
    seed: u32,
    number: u32,
    // Slots for markers.
    capacity: u32,
    // Courant number of the surface: TimeStep::courant in reference/time_step.rs.
    courant: f32,
    // Slots freed after seeds filled all of them, for the rest of the seeds; else 0.
    freed: u32,
    // Volume that sources renew (reference/level_exchange.rs), volumes of a cell; 0 without.
    renewed: f32,
    pad_0: u32,
    pad_1: u32,
}
