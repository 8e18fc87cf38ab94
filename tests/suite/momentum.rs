//! Momentum across the projection. What the liquid gains in a sub-step, with the mass that B gives to each face, is what solids, walls,
//! obstacles and the free surface push; and what solids gain is what the liquid pushes.
//!
//! On the faces of an axis the update u = u* - dt/(rho dx) (p_+ - p_-) sums up, with the masses m = rho dx^3 A theta, to
//!
//! ```text
//! sum of m (u - u*) = dt sum over the active cells of p (A_+ - A_-)
//! ```
//!
//! for p = 0 at the free surface. Of the face of a cell that is not open, dx^2 - A, a part lies in solids, a part in obstacles or on a wall
//! of the domain, and a sliver may be clamped. Where A and the patches close each cell, the pressure times the part in solids is J^T p. That
//! part is measured here by itself: the section of every tetrahedron with every face of the grid.

use std::fs;

use cutwater::elastic::Solids;
use cutwater::grid::{Axis, Grid};
use cutwater::reference::{Ballistic, Stencil, StepSystem, TimeStep, advect_velocity, forces};
use cutwater::scene::Scene;
use cutwater::sim::{GpuPath, reference_path};
use cutwater::state::{SolveStatus, StepReport};
use cutwater::step::Stage;
use glam::DVec3;

use crate::common::{adapter, gpu};

const DENSITY: f64 = 1000.0;

/// Low and high corner, m. Nothing of it lies on a plane of the grid.
type Block = [[f64; 3]; 2];

struct Case {
    name: &'static str,
    scene: Scene,
    obstacles: Vec<Block>,
    /// Whether nothing but liquid and gravity acts on the solids.
    free: bool,
}

fn cases() -> Vec<Case> {
    let case = |name, text: String, obstacles: &[Block], free| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("test.toml");
        let boxes =
            obstacles.iter().map(|[low, high]| format!("[[obstacle]]\nbox = {{ min = {low:?}, max = {high:?} }}\n"));
        fs::write(&path, text + &boxes.collect::<String>()).unwrap();
        let (obstacles, scene) = (obstacles.to_vec(), Scene::load(&path, &[], 1.0).unwrap());
        Case { name, scene, obstacles, free }
    };
    let tank = |liquid: &str, solid: &str| {
        format!(
            "[domain]
size = [1, 1, 1]
cells = [12, 12, 12]
[time]
duration = 1
frames_per_second = 50
fixed_step = 0.02
[liquid]
{liquid}
[[solid]]
name = \"solid\"
{solid}
[solver]
tolerance = 1e-11
"
        )
    };
    let ball = "mesh = { sphere = { radius = 0.2, cell_size = 0.1 } }
placement = { translate = [0.47, 0.46, 0.52] }
initial = { velocity = [0.4, -0.3, 0.2], spin = [1, 2, 3] }
density = 400.0
young = 1e5
poisson = 0.35
damping = { stiffness = 0.01 }";
    let beam = "mesh = { box = { size = [0.15, 0.7, 0.2], cells = [2, 4, 2] } }
placement = { translate = [0.47, 0.35, 0.52], rotate = { axis = [0, 1, 0], degrees = 20 } }
density = 1100.0
young = 1e5
poisson = 0.35
damping = { stiffness = 0.01 }
[[solid.pin]]
region = { box = { min = [0, 0, 0], max = [1, 0.001, 1] } }
[[solid]]
name = \"plank\"
mesh = { box = { size = [0.3, 0.07, 0.2], cells = [3, 1, 2] } }
placement = { translate = [0.78, 0.61, 0.27], rotate = { axis = [1, 2, 3], degrees = 37 } }
density = 300.0
young = 1e5
poisson = 0.35
damping = { stiffness = 0.01 }";
    let post = [[0.7, 0.04, 0.11], [0.93, 0.35, 0.4]];
    let bar = [[-0.1, 0.53, 0.83], [1.1, 0.71, 0.95]];
    let fixed = "surface = \"fixed\"\n[[liquid.region]]\nhalf_space = { point = [0, 0.57, 0], normal = [0.1, 1, 0.05] }\nvelocity = [0.5, 0.2, -0.3]";
    let full = "surface = \"fixed\"\n[[liquid.region]]\nhalf_space = { point = [0, 2, 0], normal = [0, 1, 0] }";
    let markers = "surface = \"markers\"\n[[liquid.region]]\nbox = { min = [0, 0, 0], max = [0.6, 0.8, 1] }";
    vec![
        case("a ball in the surface", tank(fixed, ball), &[post, bar], true),
        case("a ball in a full tank", tank(full, ball), &[post], true),
        case("a ball that meets a column", tank(markers, ball), &[bar], true),
        case("a beam on the floor, and a plank", tank(fixed, beam), &[bar], false),
    ]
}

