// Words of the report of the solids, decoded by fields::SolidReport.
const MAX_SPEED = 0u;
const MIN_DET = 1u;
const INVERTED = 2u;
const CLOSING_RATE = 3u;
// Sums, each as an f32 and its remainder: momentum along x, y, z and kinetic energy; angular momentum about x, y, z
// and elastic energy; potential energy.
const SUMS = 4u;
const N_SUMS = 9u;
