// What the host clipped in this sub-step: stages::Clipped and stages::CutQuad are the same structs there.
struct Clipped {
    // quads whose cells solids cut, or cut in the last sub-step
    n_quads: u32,
    // cells near solids, with the nearest place on a surface
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