/// What a sub-step left behind.
struct Moment<'a> {
    case: &'a Case,
    grid: Grid,
    dt: f64,
    /// Open fractions.
    open: [Vec<f64>; 3],
    /// Weights and Dirichlet parts of B.
    weight: [Vec<f64>; 3],
    dirichlet: Vec<f64>,
    /// m
    phi: Vec<f64>,
    active: Vec<bool>,
    /// Pa
    pressure: Vec<f64>,
    /// u* and u, m/s.
    faces: [[Vec<f64>; 3]; 2],
    /// v* and v, m/s.
    nodes: [Vec<[f64; 3]>; 2],
    /// m
    displacement: Vec<[f64; 3]>,
    report: StepReport,
}

impl Moment<'_> {
    /// Checks all balances. `rounding`: of the root of the sum of the squares of what they sum up; `closed`: how far open fractions may be
    /// from those measured here.
    fn check(&self, solids: &Solids, rounding: f64, closed: f64) {
        let Moment { case, grid, dt, report, .. } = self;
        let what = format!("{}: {report:?}", case.name);
        let coupling = report.coupling.unwrap();
        let [force, correction] = [coupling.force, coupling.correction].map(DVec3::from);
        for solve in report.solves() {
            assert_eq!(solve.status, SolveStatus::Converged, "{what}");
        }
        assert!(coupling.touching && coupling.overlap_cells == 0, "{what}");

        let sections = sections(grid, solids, &self.displacement);
        let (mut gained, mut on_solids, mut on_others) = (DVec3::ZERO, DVec3::ZERO, DVec3::ZERO);
        // Of all terms.
        let mut squares = 0.0;
        let mut dirichlet = vec![0.0; grid.n_cells()];
        for axis in Axis::ALL {
            let a = axis.index();
            for (face, &in_solids) in sections[a].iter().enumerate() {
                let ijk = grid.face_at(axis, face);
                let sides = grid.face_sides(axis, ijk);
                let area = grid.dx * grid.dx;
                let open = self.open[a][face];
                let left = 1.0 - (in_solids + self.in_obstacles(axis, ijk)) / area;
                let wall = sides.contains(&None);
                if wall {
                    assert_eq!(open, 0.0, "{what}");
                } else if open == 0.0 || open == 1.0 {
                    let clamp = case.scene.solver.area_clamp + closed;
                    assert!((left - open).abs() <= clamp, "{axis:?} {ijk:?} is {left} open, not {open}: {what}");
                } else {
                    assert!((left - open).abs() <= closed, "{axis:?} {ijk:?} is {left} open, not {open}: {what}");
                }
                // What neither is open nor lies in a solid: obstacles, walls, and what the clamp takes or gives.
                let clamped = open == 0.0 || open == 1.0;
                let others = if clamped { (1.0 - open) * area - in_solids } else { area - in_solids - left * area };
                for (side, sign) in sides.into_iter().zip([1.0, -1.0]) {
                    let Some(cell) = side.filter(|&cell| self.active[cell]) else {
                        continue;
                    };
                    let push = sign * dt * self.pressure[cell];
                    on_solids[a] += push * in_solids;
                    on_others[a] += push * others;
                    squares += (push * area).powi(2);
                }
                let inside = sides.map(|side| side.is_some_and(|cell| self.active[cell]));
                if open == 0.0 || inside == [false; 2] {
                    continue;
                }
                let [Some(minus), Some(plus)] = sides else { panic!("a wall is open: {what}") };
                let theta = match inside {
                    [true, true] => 1.0,
                    [true, false] => self.theta(minus, plus, open),
                    _ => self.theta(plus, minus, open),
                };
                match inside {
                    [true, true] => {
                        assert!((self.weight[a][face] - open).abs() <= closed, "{what}")
                    }
                    [true, false] => dirichlet[minus] += open / theta,
                    _ => dirichlet[plus] += open / theta,
                }
                let mass = DENSITY * grid.dx.powi(3) * open * theta;
                let [before, after] = [0, 1].map(|when| self.faces[when][a][face]);
                gained[a] += mass * (after - before);
                squares += (mass * after).powi(2) + (mass * before).powi(2);
            }
        }
        for (own, of_b) in dirichlet.iter().zip(&self.dirichlet) {
            assert!((own - of_b).abs() <= closed.max(rounding) * (1.0 + of_b), "{own} {of_b}: {what}");
        }
        let bound = rounding * squares.sqrt();
        let balanced = |what_of: &str, sum: DVec3| {
            assert!(sum.length() <= bound, "{what_of}: {sum} kg m/s, not {bound:e}, {what}");
        };
        // The pressure's push on what is known of solids here, and on the rest.
        balanced("liquid, by sections", gained + on_solids + on_others);
        balanced("J^T p against sections", dt * force - on_solids);
        balanced("liquid, by J^T p", gained + dt * force + on_others);
        if case.free {
            let masses = solids.mass.iter().zip(&self.nodes[0]).zip(&self.nodes[1]);
            let of_solids: DVec3 =
                masses.map(|((mass, before), after)| *mass * (DVec3::from(*after) - DVec3::from(*before))).sum();
            balanced("solids", of_solids - dt * (force + correction));
            balanced("all", gained + of_solids - dt * correction + on_others);
        }
        // A hundredth of what pushes the solids would be seen.
        assert!(dt * force.length() > 100.0 * bound, "{bound:e}, {what}");
    }

    fn theta(&self, inside: usize, outside: usize, open: f64) -> f64 {
        let [inside, outside] = [inside, outside].map(|cell| self.phi[cell]);
        (inside / (inside - outside)).max(self.case.scene.solver.theta_floor.of(open))
    }

    /// Part of a face, m^2.
    fn in_obstacles(&self, axis: Axis, ijk: [usize; 3]) -> f64 {
        let a = axis.index();
        let dx = self.grid.dx;
        let of_block = |[low, high]: &Block| {
            let at = dx * ijk[a] as f64;
            let across = [(a + 1) % 3, (a + 2) % 3].map(|b| {
                let from = dx * ijk[b] as f64;
                (high[b].min(from + dx) - low[b].max(from)).max(0.0)
            });
            if low[a] < at && at < high[a] { across[0] * across[1] } else { 0.0 }
        };
        self.case.obstacles.iter().map(of_block).sum()
    }
}

