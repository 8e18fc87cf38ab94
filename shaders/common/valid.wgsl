// Flags of the 12 minus faces of a quad, bit 4 axis + lane. Bits 0-11: the face has a velocity; bits 16-27: it is
// open in this sub-step; bit 31: the quad has small-aperture faces, open by less than SLIVER.
const VALID = 0xfffu;
const OPEN = 16u;
const SLIVERS = 0x80000000u;
const SLIVER = 0.2;
// Replaces the bits of a velocity for a small-aperture face that was not valid.
const NO_VELOCITY = 0xffffffffu;
