//! `prepare`: data of the first step beyond initial markers and velocities.

use super::active_cells::active_cells;
use super::ballistic::ballistic_cells;
use super::diagnose::{liquid_volume, open_volumes};
use super::extrapolate::{MovingWalls, extrapolate, n_layers};
use super::liquid_distance::liquid_distance;
use crate::geometry::{CutCells, SolidClip};
use crate::grid::{Axis, Grid};
use crate::scene::{Scene, Surface};
use crate::state::State;

/// Completes an initial state: the liquid distance from the markers, what is ballistic, the controlled volume, and velocities beyond the
/// liquid. Markers at the border of a moving region then move with it. `solids`: positions, with the nodes of their
/// surface triangles. A second call changes nothing.
pub fn prepare(
    scene: &Scene,
    grid: &Grid,
    cut: &CutCells,
    solids: Option<(&SolidClip, &[[u32; 3]])>,
    state: &mut State,
) {
    let Some(liquid) = &scene.liquid else { return };
    if liquid.surface == Surface::Markers {
        let radius = liquid.marker_radius * grid.dx;
        state.liquid_distance = liquid_distance(grid, cut, &state.markers, radius);
        let phi = &state.liquid_distance;
        let start = active_cells(grid, &cut.open, phi, scene.solver.theta_floor);
        state.ballistic = ballistic_cells(&cut.open, &start.stencil);
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