/// Area of the solids in every face of the grid, m^2.
fn sections(grid: &Grid, solids: &Solids, displacement: &[[f64; 3]]) -> [Vec<f64>; 3] {
    let at = |node: u32| solids.rest[node as usize] + DVec3::from(displacement[node as usize]);
    Axis::ALL.map(|axis| {
        let a = axis.index();
        let [b, c] = [(a + 1) % 3, (a + 2) % 3];
        let mut areas = vec![0.0; grid.n_faces(axis)];
        for element in &solids.elements {
            let corners = element.map(at);
            let low = corners.into_iter().fold(DVec3::INFINITY, DVec3::min);
            let high = corners.into_iter().fold(-DVec3::INFINITY, DVec3::max);
            let cells = |d: usize| {
                let first = (low[d] / grid.dx).floor().max(0.0) as usize;
                first..=((high[d] / grid.dx).floor() as usize).min(grid.cells[d] - 1)
            };
            for plane in *cells(a).start()..=cells(a).end() + 1 {
                // What stands on the floor is cut just above it.
                let height = (grid.dx * plane as f64).max(1e-13);
                let polygon = section(corners, a, height);
                if polygon.len() < 3 {
                    continue;
                }
                for j in cells(b) {
                    for k in cells(c) {
                        let mut part = polygon.clone();
                        for (d, index) in [(0, j), (1, k)] {
                            let low = grid.dx * index as f64;
                            part = clipped(&part, d, low, 1.0);
                            part = clipped(&part, d, low + grid.dx, -1.0);
                        }
                        let mut ijk = [0; 3];
                        (ijk[a], ijk[b], ijk[c]) = (plane, j, k);
                        areas[grid.face(axis, ijk)] += area(&part);
                    }
                }
            }
        }
        areas
    })
}

/// Where a plane across an axis cuts a tetrahedron: the other two coordinates, around it.
fn section(corners: [DVec3; 4], axis: usize, at: f64) -> Vec<[f64; 2]> {
    let (above, below): (Vec<DVec3>, Vec<DVec3>) = corners.into_iter().partition(|x| x[axis] >= at);
    let cut = |x: DVec3, y: DVec3| {
        let place = x.lerp(y, (at - x[axis]) / (y[axis] - x[axis]));
        [place[(axis + 1) % 3], place[(axis + 2) % 3]]
    };
    match (&above[..], &below[..]) {
        (&[x], others) | (others, &[x]) => others.iter().map(|&y| cut(x, y)).collect(),
        (&[x, y], &[z, w]) => vec![cut(x, z), cut(x, w), cut(y, w), cut(y, z)],
        _ => Vec::new(),
    }
}

