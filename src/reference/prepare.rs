//! `prepare`: data of the first step beyond initial markers and velocities.

use super::active_cells::active_cells;
use super::ballistic::ballistic_cells;
use super::diagnose::{liquid_volume, open_volumes};
use super::extrapolate::{MovingWalls, extrapolate, n_layers};
use super::level_cells::{LevelCells, REACH, in_cells};
use super::liquid_components::liquid_components;
use super::liquid_distance::{extend_level, liquid_distance};
use super::marker_band::{Markers, first_markers};
use super::redistance::redistance;
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
    let open_volumes = open_volumes(grid, &cut.solid_distance);
    state.volume_0 = match liquid.surface {
        Surface::Level => prepare_level(grid, cut, &open_volumes, state),
        Surface::Markers | Surface::Fixed => {
            liquid_volume(grid, &open_volumes, &state.liquid_distance)
        }
    };
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
    if liquid.surface == Surface::Level {
        let seed = (liquid.seed ^ (liquid.seed >> 32)) as u32;
        let level = in_cells(grid, &state.liquid_distance);
        let positions = first_markers(grid, &cut.solid_distance, &level, seed);
        let mut markers = Markers::default();
        markers.extend(grid, &state.velocity, &positions);
        state.put_markers(markers);
    }
}

/// Makes a level of the exact distance, and labels its components. Returns their volume, m^3.
fn prepare_level(grid: &Grid, cut: &CutCells, open_volumes: &[f64], state: &mut State) -> f64 {
    let distance = state.liquid_distance.iter();
    let mut level: Vec<f64> = distance
        .map(|phi| (phi / grid.dx).clamp(-REACH, REACH))
        .collect();
    extend_level(grid, cut, &mut level);
    let mut level = redistance(LevelCells { grid, cut }, &level);
    extend_level(grid, cut, &mut level);
    state.liquid_distance = level.iter().map(|phi| phi * grid.dx).collect();
    let components = liquid_components(grid, &cut.open, open_volumes, &level);
    state.component = components.label;
    state.component_volume = components.volume;
    state.component_volume.iter().sum()
}
