//! `write_back`: u = u* - dt/(rho dx) (p_+ - p_-) on every open face with an active side (thesis 4.36). Across the
//! free surface, and on open sides of the domain, the missing pressure is 0 and the difference is divided by the
//! matrix's theta.

use super::active_cells::{THETA_OF_SIDES, theta};
use super::pressure_system::PressureSystem;
use crate::grid::Axis;
use crate::scene::ThetaFloor;

/// Updates u* (m/s) in place and returns, per face, whether its velocity is valid. `pressure` solves the system, Pa.
/// `open`, phi (`liquid_distance`, m) and the floor of theta are those of the matrix.
pub fn write_back(
    system: &PressureSystem,
    pressure: &[f64],
    open: &[Vec<f64>; 3],
    liquid_distance: &[f64],
    theta_floor: impl Into<ThetaFloor>,
    velocity: &mut [Vec<f64>; 3],
) -> [Vec<bool>; 3] {
    let (grid, phi) = (&system.stencil.grid, liquid_distance);
    let theta_floor = theta_floor.into();
    let factor = system.scale / (grid.dx * grid.dx);
    Axis::ALL.map(|axis| {
        let a = axis.index();
        let update = |(face, u): (usize, &mut f64)| {
            let sides = grid.face_sides(axis, grid.face_at(axis, face));
            let active = sides.map(|cell| cell.is_some_and(|cell| system.stencil.active(cell)));
            if open[a][face] <= 0.0 || active == [false; 2] {
                return false;
            }
            let [minus, plus] = sides.map(|cell| cell.map_or(0.0, |cell| pressure[cell]));
            let floor = theta_floor.of(open[a][face]);
            let theta = match (sides, active) {
                ([Some(minus), Some(plus)], [true, false]) => theta(phi[minus], phi[plus], floor),
                ([Some(minus), Some(plus)], [false, true]) => theta(phi[plus], phi[minus], floor),
                ([Some(_), Some(_)], _) => 1.0,
                _ => THETA_OF_SIDES,
            };
            *u -= factor * (plus - minus) / theta;
            true
        };
        velocity[a].iter_mut().enumerate().map(update).collect()
    })
}
