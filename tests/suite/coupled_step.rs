//! Steps of liquid and solids together on the f64 path.

use std::fs;

use cutwater::geometry::{ObstacleCut, SolidClip};
use cutwater::grid::Axis;
use cutwater::linalg::{Csr, SymbolicCholesky, norm, read_matrix, read_vector};
use cutwater::measure::export;
use cutwater::reference::{Freedom, Reference, StepSystem, TimeStep, patch_pressure, pressure_gradient};
use cutwater::scene::{CouplingScheme, FaceAreas, Formulation, PatchPressure, Scene};
use cutwater::sim::{Backend, Simulation, reference_path};
use cutwater::state::{SolveStatus, State, StepReport};
use glam::DVec3;

use crate::common::scene_from;

/// Seconds.
const DT: f64 = 1.0 / 120.0;
const GRAVITY: f64 = 9.81;

fn scene(text: &str) -> Scene {
    scene_from(text, &[])
}

/// A turned block in a tank with a level that is kept, of 1000 kg/m^3 and hard.
fn block_at_rest(n: usize, pressure_on_patches: &str) -> Scene {
    scene(&format!(
        "[domain]
size = [1, 1, 1]
cells = [{n}, {n}, {n}]
[time]
duration = 1
frames_per_second = 120
fixed_step = {DT:?}
[liquid]
surface = \"fixed\"
[[liquid.region]]
box = {{ min = [0, 0, 0], max = [1, 0.81, 1] }}
[[solid]]
name = \"block\"
mesh = {{ box = {{ size = [0.3, 0.24, 0.2], cells = [6, 5, 4] }} }}
placement = {{ translate = [0.51, 0.43, 0.47], rotate = {{ axis = [1, 2, 3], degrees = 37 }} }}
density = 1000.0
young = 1e10
poisson = 0.3
[solver]
tolerance = 1e-10
pressure_on_patches = \"{pressure_on_patches}\"
"
    ))
}

fn step(reference: &mut Reference) -> StepReport {
    let time_step = TimeStep { dt: DT, ..reference.next_time_step() };
    let report = reference.step(time_step).unwrap();
    for solve in report.solves() {
        assert_eq!(solve.status, SolveStatus::Converged, "{solve:?}");
    }
    report
}

/// Acceleration of the block in a step from rest, in g: of its mass's mean, and the largest of a node.
fn accelerations(reference: &Reference, before: &[[f64; 3]]) -> [f64; 2] {
    let solids = cutwater::sim::solids_of(reference.scene()).unwrap();
    let after = &reference.state().node_velocity;
    let change = |node: usize| DVec3::from(after[node]) - DVec3::from(before[node]);
    let nodes = || 0..after.len();
    let mass: f64 = solids.mass.iter().sum();
    let mean: DVec3 = nodes().map(|node| solids.mass[node] * change(node)).sum::<DVec3>() / mass;
    let largest = nodes().map(|node| change(node).length()).fold(0.0, f64::max);
    [mean.length(), largest].map(|v| v / (DT * GRAVITY))
}

