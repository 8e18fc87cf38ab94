//! L1: a circular plate clamped in a rigid wall, water on one side (Lamb 1920).

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use glam::DVec3;

use crate::Case;
use crate::coupled_truths::{extruded, mean_velocity, simulation, step};
use crate::lane::Lane;
use crate::sheet::Sheet;
use crate::solid_modes::ringing;

pub(crate) fn cases() -> Vec<Case> {
    let case = |lane: Lane| Case::new(format!("L1/{}", lane.name()), move |sheet| plate_in_a_wall(lane, sheet));
    Lane::PRECISE.map(case).into()
}

/// Radius of the plate, m. Its centre is the corner of a box that holds a quarter of it.
const RADIUS: f64 = 0.12;
const DX: f64 = RADIUS / 6.0;
const THICKNESS: f64 = 1.2 * DX;
/// Width of the box, m.
const WIDTH: f64 = 4.0 * RADIUS;
/// Height of the plate's upper side, m: the middle of a cell, where the liquid of that cell begins.
const TOP: f64 = 3.5 * DX;
/// kg/m^3
const DENSITY: f64 = 1000.0;
/// Pa
const YOUNG: f64 = 1e7;
const POISSON: f64 = 0.3;
/// Of elements in the plate, and out to the walls.
const RINGS: usize = 8;
const ALL_RINGS: usize = 11;

/// Linear tetrahedra are stiff in bending, but their first mode has the shape it should: the frequency of the wet plate is judged over
/// that of the same mesh when dry.
fn plate_in_a_wall(lane: Lane, sheet: &mut Sheet) {
    // Lamb's shape of the mode drags 2 % more along than the exact one.
    let added = 0.6689 * 1000.0 * RADIUS / (DENSITY * THICKNESS);
    let expected = 1.0 / (1.0 + added).sqrt();
    let bending = YOUNG * THICKNESS.powi(3) / (12.0 * (1.0 - POISSON * POISSON));
    let thin = 10.2158 / (RADIUS * RADIUS) * (bending / (DENSITY * THICKNESS)).sqrt();
    let dry = frequency(lane, 0.25 / thin, false);
    let wet = frequency(lane, 0.25 / (thin * expected), true);
    let what = "plate in a wall, water on one side: frequency over that when dry";
    sheet.relative(what, expected, wet / dry, 0.05);
    sheet.info("the same: frequency when dry over that of a thin plate", format!("{:.3}", dry / thin));
}

/// Frequency of the first mode, 1/s, with steps of dt (s). Backward Euler damps the higher modes of the pushed plate first.
fn frequency(lane: Lane, dt: f64, wet: bool) -> f64 {
    // Walls L = 2 WIDTH apart drag along more than water without end, p = 0 at a distance less. They offset each other at
    // -4 zeta(1/2) beta(1/2) L / (2 pi): what the sum over the box's modes lacks of the integral over all.
    let level = TOP + 3.900_264_9 * 2.0 * WIDTH / (2.0 * PI);
    let cells = [(WIDTH / DX).round() as usize, (level / DX).ceil() as usize + 1];
    let mut text = format!(
        "[domain]
size = [{WIDTH:?}, {WIDTH:?}, {height:?}]
cells = [{across}, {across}, {up}]
gravity = [0, 0, 0]
[time]
duration = 100
frames_per_second = {:?}
fixed_step = {dt:?}
[[solid]]
name = \"plate\"
mesh = {{ file = \"plate.msh\" }}
initial = {{ velocity = [0, 0, 0.01] }}
density = {DENSITY:?}
young = {YOUNG:?}
poisson = {POISSON:?}
[[solid.pin]]
region = {{ box = {{ min = [0, 0, 0], max = [0.001, {WIDTH:?}, {TOP:?}] }} }}
components = \"x\"
[[solid.pin]]
region = {{ box = {{ min = [0, 0, 0], max = [{WIDTH:?}, 0.001, {TOP:?}] }} }}
components = \"y\"
",
        1.0 / dt,
        across = cells[0],
        up = cells[1],
        height = cells[1] as f64 * DX,
    );
    // The wall: all nodes from the plate's edge on, each beyond the tangent at some node of the edge.
    for node in 0..=2 * RINGS {
        let (sin, cos) = (FRAC_PI_4 * node as f64 / RINGS as f64).sin_cos();
        let edge = 0.999 * RADIUS;
        text += &format!(
            "[[solid.pin]]
region = {{ half_space = {{ point = [{:?}, {:?}, 0], normal = [{:?}, {:?}, 0] }} }}
",
            edge * cos,
            edge * sin,
            -cos,
            -sin,
        );
    }
    if wet {
        text += &format!(
            "[liquid]
surface = \"fixed\"
[[liquid.region]]
box = {{ min = [0, 0, {:?}], max = [{WIDTH:?}, {WIDTH:?}, {level:?}] }}
",
            TOP - 0.5 * THICKNESS,
        );
    }
    text += "[solver]\ntolerance = 1e-10\n";
    if wet {
        text += "pressure_on_patches = \"cell\"\n";
    }
    let mut simulation = simulation(lane, &text, &[("plate.msh", mesh())]);
    let velocities: Vec<f64> = (0..36)
        .map(|_| {
            step(&mut simulation);
            mean_velocity(&simulation).z
        })
        .collect();
    let [_, angle] = ringing(&velocities[12..]);
    angle.tan() / dt
}

/// A quarter of the plate and of the wall around it, two layers of wedges: squares about the corner, drawn out to circles as far as the
/// plate goes.
fn mesh() -> String {
    let side = ALL_RINGS + 1;
    let place = |number: usize| {
        let (i, j) = (number % side, number / side);
        let ring = i.max(j);
        let part = |index: usize| index as f64 / ring.max(1) as f64;
        let angle = match i >= j {
            true => FRAC_PI_4 * part(j),
            false => FRAC_PI_2 - FRAC_PI_4 * part(i),
        };
        let circle = RADIUS * DVec3::new(angle.cos(), angle.sin(), 0.0);
        if ring <= RINGS {
            return ring as f64 / RINGS as f64 * circle;
        }
        let out = (ring - RINGS) as f64 / (ALL_RINGS - RINGS) as f64;
        circle.lerp(WIDTH * DVec3::new(part(i), part(j), 0.0), out)
    };
    let flat: Vec<DVec3> = (0..side * side).map(place).collect();
    let mut triangles = Vec::new();
    for j in 0..ALL_RINGS {
        for i in 0..ALL_RINGS {
            let [a, b] = [j, j + 1].map(|j| j * side + i);
            triangles.extend([[a, a + 1, b + 1], [a, b + 1, b]]);
        }
    }
    let heights = [1.0, 0.5, 0.0].map(|below| TOP - below * THICKNESS);
    extruded(&flat, &triangles, &heights)
}
