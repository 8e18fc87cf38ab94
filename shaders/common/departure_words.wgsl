// Words of the departure points of a transport by MacCormack's method, which its second pass reads: index of the lowest point around the
// departure point (of velocities that plus NUDGE) within its section, and marks. Indices are below 2^29: a buffer of the faces, three
// sections of floats, would be larger than any otherwise.
// The first order stays.
const KEEPS = 0x80000000u;
// The end of the trace forwards falls, see ballistic.
const FALLS = 0x40000000u;
// The departure point is beyond the outermost cell centres.
const AT_SIDE = 0x20000000u;
const LOWEST_POINT = 0x1fffffffu;