/// Water on an elastic plate, from the start or after a fall of a half or a whole cell: it comes to rest, and the plate carries its weight. A
/// surface that stayed in the plate made the water lose 4 to 17 % of its volume, and opened as gaps with bursts of 1 m/s.
#[test]
fn water_on_an_elastic_plate_comes_to_rest() {
    for bottom in [0.2, 0.206, 0.21, 0.22] {
        let scene = scene(&format!(
            "[domain]
size = [0.4, 0.4, 1]
cells = [20, 20, 2]
slab = \"z\"
[time]
duration = 2
[[liquid.region]]
box = {{ min = [0, {bottom}, 0], max = [0.4, 0.34, 1] }}
[[solid]]
name = \"plate\"
mesh = {{ box = {{ size = [0.4, 0.04, 1], cells = [20, 4, 2] }} }}
placement = {{ at = [0.2, 0.18, 0.5] }}
density = 1200
young = 2e6
poisson = 0.3
damping.mass = 15
[[solid.pin]]
region = {{ box = {{ min = [0, 0, 0], max = [0.001, 0.4, 1] }} }}
[[solid.pin]]
region = {{ box = {{ min = [0.399, 0, 0], max = [0.4, 0.4, 1] }} }}
"
        ));
        let mut reference = reference_path(&scene).unwrap();
        // Of the slab, which is as thick as two cells.
        let start = reference.state().volume_0;
        let mut dropped = 0;
        while reference.state().time < 2.0 {
            let time_step = reference.next_time_step();
            let report = reference.step(time_step).unwrap();
            let liquid = report.liquid.unwrap();
            dropped += liquid.dropped;
            // The control of the volume lets it differ by half a per cent, and takes out what fills a gap of half a cell at the start.
            let (volume, time) = (liquid.diagnosis.volume, reference.state().time);
            let change = volume / start - 1.0;
            assert!(change > -0.006 && (change < 0.006 || time < 1.0), "{bottom}: {volume} of {start} at {time} s");
            if reference.state().time > 1.5 {
                let speed = liquid.diagnosis.max_speed;
                assert!(speed < 0.03, "{bottom}: {speed} m/s");
                let weight = 1000.0 * GRAVITY * volume;
                let coupling = report.coupling.unwrap();
                let load = -coupling.force[1] - coupling.correction[1];
                assert!((load / weight - 1.0).abs() < 3e-3, "{bottom}: {load} of {weight} N");
            }
        }
        assert_eq!(dropped, 0, "{bottom}");
    }
}

/// A block that is as heavy as its liquid stays at rest. What is left are apertures that `area_clamp` closes: of a node's force that share
/// at most, of the sum over some hundred nodes, whose signs differ, a tenth of it.
#[test]
fn a_neutral_block_stays_at_rest() {
    let still = |n: usize| vec![[0.0; 3]; n];
    let mut reference = reference_path(&block_at_rest(20, "hydrostatic")).unwrap();
    let n = reference.state().node_velocity.len();
    let report = step(&mut reference);
    let [mean, largest] = accelerations(&reference, &still(n));
    let clamp = reference.scene().solver.area_clamp;
    assert!(mean < 0.1 * clamp && largest < clamp, "{mean:e} g and {largest:e} g");
    // All forces together: pressure at the centres, its variation, and weight.
    let coupling = report.coupling.unwrap();
    let weight = 1000.0 * 0.3 * 0.24 * 0.2 * GRAVITY;
    let sum = DVec3::from(coupling.force) + DVec3::from(coupling.correction);
    assert!((sum.y / weight - 1.0).abs() < 0.1 * clamp, "{coupling:?}, {weight} N");
    assert!(coupling.touching && coupling.overlap_cells == 0);
    assert!(report.liquid.unwrap().diagnosis.divergence < 1e-6);

    let mut reference = reference_path(&block_at_rest(20, "cell")).unwrap();
    let report = step(&mut reference);
    assert_eq!(report.coupling.unwrap().correction, [0.0; 3]);

    // The first step has no gradient but that at rest. The second differences pressures of the first, beside faces of which the clamp
    // has closed some: each of a cell's differences may be off by it, ten of them at a node.
    let mut reference = reference_path(&block_at_rest(20, "gradient")).unwrap();
    for bounds in [[0.1 * clamp, clamp], [clamp, 10.0 * clamp]] {
        let before = reference.state().node_velocity.clone();
        step(&mut reference);
        let [mean, largest] = accelerations(&reference, &before);
        assert!(mean < bounds[0] && largest < bounds[1], "{mean:e} g and {largest:e} g");
    }
}

