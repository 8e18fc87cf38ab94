// Filled fraction of a cell whose centre has the level phi, cells, as in reference/level_cells.rs; with minus the distance to
// bodies its open fraction.
fn filled_part(phi: f32) -> f32 {
    return clamp(0.5 - phi, 0.0, 1.0);
}
