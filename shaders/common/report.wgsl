// Words of the report: stages::Report reads them.
const DROPPED = 0u;
const RATE = 1u;
const MAX_SPEED = 2u;
const DIVERGENCE = 3u;
// Sums, each as an f32 and what is left of it: volume, potential energy; momentum along x, y, z, kinetic energy.
const VOLUME = 4u;
const MOMENTUM = 8u;
