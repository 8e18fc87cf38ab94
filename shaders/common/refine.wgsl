// Slots of norms, in the scalar type of the outer loop.
const NORM_R = 0u;      // |b - B x|^2 of the last evaluation
const NORM_B = 1u;      // |b|^2
const NORM_FLUX = 2u;   // | |E| |u*| |^2, the scale of what b is a difference of
const NORM_LAST = 3u;   // |r|^2 before the last correction
const SCALE = 4u;       // |r| by which the round's right-hand side was divided; negative to take a correction back
