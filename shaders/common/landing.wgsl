// Sums over the markers that land, per face: integers, so that their order has no effect.
// Fixed point of weights, and of velocities in cells per sub-step.
const ONE = 65536.0;
