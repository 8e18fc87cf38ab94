// Norms of the outer loop, in its scalar type: three of the state, four of each block, then those of the last evaluation of each block
// but the first. Blocks: pressures or velocities alone, or pressures, then velocities.
const NORM_LAST = 0u;   // error over the allowed error before the last correction, of the worst block
const SCALE = 1u;       // |r| by which the right-hand side of the correction was divided; negative to subtract the correction
const STRICTNESS = 2u;  // factor of the inner tolerance

// Squared norms of a block, of the iterate that is kept.
const RESIDUAL = 0u;    // residual
const RHS = 1u;         // right-hand side
const TERMS = 2u;       // terms that the right-hand side sums: of | |E| |u*| | for pressures
const REFERENCE = 3u;   // reference of the relative residual

const NORMS_OF_STATE = 3u;
const NORMS_OF_BLOCK = 4u;

fn norm_slot(block: u32, norm: u32) -> u32 {
    return NORMS_OF_STATE + NORMS_OF_BLOCK * block + norm;
}

// First of four slots: squared residual, squared terms with those of the coupling, unknowns, |D x|^2 with D the diagonal.
fn evaluation_slot(block: u32, n_blocks: u32) -> u32 {
    return norm_slot(n_blocks + block - 1u, 0u);
}

// Settings of the outer loop: solver::RefineSettings is the same struct on the host.
struct RefineSettings {
    // of |r| relative to the right-hand side
    tolerance: f32,
    // of |r| relative to the terms of the right-hand side: rounding error
    rounding: f32,
    // least reduction by a correction, above what its precision can reach
    floor: f32,
    // 1 where the correction holds a guess before the first refinement step, on trial, else 0
    guess: f32,
    n_blocks: u32,
    pad_0: u32,
    pad_1: u32,
    pad_2: u32,
}
