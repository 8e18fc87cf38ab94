//! Solids that swing: frequencies of the cantilever (S3), the Lame mode (S9), a bar on rollers (S10), and what backward Euler makes of
//! frequency and amplitude (S11).

use std::f64::consts::TAU;

use cutwater::linalg::dot;

use crate::Case;
use crate::lane::{Lane, Motion};
use crate::sheet::Sheet;
use crate::solid_cases::{backward_euler, bar_on_rollers, cantilever, cantilever_table, lame_cube, lame_shape};
use crate::solid_modes::{Dynamics, ringing, weights};
use crate::solid_scene::{alone, scene_of};

pub(crate) fn cases() -> Vec<Case> {
    let mut cases = vec![Case::new("S3/modes", |sheet| {
        for row in &cantilever_table()[1..] {
            modes_of_the_mesh(row.cells, row.frequencies, sheet);
        }
    })];
    for lane in Lane::PRECISE {
        let name = lane.name();
        for refinements in [1, 3] {
            let layers = cantilever_table()[refinements].cells[1];
            cases.push(Case::new(format!("S3/{layers} layers/{name}"), move |sheet| {
                ringing_cantilever(lane, refinements, sheet)
            }));
        }
        cases.push(Case::new(format!("S9/{name}"), move |sheet| lame_modes(lane, sheet)));
        cases.push(Case::new(format!("S10/{name}"), move |sheet| ringing_bar(lane, sheet)));
        cases.push(Case::new(format!("S11/{name}"), move |sheet| damped_modes(lane, sheet)));
    }
    cases
}

/// Eigenfrequencies of the mesh itself, by inverse iteration with the f64 path's matrix.
fn modes_of_the_mesh(cells: [usize; 3], frequencies: [f64; 4], sheet: &mut Sheet) {
    let solids = alone(cantilever(cells));
    let modes = Dynamics::new(&solids).modes(5, 200);
    for (number, (table, (_, square))) in frequencies.iter().zip(&modes).enumerate() {
        let what = format!("{} layers: frequency {}, Hz (scikit-fem)", cells[1], number + 1);
        // The table has eight digits.
        sheet.relative(&what, *table, square.sqrt() / TAU, 1e-6);
    }
}

/// The first two modes, started by themselves: angle per step against atan(w dt) with the table's w.
fn ringing_cantilever(lane: Lane, refinements: usize, sheet: &mut Sheet) {
    let row = &cantilever_table()[refinements];
    let mut solid = cantilever(row.cells);
    solid.loads.clear();
    let solids = alone(solid.clone());
    let modes = Dynamics::new(&solids).modes(3, 100);
    // The mesh of eight layers takes the device of a CPU long.
    let (count, steps) = if row.cells[1] > 4 { (1, 5) } else { (2, 10) };
    for ((shape, _), table) in modes.iter().zip(row.frequencies).take(count) {
        let dt = 0.3 / (TAU * table);
        let mut motion = Motion::new(lane, &scene_of(vec![solid.clone()]), dt);
        let [_, angle] = ringing(&motion.ring(shape, 1e-6, steps));
        let what = format!("{} layers: frequency of the motion, Hz", row.cells[1]);
        sheet.relative(&what, table, angle.tan() / dt / TAU, 0.005);
    }
}

/// Linear elements are of second order.
fn lame_modes(lane: Lane, sheet: &mut Sheet) {
    let mut errors = Vec::new();
    for cells in [8, 16] {
        let (solid, exact) = lame_cube(cells);
        let solids = alone(solid.clone());
        let mut shape = lame_shape(&solids);
        let modal_mass = dot(&shape, &weights(&solids, &shape));
        shape.iter_mut().for_each(|x| *x /= modal_mass.sqrt());
        let dt = 0.1 / exact;
        let amplitudes = match lane {
            Lane::F64 => {
                // Direct solves of so many nodes in a cube take long.
                let mut dynamics = Dynamics::new(&solids);
                dynamics.iterative = true;
                dynamics.ring(&shape, 1e-6, dt, 40)
            }
            _ => Motion::new(lane, &scene_of(vec![solid]), dt).ring(&shape, 1e-6, 40),
        };
        let [_, angle] = ringing(&amplitudes);
        let what = format!("Lame mode of a cube of {cells}^3 bricks, 1/s");
        let found = angle.tan() / dt;
        errors.push(found / exact - 1.0);
        // Linear elements along a line are off by (k h)^2 / 24; the mode has two waves, and tetrahedra may be twice as stiff.
        let bound = (std::f64::consts::PI / cells as f64).powi(2) / 6.0;
        sheet.relative(&what, exact, found, bound);
    }
    let what = "Lame mode of a cube: order of the error from 8^3 to 16^3 bricks";
    sheet.at_least(what, (errors[0] / errors[1]).log2(), 1.6);
}

fn ringing_bar(lane: Lane, sheet: &mut Sheet) {
    let (solid, exact) = bar_on_rollers();
    let solids = alone(solid.clone());
    let modes = Dynamics::new(&solids).modes(1, 60);
    let dt = 0.2 / exact;
    let mut motion = Motion::new(lane, &scene_of(vec![solid]), dt);
    let [_, angle] = ringing(&motion.ring(&modes[0].0, 1e-6, 20));
    sheet.relative("first mode of a bar on rollers, 1/s", exact, angle.tan() / dt, 0.005);
}

/// Amplitude and angle per step of modes of the cantilever, with and without Rayleigh damping.
fn damped_modes(lane: Lane, sheet: &mut Sheet) {
    for (damping, w_dt) in
        [([0.0, 0.0], 0.1), ([0.0, 0.0], 1.0), ([0.7, 0.0], 0.2), ([0.0, 0.02], 0.2), ([0.3, 0.02], 0.4)]
    {
        let mut solid = cantilever([10, 2, 2]);
        solid.loads.clear();
        [solid.mass_damping, solid.stiffness_damping] = damping;
        let solids = alone(solid.clone());
        let modes = Dynamics::new(&solids).modes(3, 400);
        for number in [0, 2] {
            let (shape, square) = &modes[number];
            let w = square.sqrt();
            let dt = w_dt / w;
            let [decay, angle] = backward_euler(w, dt, damping);
            let mut motion = Motion::new(lane, &scene_of(vec![solid.clone()]), dt);
            let found = ringing(&motion.ring(shape, 1e-7, 12));
            let what =
                format!("mode {}, w dt = {w_dt}, tau_M = {} 1/s, tau_K = {} s", number + 1, damping[0], damping[1]);
            sheet.relative(&format!("{what}: amplitude per step"), decay, found[0], 1e-3);
            sheet.relative(&format!("{what}: angle per step"), angle, found[1], 1e-3);
        }
    }
}
