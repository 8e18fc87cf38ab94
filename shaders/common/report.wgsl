// Words of the report, decoded by fields::Report.
const DROPPED = 0u;
const RATE = 1u;
const MAX_SPEED = 2u;
const DIVERGENCE = 3u;
// Sums, each as an f32 and its remainder: volume, potential energy; momentum along x, y, z, kinetic energy.
const VOLUME = 4u;
const MOMENTUM = 8u;
// The following words exist only with sources, sinks, open sides or a level. Markers that have left or been deleted in sinks
// since the state was written; those of this sub-step, until they are added to the former; their last numbers.
const GONE = 16u;
const LEAVING = 17u;
const SINKING = 18u;
const LEFT_NOW = 19u;
const SUNK_NOW = 20u;
// Sources in this sub-step: new markers, markers missing in starting sources, slots reserved for new markers.
const EMITTED_NOW = 21u;
const FILLED_NOW = 22u;
const ROOM = 23u;
// The following words exist only with a level. Numbers of markers in this sub-step: spray after it has moved, spray lost on the way, markers
// deleted below the band, seeded ones, and seeds without a slot.
const FLYING_NOW = 24u;
const LOST_SPRAY_NOW = 25u;
const DELETED_NOW = 26u;
const SEEDED_NOW = 27u;
const MISSING_NOW = 28u;
// The following words exist only with a level and sources, sinks or open sides. In this sub-step: spray that left, spray that
// sank, the totals of exchange_totals, and the volume of all components (see component_sums).
const LEFT_SPRAY_NOW = 29u;
const SUNK_SPRAY_NOW = 30u;
const EXCHANGED_NOW = 31u;
const LIQUID_NOW = 39u;