/// A pressure that is linear everywhere has its gradient as its gradient; and its forces, with those at the centres, are the
/// buoyancy of the body.
#[test]
fn linear_pressure_pushes_as_archimedes_says() {
    let scene = block_at_rest(14, "hydrostatic");
    let solids = cutwater::sim::solids_of(&scene).unwrap();
    let grid = scene.grid();
    let still = vec![[0.0; 3]; solids.rest.len()];
    let mut clip = SolidClip::new(&grid, ObstacleCut::none(&grid), &scene.solver);
    clip.clip(&solids.moved(&still));
    let open = &clip.cut_cells().open;
    let active = cutwater::reference::active_cells(&grid, open, &vec![-1.0; grid.n_cells()], 0.01);
    let slope = DVec3::new(3.0, -7.0, 2.0);
    let pressure: Vec<f64> = (0..grid.n_cells()).map(|cell| slope.dot(grid.cell_centre(grid.cell_at(cell)))).collect();
    let mask = active.stencil.active_mask();
    let mut inner = 0;
    for cell in 0..grid.n_cells() {
        let found = pressure_gradient(&grid, open, &mask, &pressure, DVec3::ZERO, cell);
        let expected = if mask[cell] { slope } else { DVec3::ZERO };
        // A cell with no open neighbour along an axis has nothing to tell there.
        let off = (found - expected).abs();
        assert!(off.max_element() < 1e-10 || off.min_element() < 1e-10, "{found}");
        inner += usize::from(off.max_element() < 1e-10 && mask[cell]);
    }
    assert!(inner > grid.n_cells() / 2);
    let forces = patch_pressure(&active.stencil, clip.patches(), &solids.triangles, solids.rest.len(), |_| slope);
    let forces = forces.sum_over(|_| true);
    let mut of_centres = vec![0.0; 3 * solids.rest.len()];
    let coupling = clip.coupling().restricted(|cell| mask[cell]);
    coupling.add_transposed(&pressure, &mut of_centres);
    let volume: f64 = solids.volume.iter().sum();
    let centroid: DVec3 = solids.centroid(&solids.bodies[0]);
    let (mut sum, mut moment) = (DVec3::ZERO, DVec3::ZERO);
    for (node, force) in forces.iter().enumerate() {
        let force = *force + DVec3::from_slice(&of_centres[3 * node..]);
        sum += force;
        moment += (solids.rest[node] - centroid).cross(force);
    }
    // Patches in cells without an open face push nothing: those whose apertures the clamp closes.
    let push = scene.solver.area_clamp * volume * slope.length();
    assert!(sum.distance(-volume * slope) < push, "{sum}");
    // With arms of a third of the block's length, 0.3 m, in both directions.
    assert!(moment.length() < 0.1 * push, "{moment}");
}

/// A light ball and a heavy one, with markers.
fn two_balls(y: f64) -> Scene {
    scene(&two_balls_text(y, ""))
}

fn two_balls_text(y: f64, more: &str) -> String {
    format!(
        "[domain]
size = [1, 1, 1]
cells = [16, 16, 16]
[time]
duration = 1
[[liquid.region]]
box = {{ min = [0, 0, 0], max = [1, 0.5, 1] }}
[[solid]]
name = \"light\"
mesh = {{ sphere = {{ radius = 0.12, cell_size = 0.06 }} }}
placement = {{ translate = [0.3, {y}, 0.5] }}
density = 300.0
young = 1e5
poisson = 0.4
[[solid]]
name = \"heavy\"
mesh = {{ sphere = {{ radius = 0.12, cell_size = 0.06 }} }}
placement = {{ translate = [0.7, {y}, 0.5] }}
density = 3000.0
young = 1e6
poisson = 0.3
{more}"
    )
}

fn heights(simulation: &Simulation) -> [f64; 2] {
    let (solids, state) = (simulation.solids(), simulation.state().unwrap());
    let moved = solids.moved(&state.displacement);
    let of_body = |body: &cutwater::elastic::Body| {
        let nodes = body.nodes.clone();
        nodes.map(|node| moved.nodes[node].y).sum::<f64>() / body.nodes.len() as f64
    };
    [of_body(&solids.bodies[0]), of_body(&solids.bodies[1])]
}

/// Velocity of a body's centroid, upwards, m/s.
fn rise(simulation: &Simulation, body: usize) -> f64 {
    let (solids, state) = (simulation.solids(), simulation.state().unwrap());
    let nodes = || solids.bodies[body].nodes.clone();
    let momentum: f64 = nodes().map(|node| solids.mass[node] * state.node_velocity[node][1]).sum();
    momentum / nodes().map(|node| solids.mass[node]).sum::<f64>()
}

