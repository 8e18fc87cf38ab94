// Flags of the 12 minus faces of a quad, bit 4 axis + lane. Bits 0-11: the face has a velocity; bits 16-27: it is
// open in this sub-step; bit 31: the quad has small-aperture faces, open by less than SLIVER. Bits 12-15, with separation
// from `solve` to `diagnose`: lanes whose cell liquid may leave walls and bodies in, of air or separated.
const VALID = 0xfffu;
const OPEN = 16u;
const LEAVING = 0xf000u;
const LEAVING_FIRST = 12u;
const SLIVERS = 0x80000000u;
const SLIVER = 0.2;
// Replaces the bits of a velocity for a small-aperture face that was not valid.
const NO_VELOCITY = 0xffffffffu;
