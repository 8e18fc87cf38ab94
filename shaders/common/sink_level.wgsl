// Least level in cells of sinks, cells, as in reference/level_exchange.rs.
const SINK_LEVEL = 0.5;
// Volume that a shift of the level may leave in such a cell, volumes of a cell: the largest shift (reference/volume_shift.rs).
const SINK_REST = 0.04;
