// Words of the report: fields::Report reads them.
const DROPPED = 0u;
const RATE = 1u;
const MAX_SPEED = 2u;
const DIVERGENCE = 3u;
// Sums, each as an f32 and what is left of it: volume, potential energy; momentum along x, y, z, kinetic energy.
const VOLUME = 4u;
const MOMENTUM = 8u;
// The rest is there only where liquid comes in or goes out.
// Markers that have left or sunk since the state was put in place; those that leave and those that sink in this sub-step, until they
// are among them; how many these were.
const GONE = 16u;
const LEAVING = 17u;
const SINKING = 18u;
const LEFT_NOW = 19u;
const SUNK_NOW = 20u;
// Of sources, in this sub-step: new markers, those that sources that start lacked, slots kept for new markers.
const EMITTED_NOW = 21u;
const FILLED_NOW = 22u;
const ROOM = 23u;
