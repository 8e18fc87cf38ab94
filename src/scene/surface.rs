//! How the mesh of the liquid's surface is made.

use super::SurfaceMesh;
use super::document::{Keys, Table};
use crate::error::Error;

const SURFACE: Keys = Keys {
    valid: &["radius", "smoothing"],
    absent: &[],
};

/// Radii, cells: below, a dense body has holes, since markers are half a cell apart; above, a drop is as large as a wave.
const RADII: std::ops::RangeInclusive<f64> = 0.6..=3.0;

impl Default for SurfaceMesh {
    fn default() -> SurfaceMesh {
        SurfaceMesh {
            radius: 0.95,
            smoothing: 20,
        }
    }
}

/// The mesh of a scene's surface; `from_markers`: whether there is one to make from markers.
pub(super) fn surface(root: &Table, from_markers: bool) -> Result<SurfaceMesh, Error> {
    let mut surface = SurfaceMesh::default();
    let Some(place) = root.get("surface") else {
        return Ok(surface);
    };
    place.ensure(
        from_markers,
        "is about the mesh around markers, and the scene has none",
        "remove it",
    )?;
    let table = place.table(&SURFACE)?;
    if let Some(place) = table.get("radius") {
        surface.radius = place.positive("the surface's distance from a marker alone in cells")?;
        place.within(
            surface.radius,
            RADII,
            format!("is {}", surface.radius),
            "use 0.6 to 3 cells; 0.95 is where the simulated surface is",
        )?;
    }
    if let Some(place) = table.get("smoothing") {
        surface.smoothing = place.count("the rounds of smoothing", 0, 1000)? as u32;
    }
    Ok(surface)
}