#[test]
fn light_balls_rise_and_heavy_ones_sink() {
    let scene = two_balls(0.25);
    let mut simulation = Simulation::new(&scene, &Backend::Cpu).unwrap();
    let before = heights(&simulation);
    let start = simulation.state().unwrap();
    let markers = start.markers.len();
    let inside = |state: &State, simulation: &Simulation| {
        let distance = &simulation.cut_cells().solid_distance;
        let grid = scene.grid();
        state.markers.iter().filter(|&&x| grid.sample_cells(distance, x.into()) < 0.0).count()
    };
    assert_eq!(inside(&start, &simulation), 0);
    let mut again = Simulation::new(&scene, &Backend::Cpu).unwrap();
    while simulation.clock().frame < 2 {
        let report = simulation.step().unwrap();
        assert_eq!(report.solves().count(), 2);
        for solve in report.solves() {
            assert_eq!(solve.status, SolveStatus::Converged);
            assert!(solve.residual <= scene.solver.tolerance);
        }
        let liquid = report.liquid.unwrap();
        assert!(liquid.diagnosis.divergence < 0.1, "{:?}", liquid.diagnosis);
        let volume = simulation.volume_ratio(&report).unwrap();
        assert!((volume - 1.0).abs() < 0.05, "{volume}");
        assert!(report.coupling.unwrap().touching);
        assert!(report.seconds.iter().any(|(stage, _)| *stage == "clip"));
        if simulation.clock().step == 1 {
            // From rest a ball of s times the liquid's density accelerates by g (1 - s) / (s + 1/2) (Lamb 1932, section 92). Surface and walls,
            // 0.25 m from the middle of a ball of 0.12 m, change its added mass by the cube of that: 11 %.
            for (body, s) in [(0, 0.3), (1, 3.0)] {
                let theory = report.dt * GRAVITY * (1.0 - s) / (s + 0.5);
                let found = rise(&simulation, body);
                let off = found / theory - 1.0;
                assert!(off.abs() < 0.11, "{s}: {found} m/s, not {theory}");
            }
        }
        // Bit for bit.
        let second = again.step().unwrap();
        assert_eq!(second.liquid, report.liquid);
        assert_eq!(second.solid, report.solid);
        assert_eq!(second.coupling, report.coupling);
    }
    assert_eq!(simulation.state().unwrap(), again.state().unwrap());
    let after = heights(&simulation);
    assert!(after[0] > before[0] && after[1] < before[1], "{before:?} {after:?}");
    let end = simulation.state().unwrap();
    assert!(inside(&end, &simulation) == 0 && end.markers.len() > markers * 9 / 10);

    // A state in the middle goes on as if nothing had happened.
    again.reset(&end).unwrap();
    assert_eq!(again.step().unwrap().liquid, simulation.step().unwrap().liquid);
}

/// Above the liquid they fall, and each is solved for itself, as if the other were not there.
#[test]
fn solids_out_of_the_liquid_are_solved_apart() {
    let mut both = two_balls(0.8);
    both.time.fixed_step = Some(1.0 / 240.0);
    let mut reference = reference_path(&both).unwrap();
    let mut kinds = Vec::new();
    let time_step = TimeStep { dt: DT, ..reference.next_time_step() };
    let report = reference
        .step_observed(time_step, &mut |system| {
            kinds.push(match system {
                StepSystem::Pressure(..) => "pressure",
                StepSystem::Solid(..) => "solid",
                StepSystem::Coupled(..) => "coupled",
            });
        })
        .unwrap();
    assert_eq!(kinds, ["pressure", "solid"]);
    let coupling = report.coupling.unwrap();
    assert!(!coupling.touching && coupling.force == [0.0; 3]);
    let mut liquid = both.clone();
    liquid.solids.clear();
    let mut alone = reference_path(&liquid).unwrap();
    let of_liquid = alone.step(time_step).unwrap();
    assert_eq!(alone.state().pressure, reference.state().pressure);
    assert!(alone.clip().is_none() && of_liquid.coupling.is_none());
    assert!(of_liquid.seconds.iter().all(|(stage, _)| *stage != "clip"));
    let mut solids = both.clone();
    solids.liquid = None;
    let mut alone = reference_path(&solids).unwrap();
    let of_solids = alone.step(time_step).unwrap();
    assert_eq!(of_solids.solid, report.solid);
    assert!(alone.clip().is_none() && of_solids.seconds.iter().all(|(stage, _)| *stage != "clip"));
}

