#import layout

// One level of the multigrid hierarchy: solver::Level is the same struct on the host.
struct Level {
    shape: Layout,
    // weight of every inner face of a uniform quad, 2^level
    coefficient: f32,
    // first word of this level's list length and dispatch size in args
    args: u32,
    pad_0: u32,
    pad_1: u32,
}

// List entries carry this bit when all 24 faces of the quad have the level's coefficient and none is a free surface: 90 % of
// the liquid, for which no weights are loaded.
const UNIFORM = 0x80000000u;

// Sections of the matrix array, each of Level.shape.total quads, the levels one after another in each: weights of the minus faces
// along x, y, z; the free-surface term of the diagonal; the reciprocal of the whole diagonal, 0 in inactive cells.
const DIRICHLET = 3u;
const INV_DIAGONAL = 4u;
