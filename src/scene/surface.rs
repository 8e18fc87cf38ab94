//! Settings of the liquid's surface mesh.

use super::SurfaceMesh;
use super::document::{Keys, Table};
use crate::error::Error;

const SURFACE: Keys = Keys::new(&["radius", "smoothing"]);

/// Radii, cells. Below, dense liquid has holes, since markers are half a cell apart. Above, a drop is as large as a wave.
const RADII: std::ops::RangeInclusive<f64> = 0.6..=3.0;

impl Default for SurfaceMesh {
    fn default() -> SurfaceMesh {
        SurfaceMesh { radius: 0.95, smoothing: 20 }
    }
}

pub(super) fn surface(root: &Table, has_markers: bool) -> Result<SurfaceMesh, Error> {
    let default = SurfaceMesh::default();
    let Some(place) = root.get("surface") else {
        return Ok(default);
    };
    place.ensure(has_markers, "sets the mesh around markers, and the scene has none", "remove it")?;
    let table = place.table(&SURFACE)?;
    Ok(SurfaceMesh {
        radius: table.optional("radius", default.radius, |place| {
            place.positive_within(
                "the surface's distance from a marker alone in cells",
                RADII,
                "use 0.6 to 3 cells; 0.95 matches the simulated surface",
            )
        })?,
        smoothing: table.optional("smoothing", default.smoothing, |place| {
            Ok(place.count("the smoothing iterations", 0, 1000)? as u32)
        })?,
    })
}