/// What is wrong with a step leaves the state, and the cut cells of that state.
#[test]
fn a_failed_step_changes_nothing() {
    let scene = two_balls(0.25);
    let mut reference = reference_path(&scene).unwrap();
    let mut state = reference.state().clone();
    let cut = reference.cut_cells().clone();
    state.node_velocity.fill([0.3, -1.0, 0.2]);
    reference.reset(state.clone()).unwrap();
    let time_step = TimeStep { dt: DT, ..reference.next_time_step() };
    let face = scene.grid().face(Axis::Y, [8, 3, 8]);
    for of_liquid in [true, false] {
        let mut bad = state.clone();
        if of_liquid {
            bad.velocity[1][face] = f64::NAN;
        } else {
            bad.node_velocity[7][1] = f64::NAN;
        }
        bad.step = 1;
        reference.reset(bad).unwrap();
        let error = reference.step(time_step).unwrap_err().to_string();
        assert!(error.contains("not finite"), "{error}");
        assert_eq!(reference.state().step, 1);
        assert_eq!(reference.cut_cells().open, cut.open);
        assert_eq!(reference.cut_cells().solid_distance, cut.solid_distance);
    }
}

/// A light, soft block that rises in water, of a twentieth of its density: strong coupling adds the liquid's mass in the same sub-step, so it
/// is no faster than its buoyancy makes it with the added mass of a sphere, C = 1/2, which flat bodies across their motion exceed.
/// Where that mass comes late, speeds grow without bound (thesis, section 6.3).
#[test]
fn light_solids_rise_with_their_added_mass() {
    let scene = scene(&format!(
        "[domain]
size = [1, 1, 1]
cells = [12, 12, 12]
[time]
duration = 1
frames_per_second = 60
fixed_step = {:?}
[[liquid.region]]
box = {{ min = [0, 0, 0], max = [1, 0.5, 1] }}
[[solid]]
name = \"block\"
mesh = {{ box = {{ size = [0.4, 0.2, 0.4], cells = [4, 2, 4] }} }}
placement = {{ translate = [0.5, 0.35, 0.5] }}
density = 50
young = 1e5
poisson = 0.3
damping = {{ stiffness = 0.002 }}
",
        1.0 / 60.0
    ));
    let mut simulation = Simulation::new(&scene, &Backend::Cpu).unwrap();
    let acceleration = GRAVITY * (1.0 - 0.05) / (0.05 + 0.5);
    for _ in 0..12 {
        let report = simulation.step().unwrap();
        assert!(report.coupling.unwrap().touching);
        let (speed, time) = (report.solid.unwrap().diagnosis.max_speed, simulation.clock().time);
        println!("{speed} m/s of {} m/s", acceleration * time);
        assert!(speed < acceleration * time, "{speed} m/s at {time} s");
    }
}

/// A block between a wall, the floor and a ball that holds it obliquely, half under water.
fn wedged_block() -> Scene {
    scene(
        "[domain]
size = [1.0, 1.0, 1.0]
cells = [10, 10, 10]
[time]
duration = 0.2
frames_per_second = 24
[[liquid.region]]
box = { min = [0, 0, 0], max = [1, 0.5, 1] }
[[solid]]
name = \"block\"
mesh = { box = { size = [0.3, 0.3, 0.3], cells = [2, 2, 2] } }
placement = { translate = [0.15, 0.15, 0.5] }
density = 2000.0
young = 1e6
poisson = 0.4
[solver]
tolerance = 1e-10
[[obstacle]]
sphere = { centre = [0.5, 0.13, 0.47], radius = 0.25 }
",
    )
}

