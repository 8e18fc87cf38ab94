// Least level in cells of sinks, cells, as in reference/level_exchange.rs.
const SINK_LEVEL = 0.5;
