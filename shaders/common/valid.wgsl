// What is known of the 12 minus faces of a quad, bit 4 axis + lane: bits 0-11, the face has a velocity; bits 16-27, it is open
// (where solids cut the grid, as of this sub-step); bit 31: some of them are slivers, open but by less than SLIVER of their area.
const VALID = 0xfffu;
const OPEN = 16u;
const SLIVERS = 0x80000000u;
const SLIVER = 0.2;
// In place of the bits of a velocity: a sliver that was not valid.
const NO_VELOCITY = 0xffffffffu;