/// All formulations of a scene's first sub-step have the answer that is written.
fn exported_systems_agree(scene: &Scene) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("system");
    let options = export::Options { backend: Backend::Cpu, step: 0, start: None, out: out.clone() };
    let meta = export::export(scene, &options).unwrap();
    assert!(meta.residual < 1e-8, "{meta:?}");
    let json = crate::common::json(fs::read(out.join("meta.json")).unwrap());
    assert_eq!(json["cells"], serde_json::json!(scene.grid().cells));
    let matrix = |name: &str| read_matrix(&out.join(name)).unwrap();
    assert_eq!(json["active_cells"], matrix("B.mtx").n_rows());
    let vector = |name: &str| read_vector(&out.join(name)).unwrap();
    let solution = vector("solution.mtx");
    let residual = |matrix: &Csr, x: &[f64], rhs: &[f64]| {
        let mut product = vec![0.0; rhs.len()];
        matrix.multiply(x, &mut product);
        let left: Vec<f64> = rhs.iter().zip(&product).map(|(b, y)| b - y).collect();
        norm(&left) / norm(rhs)
    };
    let indefinite = matrix("indefinite.mtx");
    let left = residual(&indefinite, &solution, &vector("indefinite_rhs.mtx"));
    assert!(left < 1e-10, "{left:e}");
    let spd = matrix("spd.mtx");
    let symbolic = SymbolicCholesky::new(&spd).unwrap();
    let factor = symbolic.factorise(&spd).expect("spd.mtx is positive definite");
    let rhs = vector("spd_rhs.mtx");
    let mut direct = vec![0.0; rhs.len()];
    // A22 is a product of matrices: a correction takes away what its condition costs.
    for _ in 0..2 {
        let mut correction = vec![0.0; rhs.len()];
        spd.multiply(&direct, &mut correction);
        correction.iter_mut().zip(&rhs).for_each(|(y, b)| *y = b - *y);
        factor.solve(&mut correction);
        direct.iter_mut().zip(correction).for_each(|(x, dx)| *x += dx);
    }
    let largest = |x: &[f64]| x.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    let n = matrix("B.mtx").n_rows();
    // Pressures by the largest of them, velocities by the largest of them or what gravity does in the sub-step. The solution has a residual
    // of 1e-10, which a condition of a thousand makes 1e-7.
    let dt = reference_path(scene).unwrap().next_time_step().dt;
    for (part, least) in [(0..n, 0.0), (n..solution.len(), GRAVITY * dt)] {
        let (found, wanted) = (&direct[part.clone()], &solution[part.clone()]);
        let off: Vec<f64> = found.iter().zip(wanted).map(|(a, b)| a - b).collect();
        let share = largest(&off) / largest(wanted).max(least);
        println!("{part:?}: {share:e} of {:e}", largest(wanted));
        assert!(share <= 1e-7, "{part:?}: {share:e}");
    }
    // [B J; J^T -S] with S = Z1 + Z2 is the indefinite matrix.
    let s = matrix("Z1.mtx").plus(1.0, &matrix("Z2.mtx"));
    let blocks = Csr::bordered(&matrix("B.mtx"), &matrix("J.mtx"), -1.0, &s);
    for (row, column, value) in blocks.triplets() {
        let error = (value - indefinite.get(row, column)).abs();
        assert!(error <= 1e-14 * s.infinity_norm(), "({row}, {column}): {error:e}");
    }
    let stress = matrix("stress.mtx");
    let symbolic = SymbolicCholesky::new(&stress).unwrap();
    let mut direct = vector("stress_rhs.mtx");
    symbolic.factorise(&stress).unwrap().solve(&mut direct);
    let off: Vec<f64> = direct[..n].iter().zip(&solution).map(|(a, b)| a - b).collect();
    assert!(largest(&off) <= 1e-6 * largest(&solution[..n]), "{:e}", largest(&off));
    let nodes = fs::read_to_string(out.join("nodes.csv")).unwrap();
    assert!(nodes.lines().nth(1).unwrap().contains(&format!(",{},", n + 1)), "{nodes}");
}

