//! `prepare`: data of the first sub-step in addition to initial markers and velocities.

use glam::DVec3;
use rayon::prelude::*;

use super::active_cells::active_cells;
use super::ballistic::ballistic_cells;
use super::diagnose::{liquid_volume, open_volumes};
use super::extrapolate::{MovingWalls, extrapolate, n_layers};
use super::level_cells::{LevelCells, REACH, in_cells, interpolant_part};
use super::liquid_components::{Components, liquid_components};
use super::liquid_distance::{extend_level, liquid_distance};
use super::marker_band::{Markers, first_markers};
use super::redistance::redistance;
use super::volume_shift::{largest_shift, volume_shift};
use crate::Error;
use crate::geometry::{CutCells, LiquidSurface, SolidClip};
use crate::grid::{Axis, Grid};
use crate::scene::{Scene, Surface};
use crate::state::State;

/// Level beyond which the surface does not cut a cell, cells: half a diagonal, and the error of a redistanced level.
const CUT: f64 = 1.2;
/// Samples of a cell along each axis.
const SAMPLES: usize = 4;
/// Largest number of shifts towards the initial volume. Drops of a cell need three tenths of a cell.
const SHIFTS: usize = 10;

/// Completes an initial state: the liquid distance from the markers, what is ballistic, the controlled volume, and velocities beyond the
/// liquid. Markers at the border of a moving region then move with it. `solids`: positions, with the nodes of their
/// surface triangles. A second call changes nothing.
pub fn prepare(
    scene: &Scene,
    grid: &Grid,
    cut: &CutCells,
    solids: Option<(&SolidClip, &[[u32; 3]])>,
    state: &mut State,
) -> Result<(), Error> {
    let Some(liquid) = &scene.liquid else {
        return Ok(());
    };
    let surface = LiquidSurface::new(scene, grid)?;
    let surface = surface.filter(|_| liquid.surface == Surface::Level);
    if liquid.surface == Surface::Markers {
        let radius = liquid.marker_radius * grid.dx;
        state.liquid_distance = liquid_distance(grid, cut, &state.markers, radius);
        let phi = &state.liquid_distance;
        let start = active_cells(grid, &cut.open, phi, scene.solver.theta_floor);
        state.ballistic = ballistic_cells(&cut.open, &start.stencil);
    }
    let open_volumes = open_volumes(grid, &cut.solid_distance);
    state.volume_0 = match &surface {
        Some(surface) => prepare_level(grid, cut, &open_volumes, surface, state),
        None => liquid_volume(grid, &open_volumes, &state.liquid_distance),
    };
    let valid = Axis::ALL.map(|axis| {
        let beside_liquid = |face| {
            let sides = grid.face_sides(axis, grid.face_at(axis, face));
            sides.into_iter().flatten().any(|cell| state.liquid_distance[cell] < 0.0)
        };
        let open = cut.open[axis.index()].iter().enumerate();
        open.map(|(face, &open)| open > 0.0 && beside_liquid(face)).collect()
    });
    let walls = solids.map(|(clip, triangles)| MovingWalls { clip, triangles, velocity: &state.node_velocity });
    extrapolate(grid, cut, walls, valid, n_layers(scene.time.cfl), &mut state.velocity);
    if let Some(surface) = surface {
        let seed = (liquid.seed ^ (liquid.seed >> 32)) as u32;
        let level = in_cells(grid, &state.liquid_distance);
        let positions = first_markers(grid, &cut.solid_distance, &level, |x| surface.distance(x) < 0.0, seed);
        let mut markers = Markers::default();
        markers.extend(grid, &state.velocity, &positions);
        state.put_markers(markers);
    }
    Ok(())
}

/// Makes a level of the exact distance, and labels its components. Their target volumes are those of the liquid between its
/// surface and the bodies; where the interpolant of the distance has less, as that of a ball, the level moves. Returns their sum,
/// m^3.
fn prepare_level(grid: &Grid, cut: &CutCells, open_volumes: &[f64], surface: &LiquidSurface, state: &mut State) -> f64 {
    let distance = state.liquid_distance.iter();
    let mut level: Vec<f64> = distance.map(|phi| (phi / grid.dx).clamp(-REACH, REACH)).collect();
    extend_level(grid, cut, &mut level);
    let mut level = redistance(LevelCells { grid, cut }, &[], &level);
    extend_level(grid, cut, &mut level);
    let mut components = liquid_components(grid, &cut.open, open_volumes, &level);
    let part = |cell: usize| match components.label[cell] {
        0 => 0.0,
        _ => open_volumes[cell] * part_inside(grid, surface, level[cell], cell),
    };
    let parts: Vec<f64> = (0..grid.n_cells()).into_par_iter().map(part).collect();
    let targets = component_sums(&components, &parts);
    state.liquid_distance = level.iter().map(|phi| phi * grid.dx).collect();
    for _ in 0..SHIFTS {
        let distance = &mut state.liquid_distance;
        let whole = ([1.0; 2], largest_shift(0.0));
        let shifts = volume_shift(grid, open_volumes, &cut.solid_distance, &components, &targets, whole, distance);
        if shifts.iter().all(|&shift| shift == 0.0) {
            break;
        }
        let level = in_cells(grid, distance);
        let part = |cell: usize| match components.label[cell] {
            0 => 0.0,
            _ => open_volumes[cell] * interpolant_part(grid, &level, cell),
        };
        let parts: Vec<f64> = (0..grid.n_cells()).into_par_iter().map(part).collect();
        components.volume = component_sums(&components, &parts);
    }
    state.component = components.label;
    state.component_volume = targets;
    state.component_volume.iter().sum()
}

/// Sums of the values of the cells with a label.
fn component_sums(components: &Components, values: &[f64]) -> Vec<f64> {
    let mut sums = vec![0.0; components.volume.len()];
    let pairs = components.label.iter().zip(values);
    pairs.filter(|(label, _)| **label > 0).for_each(|(&label, value)| sums[label as usize - 1] += value);
    sums
}

/// Part of a cell with the level phi (cells) inside the surface, by samples.
fn part_inside(grid: &Grid, surface: &LiquidSurface, phi: f64, cell: usize) -> f64 {
    if phi.abs() > CUT {
        return f64::from(u8::from(phi < 0.0));
    }
    let n = SAMPLES as f64;
    let corner = DVec3::from(grid.cell_at(cell).map(|n| n as f64));
    let samples = (0..SAMPLES.pow(3)).map(|sample| {
        let at = [0, 1, 2].map(|a| (sample / SAMPLES.pow(a) % SAMPLES) as f64 + 0.5);
        let distance = surface.distance((corner + DVec3::from(at) / n) * grid.dx);
        (0.5 - n * distance / grid.dx).clamp(0.0, 1.0)
    });
    samples.sum::<f64>() / n.powi(3)
}
