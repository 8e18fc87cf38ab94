// Liquid distance of a cell that has none yet; other values are at most a few cells.
const UNKNOWN = 3e38;
