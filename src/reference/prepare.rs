//! `prepare`: what the first step reads beyond the initial markers and velocities.

use super::diagnose::{liquid_volume, open_volumes};
use super::extrapolate::{MovingWalls, extrapolate, n_layers};
use super::liquid_distance::liquid_distance;
use crate::geometry::{CutCells, SolidClip};
use crate::grid::{Axis, Grid};
use crate::scene::{Scene, Surface};
use crate::state::State;

/// Completes an initial state: the liquid distance that the markers make, the volume to hold, and velocities beyond the
/// liquid, so that markers at the border of a moving region move with it. `solids`: where they are, with the nodes of their surface
/// triangles. Doing it twice changes nothing.
pub fn prepare(
    scene: &Scene,
    grid: &Grid,
    cut: &CutCells,
    solids: Option<(&SolidClip, &[[u32; 3]])>,
    state: &mut State,
) {
    let Some(liquid) = &scene.liquid else { return };
    if liquid.surface == Surface::Markers {
        state.liquid_distance =
            liquid_distance(grid, cut, &state.markers, liquid.marker_radius * grid.dx);
    }
    state.volume_0 = liquid_volume(
        grid,
        &open_volumes(grid, &cut.solid_distance),
        &state.liquid_distance,
    );
    let valid = Axis::ALL.map(|axis| {
        let beside_liquid = |face| {
            let sides = grid.face_sides(axis, grid.face_at(axis, face));
            sides
                .into_iter()
                .flatten()
                .any(|cell| state.liquid_distance[cell] < 0.0)
        };
        let open = cut.open[axis.index()].iter().enumerate();
        open.map(|(face, &open)| open > 0.0 && beside_liquid(face))
            .collect()
    });
    let walls = solids.map(|(clip, triangles)| MovingWalls {
        clip,
        triangles,
        velocity: &state.node_velocity,
    });
    extrapolate(
        grid,
        cut,
        walls,
        valid,
        n_layers(scene.time.cfl),
        &mut state.velocity,
    );
}
