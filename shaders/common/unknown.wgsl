// Liquid distance of a cell that has none yet; real ones are at most a few cells.
const UNKNOWN = 3e38;
