//! Solids of which something is known exactly, or from other programs: small in the suite, larger in the validation.

use cutwater::elastic::{Solids, lame_parameters};
use cutwater::reference::larger;
use cutwater::scene::{Load, LoadKind, Pin, Scene, Shape, Solid};
use glam::DVec3;

use crate::common::Random;
use crate::solid_scene::{block, rows, scene_of, solids_of};

/// Where the low corner of a body lies: far from the walls.
pub(crate) const CORNER: DVec3 = DVec3::new(1.0, 2.0, 2.0);

/// The nodes that rest in a box.
pub(crate) fn region(min: impl Into<DVec3>, max: impl Into<DVec3>) -> Shape {
    Shape::Box { min: min.into(), max: max.into() }
}

pub(crate) fn held(region: Shape, components: [bool; 3]) -> Pin {
    Pin { region, components, keyframes: Vec::new(), pivot: None }
}

/// The nodes that rest at a distance from the corner along x, m.
fn section(x: f64) -> Shape {
    region([CORNER.x + x, 0.0, 0.0], [CORNER.x + x, 4.0, 4.0])
}

/// A bar of 1 x 0.1 x 0.1 m; E = 1 MPa, nu = 0.3, 1000 kg/m^3.
fn bar(cells: [usize; 3]) -> Solid {
    let mut solid = block([1.0, 0.1, 0.1], cells);
    solid.placement.translate += CORNER;
    solid
}

/// The cantilever of the tables: held at one end, pulled along -z at the other.
pub(crate) fn cantilever(cells: [usize; 3]) -> Solid {
    let mut solid = bar(cells);
    solid.pins = vec![held(section(0.0), [true; 3])];
    solid.loads =
        vec![Load { region: section(1.0), kind: LoadKind::Force(DVec3::new(0.0, 0.0, -0.01)), keyframes: Vec::new() }];
    solid
}

/// Mean displacement of the cantilever's tip along z by Timoshenko's theory, m.
pub(crate) const TIMOSHENKO: f64 = -0.00040312;

/// Mean displacement of the tip along z, m.
pub(crate) fn tip(solids: &Solids, u: &[[f64; 3]]) -> f64 {
    let nodes = (0..u.len()).filter(|&node| solids.rest[node].x > CORNER.x + 1.0 - 1e-9);
    let at_tip: Vec<f64> = nodes.map(|node| u[node][2]).collect();
    at_tip.iter().sum::<f64>() / at_tip.len() as f64
}

/// What other programs find for the cantilever.
pub(crate) struct CantileverRow {
    pub(crate) cells: [usize; 3],
    /// m
    pub(crate) tip: f64,
    /// Hz
    pub(crate) frequencies: [f64; 4],
}

/// The rows of the table, from coarse to fine: 1, 2, 4, 8 layers.
pub(crate) fn cantilever_table() -> Vec<CantileverRow> {
    let table = include_str!("../data/cantilever_tet4_convergence.csv");
    let row = |row: Vec<&str>| {
        let number = |column: usize| row[column].parse::<f64>().unwrap();
        let [along, across] = [0, 1].map(|column| row[column].parse().unwrap());
        CantileverRow { cells: [along, across, across], tip: number(4), frequencies: [6, 7, 8, 9].map(number) }
    };
    rows(table).map(row).collect()
}

/// Largest distance of the nodes of the cantilever of 10 x 2 x 2 bricks from where scikit-fem and CalculiX have them, over the mean
/// displacement of its tip.
pub(crate) fn worst_of_nodal_table(solids: &Solids, u: &[[f64; 3]]) -> f64 {
    let table = rows(include_str!("../data/cantilever_tet4_nodal.csv"));
    let errors = table.map(|row| {
        let numbers: Vec<f64> = row[1..].iter().map(|x| x.parse().unwrap()).collect();
        let at = CORNER + DVec3::from_slice(&numbers);
        let mut rest = solids.rest.iter();
        let node = rest.position(|rest| rest.distance(at) < 1e-12).unwrap();
        DVec3::from(u[node]).distance(DVec3::from_slice(&numbers[3..]))
    });
    let errors: Vec<f64> = errors.collect();
    assert_eq!((errors.len(), u.len()), (99, 99));
    errors.into_iter().fold(0.0, larger) / 1.4162e-4
}

