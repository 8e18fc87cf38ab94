// Slots of norms, in the scalar type of the outer loop.
const NORM_R = 0u;      // |b - A x|^2 of the last evaluation
const NORM_B = 1u;      // |b|^2
const NORM_TERMS = 2u;  // squared norm of the terms that b sums: of | |E| |u*| | for the pressure
const NORM_LAST = 3u;   // |r|^2 before the last correction
const SCALE = 4u;       // |r| by which the round's right-hand side was divided; negative to take a correction back
