// In place of the nodes of a place that is of an obstacle: what follows are bits of its velocity, m/s.
const NO_NODE = 0xffffffffu;

// What the host clipped in this sub-step: fields::Clipped and fields::CutQuad are the same structs there.
struct Clipped {
    // quads whose cells bodies cut that move, or cut in the last sub-step
    n_quads: u32,
    // cells near them, with what is nearest
    n_places: u32,
    // first word of the places' velocities in walls
    first: u32,
    pad: u32,
}

struct CutQuad {
    // of the minus faces across x, y, z
    open: array<vec4<f32>, 3>,
    // of the centres from obstacles and solids, m
    distance: vec4<f32>,
    quad: u32,
    // its word of walls: see moving_walls
    walls: u32,
    pad_0: u32,
    pad_1: u32,
}
