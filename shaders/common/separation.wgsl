// Word of separated per quad. Bits 0-3: separated lanes, whose pressure is 0; bits 4-7: lanes that may separate; bits 8-11:
// lanes that do not separate again in this solve. Bits 12-15: separated lanes of the next round; bits 16-19: those that
// do not separate again then.
const CANDIDATES = 4u;
const LOCKED = 8u;
const NEXT = 12u;
const NEXT_LOCKED = 16u;
const PRESENT = 0xfffu;

// Words of separation_sums: cells that separate and that are let back after a round, and separated cells during it; bits of the
// largest potential and right-hand side, m/s; one's complement of the ordered bits of the least potential in liquid with a free surface; rate at
// which the separated cells open over dx^2, m/s, as an f32 and its remainder.
const ADDED = 0u;
const RETURNED = 1u;
const SEPARATED = 2u;
const LARGEST_POTENTIAL = 3u;
const LARGEST_RHS = 4u;
const LEAST_POTENTIAL = 5u;
const OPENING = 6u;
