// Sums over the markers that fly, so that they do not depend on slots: integers of 64 bits in two's complement, low words first, in units of 1 / QUANTA.
// Number; way along x, y and z in the sub-step, cells; its square, cells^2; position along gravity, cells.
const QUANTA = 4096.0;

// Volume of a marker, volumes of a cell.
const MARKER_VOLUME = 0.125;