#[test]
fn exported_systems_of_a_free_block_agree() {
    exported_systems_agree(&block_at_rest(10, "hydrostatic"));
}

#[test]
fn exported_systems_of_a_held_block_agree() {
    let scene = wedged_block();
    let mut reference = reference_path(&scene).unwrap();
    let time_step = reference.next_time_step();
    let mut oblique = 0;
    let mut look = |of_step: StepSystem| {
        let StepSystem::Coupled(system, ..) = of_step else { panic!("block and liquid touch") };
        let across = |freedom: &&Freedom| freedom.projector.col(0).y.abs() > 1e-3;
        oblique += system.solid.freedom().iter().filter(across).count();
    };
    reference.step_observed(time_step, &mut look).unwrap();
    assert!(oblique > 0, "nothing is held obliquely");
    exported_systems_agree(&scene);
}

/// With damping in place of elasticity, in all its forms.
#[test]
fn exported_systems_of_damping_alone_agree() {
    let mut scene = two_balls(0.25);
    scene.solver.coupling = CouplingScheme::DampingOnly;
    scene.solver.solid_contact = false;
    scene.solver.tolerance = 1e-10;
    exported_systems_agree(&scene);
}

#[test]
fn other_coupling_exports_what_it_solves_or_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let gpu = || Backend::Gpu(Default::default());
    for (coupling, backend, message) in [
        (CouplingScheme::Weak, Backend::Cpu, "no system of both"),
        (CouplingScheme::Weak, gpu(), "no system of both"),
        (CouplingScheme::DampingOnly, gpu(), "--backend cpu"),
    ] {
        let mut scene = two_balls(0.25);
        scene.solver.coupling = coupling;
        let options = export::Options { backend, step: 0, start: None, out: folder.path().join("system") };
        let error = export::export(&scene, &options).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
}

/// Above the liquid there is no system of both.
#[test]
fn solids_out_of_the_liquid_export_no_system_of_both() {
    let options = export::Options {
        backend: Backend::Cpu,
        step: 0,
        start: None,
        out: tempfile::tempdir().unwrap().path().join("system"),
    };
    let error = export::export(&two_balls(0.8), &options).unwrap_err().to_string();
    assert!(error.contains("do not touch") && error.contains("touching"), "{error}");
}

#[test]
fn scenes_of_both_have_keys_of_their_own() {
    let solver = block_at_rest(8, "gradient").solver;
    assert_eq!(solver.pressure_on_patches, PatchPressure::Gradient);
    assert_eq!((solver.face_areas, solver.area_clamp), (FaceAreas::Clipped, 1e-3));
    let nodal = scene(&two_balls_text(0.25, "[solver]\nface_areas = \"nodal\"\n")).solver;
    assert_eq!(nodal.pressure_on_patches, PatchPressure::Hydrostatic);
    assert_eq!((nodal.face_areas, nodal.area_clamp), (FaceAreas::Nodal, 1e-2));
}

/// Diagonals are those of the two-field system, unless the condensed form is asked for, which has no nodes.
#[test]
fn diagonals_are_of_a_form() {
    let with = |keys: &str| two_balls_text(0.25, &format!("[solver]\n{keys}\n"));
    let form = |keys: &str| scene(&with(keys)).solver.formulation;
    assert_eq!(form("preconditioner = \"multigrid\""), Formulation::Auto);
    for kind in ["jacobi", "block_jacobi"] {
        let keys = format!("preconditioner = \"{kind}\"");
        assert_eq!(form(&keys), Formulation::TwoField);
    }
    let condensed = "formulation = \"condensed\"\npreconditioner = ";
    assert_eq!(form(&format!("{condensed}\"jacobi\"")), Formulation::Condensed);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("test.toml");
    fs::write(&path, with(&format!("{condensed}\"block_jacobi\""))).unwrap();
    let error = Scene::load(&path, &[], 1.0).unwrap_err().to_string();
    for part in ["solver.formulation", "only unknowns", "\"two_field\""] {
        assert!(error.contains(part), "{error}");
    }
}
