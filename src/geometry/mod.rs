//! Shapes, clipping, open face areas and the distance to obstacles, on the CPU in f64. parry lives here only.

/// What the obstacles leave of the grid. Static: computed once.
#[derive(Clone, Debug)]
pub struct CutCells {
    /// Open fraction of every face per axis (host face layout, 0 to 1): clamped, domain walls closed.
    pub open: [Vec<f64>; 3],
    /// Signed distance of every cell centre to the obstacles, m; negative inside, exact within 3 cells of a surface and
    /// clipped to +-3 dx beyond. 3 dx everywhere without obstacles.
    pub solid_distance: Vec<f64>,
}