/// The part of a convex polygon on the side of a line across a coordinate (Sutherland and Hodgman 1974).
fn clipped(polygon: &[[f64; 2]], coordinate: usize, at: f64, side: f64) -> Vec<[f64; 2]> {
    let mut part = Vec::new();
    for (number, x) in polygon.iter().enumerate() {
        let y = polygon[(number + 1) % polygon.len()];
        let [in_x, in_y] = [x[coordinate], y[coordinate]].map(|place| side * (place - at) >= 0.0);
        if in_x {
            part.push(*x);
        }
        if in_x != in_y {
            let share = (at - x[coordinate]) / (y[coordinate] - x[coordinate]);
            part.push([0, 1].map(|d| x[d] + share * (y[d] - x[d])));
        }
    }
    part
}

fn area(polygon: &[[f64; 2]]) -> f64 {
    let sides = (0..polygon.len()).map(|number| {
        let ([a, b], [c, d]) = (polygon[number], polygon[(number + 1) % polygon.len()]);
        a * d - b * c
    });
    0.5 * sides.sum::<f64>().abs()
}

/// Sub-steps of each case.
const STEPS: usize = 4;

/// To rounding, and what the solve leaves.
#[test]
fn what_the_liquid_gains_is_what_everything_else_loses() {
    for case in cases() {
        let grid = case.scene.grid();
        let mut reference = reference_path(&case.scene).unwrap();
        let solids = cutwater::sim::solids_of(&case.scene).unwrap();
        for _ in 0..STEPS {
            let before = reference.state().clone();
            let dt = reference.next_time_step().dt;
            let v = before.node_velocity.iter();
            let v = v.map(|v| (DVec3::from(*v) + dt * case.scene.domain.gravity).to_array());
            let v = v.collect();
            let mut stencil: Option<Stencil> = None;
            let time_step = TimeStep { dt, ..reference.next_time_step() };
            let look = &mut |system: StepSystem| match system {
                StepSystem::Coupled(system, ..) => stencil = Some(system.pressure.stencil.clone()),
                _ => panic!("{}: they do not touch", case.name),
            };
            let report = reference.step_observed(time_step, look).unwrap();
            let (stencil, state) = (stencil.unwrap(), reference.state());
            let open = reference.cut_cells().open.clone();
            let mut u = advect_velocity(&grid, &open, &before.velocity, &Ballistic::NONE, dt);
            forces(&mut u, case.scene.domain.gravity, dt);
            let moment = Moment {
                case: &case,
                grid,
                dt,
                open,
                weight: stencil.weight.clone(),
                dirichlet: stencil.dirichlet.clone(),
                phi: state.liquid_distance.clone(),
                active: state.active.clone(),
                pressure: state.pressure.clone(),
                faces: [u, state.velocity.clone()],
                nodes: [v, state.node_velocity.clone()],
                displacement: state.displacement.clone(),
                report,
            };
            moment.check(&solids, 1e-12, 1e-11);
        }
    }
}

/// Velocities, masses, open fractions and J are stored in f32: each is off by up to 2^-24 of itself, and at most four of them make a term,
/// which is then off by 2^-23 if they have nothing to do with each other. Nor have the terms: eight times that is never reached.
#[test]
fn on_the_device_it_is_that_too() {
    let Some(_) = gpu() else { return };
    for case in cases() {
        let grid = case.scene.grid();
        let mut path = GpuPath::open(&case.scene, &adapter()).unwrap();
        let solids = path.solids().unwrap().clone();
        for _ in 0..STEPS {
            let mut seen = Vec::new();
            let observer = &mut |stage: Stage, path: &GpuPath| {
                if [Stage::Forces, Stage::Solve, Stage::WriteBack].contains(&stage) {
                    let snapshot = path.snapshot()?;
                    seen.push((snapshot.liquid.unwrap(), snapshot.solids.unwrap()));
                }
                Ok(())
            };
            let report = path.step_observed(observer).unwrap();
            let [(liquid, solid), (solved, moved), (written, _)] = seen.try_into().ok().unwrap();
            let dt = report.dt;
            let pascal = DENSITY * grid.dx / dt;
            let moment = Moment {
                case: &case,
                grid,
                dt,
                open: solved.cut.unwrap().open,
                weight: solved.weight,
                dirichlet: solved.dirichlet,
                phi: solved.liquid_distance,
                active: solved.active,
                pressure: solved.potential.iter().map(|p| pascal * p).collect(),
                faces: [liquid.velocity_next, written.velocity],
                nodes: [solid.velocity, moved.velocity],
                displacement: moved.displacement,
                report,
            };
            moment.check(&solids, 2.0_f64.powi(-20), 1e-6);
        }
    }
}
