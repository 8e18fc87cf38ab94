// Replaces the first node of a closest point on an obstacle; the next words contain the bits of its velocity, m/s.
const NO_NODE = 0xffffffffu;

// Clipping of this sub-step: fields::Clipped and fields::CutQuad on the host.
struct Clipped {
    // quads that moving bodies cut in this sub-step or in the last
    n_quads: u32,
    // cells near moving bodies, with their closest points
    n_places: u32,
    // index of the first velocity in walls
    first: u32,
    pad: u32,
}

struct CutQuad {
    // apertures of the minus faces across x, y, z
    open: array<vec4<f32>, 3>,
    // distance of the centres from obstacles and solids, m
    distance: vec4<f32>,
    quad: u32,
    // word of the quad in walls: see moving_walls
    walls: u32,
    pad_0: u32,
    pad_1: u32,
}
