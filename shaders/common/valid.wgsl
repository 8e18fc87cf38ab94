// What is known of the 12 minus faces of a quad, bit 4 axis + lane: bits 0-11, the face has a velocity; bits 16-27, it is open
// (where solids cut the grid, as of this sub-step).
const VALID = 0xfffu;
const OPEN = 16u;
