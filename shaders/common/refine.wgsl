// Slots of norms, in the scalar type of the outer loop.
const NORM_R = 0u;      // |b - A x|^2 of the last evaluation
const NORM_B = 1u;      // |b|^2
const NORM_TERMS = 2u;  // squared norm of the terms that b sums: of | |E| |u*| | for the pressure
const NORM_LAST = 3u;   // |r|^2 before the last correction
const SCALE = 4u;       // |r| by which the round's right-hand side was divided; negative to take a correction back
// Of coupled systems, whose first four are the pressure's.
const NORM_R_V = 5u;        // |r|^2 of the solids' rows, of the last evaluation
const NORM_B_V = 6u;        // of their right-hand side
const NORM_TERMS_V = 7u;    // squared norm of the terms that it sums
const NORM_D_V = 8u;        // |D v|^2, D the diagonal
const UNKNOWNS_V = 9u;     // free directions of the nodes
const STRICTNESS = 11u;       // by what a round aims below its goal
const NORM_BEST_V = 10u;    // |r|^2 of the solids' rows, of the iterate that is kept
const NORM_PUSHED_V = 12u;  // of the terms that the solids' right-hand side sums, and what the liquid adds to it: NORM_TERMS_V + |J^T p|^2
// What the residuals of the iterate that is kept are relative to: see coupled_turn.
const NORM_ACTS = 13u;
const NORM_ACTS_V = 14u;

// What the outer loop is to reach: solver::RefineSettings is the same struct on the host.
struct RefineSettings {
    // relative tolerance of |r| / |b|
    tolerance: f32,
    // of |r| over the norm of the terms that b sums: what rounding leaves
    rounding: f32,
    // least reduction of a round, above what the corrections' precision can reach
    round_floor: f32,
    // 1 where the correction holds a guess before the first round, on trial, else 0
    guess: f32,
}