/// A bar on rollers, held at one end, and the angular frequency of its first mode, exactly (1/s).
pub(crate) fn bar_on_rollers() -> (Solid, f64) {
    let mut solid = bar([20, 2, 2]);
    solid.pins = vec![held(region([0.0; 3], [4.0; 3]), [false, true, true]), held(section(0.0), [true, false, false])];
    let [lambda, mu] = lame_parameters(solid.young, solid.poisson);
    let exact = 0.5 * std::f64::consts::PI * ((lambda + 2.0 * mu) / solid.density).sqrt();
    (solid, exact)
}

/// A free cube of 1 m with that many bricks along an edge, and the angular frequency of its Lame mode, exactly (1/s).
pub(crate) fn lame_cube(cells: usize) -> (Solid, f64) {
    let mut solid = block([1.0; 3], [cells; 3]);
    solid.placement.translate = DVec3::splat(2.0);
    let [_, mu] = lame_parameters(solid.young, solid.poisson);
    let exact = 2.0_f64.sqrt() * std::f64::consts::PI * (mu / solid.density).sqrt();
    (solid, exact)
}

/// The shape of the Lame mode: (cos pi x sin pi y, -sin pi x cos pi y, 0).
pub(crate) fn lame_shape(solids: &Solids) -> Vec<f64> {
    let nodes = solids.rest.iter();
    nodes
        .flat_map(|x| {
            let [x, y] = [x.x, x.y].map(|x| std::f64::consts::PI * (x - 1.5));
            [x.cos() * y.sin(), -x.sin() * y.cos(), 0.0]
        })
        .collect()
}

/// Decay and angle (rad) per step of an undamped or Rayleigh-damped mode of w (1/s) under backward Euler with steps of dt (s): modulus and
/// argument of the roots of z^2 s - z (2 + dt tau_M + dt tau_K w^2) + 1 = 0, s = 1 + dt tau_M + dt tau_K w^2 + w^2 dt^2 (thesis, 3.51).
pub(crate) fn backward_euler(w: f64, dt: f64, [mass, stiffness]: [f64; 2]) -> [f64; 2] {
    let damped = dt * mass + dt * stiffness * w * w;
    let sum = 1.0 + damped + w * w * dt * dt;
    let decay = 1.0 / sum.sqrt();
    [decay, (0.5 * (2.0 + damped) / sum / decay).acos()]
}

/// A free block of 125 kg, at rest without strain, or spinning, stretched and drifting.
pub(crate) fn flying_block(strained: bool) -> Scene {
    let mut solid = block([0.5; 3], [3, 3, 3]);
    solid.placement.translate = DVec3::new(2.0, 3.0, 2.0);
    if strained {
        solid.initial.spin = DVec3::new(3.0, 5.0, -2.0);
        solid.initial.scale = DVec3::new(1.3, 0.8, 1.0);
        solid.initial.velocity = DVec3::new(0.5, 1.0, -0.5);
    }
    scene_of(vec![solid])
}

/// Sizes (m) and seeds of [`thrown_about`] that leave 35 to 152 of the 336 elements of [`hung_beam`] inverted.
pub(crate) const THROWS: [(f64, u64); 6] = [(0.025, 1), (0.028, 2), (0.032, 3), (0.036, 4), (0.042, 1), (0.06, 3)];

/// The beam of the base scene (numerics section 6), hung up at its top, under gravity.
pub(crate) fn hung_beam() -> Scene {
    let mut solid = block([0.08, 0.56, 0.08], [2, 14, 2]);
    solid.placement.translate = DVec3::new(2.0, 2.0, 2.0);
    (solid.poisson, solid.density) = (0.4, 1100.0);
    solid.pins = vec![held(region([0.0, 2.28, 0.0], [4.0; 3]), [true; 3])];
    let mut scene = scene_of(vec![solid]);
    scene.domain.gravity = DVec3::new(0.0, -9.81, 0.0);
    scene
}

/// Displacements of the beam with its free nodes thrown about, and how many elements that inverts.
pub(crate) fn thrown_about(scene: &Scene, (size, seed): (f64, u64)) -> (Vec<[f64; 3]>, usize) {
    let solids = solids_of(scene);
    let mut random = Random(seed);
    let u: Vec<[f64; 3]> = solids
        .prescribed
        .iter()
        .map(|held| match held {
            [false, false, false] => std::array::from_fn(|_| random.uniform(-size, size)),
            _ => [0.0; 3],
        })
        .collect();
    let inverted = inverted(&solids, &u);
    (u, inverted)
}

/// Elements with a determinant of 0 or less.
pub(crate) fn inverted(solids: &Solids, u: &[[f64; 3]]) -> usize {
    (0..solids.elements.len()).filter(|&element| solids.stress_and_determinant(element, u)[1] <= 0.0).count()
}
