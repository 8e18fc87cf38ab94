// Slots of scalars, in the scalar type of the corrections.
const RZ = 0u;          // r . z
const ALPHA = 1u;       // step along the search direction
const BETA = 2u;        // share of the old direction in the new one
const GOAL = 3u;        // |r|^2 at which the refinement step ends
// Of coupled systems.
const WEIGHT = 4u;      // of |r_v|^2 where |g_p|^2 has 1
const LEFT_V = 5u;      // |r_v|^2 as the preconditioner estimates it, of the residual before the last step
