//! `diagnose`: volume, momentum, energies, speed and divergence.
//!
//! The mass of a cell is m_c = rho V_c clamp(1/2 - phi/dx, 0, 1) at its centre, with V_c its open volume. Its
//! velocity v_c is the mean of opposite faces:
//!
//! ```text
//! momentum = sum m_c v_c,  kinetic energy = sum m_c |v_c|^2 / 2,  potential energy = - sum m_c g . x_c
//! ```

use glam::DVec3;

use super::level_cells::filled_distance;
use super::pressure_system::Stencil;
use super::right_hand_side::inflow;
use super::spray::add_spray;
use crate::geometry::{CutCells, open_volume};
use crate::grid::{Axis, Grid};
use crate::scene::{Scene, Surface};
use crate::state::{Diagnosis, State};

/// Open volume of every cell, m^3.
pub fn open_volumes(grid: &Grid, solid_distance: &[f64]) -> Vec<f64> {
    solid_distance.iter().map(|&distance| grid.cell_volume() * open_volume(distance, grid.dx)).collect()
}

/// Liquid volume, m^3: sum over all cells of their open volume times clamp(1/2 - phi/dx, 0, 1).
pub fn liquid_volume(grid: &Grid, open_volume: &[f64], liquid_distance: &[f64]) -> f64 {
    let filled = |(open, phi): (&f64, &f64)| open * (0.5 - phi / grid.dx).clamp(0.0, 1.0);
    open_volume.iter().zip(liquid_distance).map(filled).sum()
}

/// Largest magnitude of a face velocity component, m/s; NaN if any is NaN.
pub fn max_speed(velocity: &[Vec<f64>; 3]) -> f64 {
    velocity.iter().flatten().map(|u| u.abs()).fold(0.0, larger)
}

/// The larger of two numbers; NaN if either is NaN.
pub fn larger(a: f64, b: f64) -> f64 {
    if a >= b || a.is_nan() { a } else { b }
}

/// Largest divergence in an active cell after the projection, 1/s; NaN if any is NaN. `velocity`: face velocities
/// before extrapolation, m/s. `open`: face apertures, including those of sources. `flux`: prescribed boundary flux J
/// v of solids and obstacles per cell, m^3/s.
pub fn divergence(open: &[Vec<f64>; 3], velocity: &[Vec<f64>; 3], stencil: &Stencil, flux: Option<&[f64]>) -> f64 {
    let grid = &stencil.grid;
    let active = (0..grid.n_cells()).filter(|&cell| stencil.active(cell));
    let left = active.map(|cell| {
        let taken = flux.map_or(0.0, |flux| flux[cell]);
        inflow(grid, open, velocity, cell).0 - taken
    });
    left.map(f64::abs).fold(0.0, larger) / grid.cell_volume()
}

/// Diagnostics of the liquid of a state: of a level by the filled part of its interpolant, with the spray. `divergence` from
/// [`divergence`]. `None` without liquid.
pub fn diagnose_liquid(scene: &Scene, cut: &CutCells, state: &State, divergence: f64) -> Option<Diagnosis> {
    let liquid = scene.liquid.as_ref()?;
    let (grid, density, gravity) = (&scene.grid(), liquid.density, scene.domain.gravity);
    let filled = (liquid.surface == Surface::Level).then(|| filled_distance(grid, &state.liquid_distance));
    let distance = filled.as_ref().unwrap_or(&state.liquid_distance);
    let mut sums = diagnose(grid, cut, distance, &state.velocity, divergence, density, gravity);
    add_spray(grid, (density, gravity), state.flying(), &mut sums);
    Some(sums)
}

/// Diagnostics of the liquid. `divergence` from [`divergence`]; `density` in kg/m^3, `gravity` in m/s^2, others as in
/// [`crate::state::State`].
pub fn diagnose(
    grid: &Grid,
    cut: &CutCells,
    liquid_distance: &[f64],
    velocity: &[Vec<f64>; 3],
    divergence: f64,
    density: f64,
    gravity: DVec3,
) -> Diagnosis {
    let open_volumes = open_volumes(grid, &cut.solid_distance);
    let mut momentum = DVec3::ZERO;
    let (mut kinetic_energy, mut potential_energy) = (0.0, 0.0);
    for cell in 0..grid.n_cells() {
        let ijk = grid.cell_at(cell);
        let mass = density * open_volumes[cell] * (0.5 - liquid_distance[cell] / grid.dx).clamp(0.0, 1.0);
        if mass > 0.0 {
            let v = cell_velocity(grid, velocity, ijk);
            momentum += mass * v;
            kinetic_energy += 0.5 * mass * v.length_squared();
            potential_energy -= mass * gravity.dot(grid.cell_centre(ijk));
        }
    }
    Diagnosis {
        volume: liquid_volume(grid, &open_volumes, liquid_distance),
        momentum: momentum.to_array(),
        kinetic_energy,
        potential_energy,
        max_speed: max_speed(velocity),
        divergence,
    }
}

/// Mean of the opposite faces of a cell, m/s.
fn cell_velocity(grid: &Grid, velocity: &[Vec<f64>; 3], ijk: [usize; 3]) -> DVec3 {
    DVec3::from(Axis::ALL.map(|axis| {
        let a = axis.index();
        let mut plus = ijk;
        plus[a] += 1;
        0.5 * (velocity[a][grid.face(axis, ijk)] + velocity[a][grid.face(axis, plus)])
    }))
}
