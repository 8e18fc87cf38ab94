// Values that the stages of a level set share. The constants of reference/level_cells.rs, liquid_distance.rs and occupancy.rs.
// Largest magnitude of a level, cells: air far from liquid, and outside the band.
const REACH = 5.0;
// Level in bodies that the extension does not reach, cells.
const AIR_IN_BODIES = 1.0;
// No bound of the level (separated_level, air_at_bodies), cells.
const NO_BOUND = -1e30;
// Occupancy of cells whose surroundings are hardly open.
const UNKNOWN_OCCUPANCY = -1.0;
