//! Liquid and solids together on the device, whole steps against the f64 path.

use std::collections::{BTreeMap, BTreeSet};

use cutwater::linalg::{Csr, SymbolicCholesky, read_matrix, read_vector};
use cutwater::measure::base_scene::DeviceScene;
use cutwater::measure::compare::compare;
use cutwater::measure::export;
use cutwater::reference::base_scene::{BaseBeam, BaseScene};
use cutwater::scene::{CouplingScheme, Formulation, Precision, Scene, Solver, Surface};
use cutwater::sim::{Backend, Plan, Simulation, reference_path};
use cutwater::state::{ContactReport, SolveStatus};
use glam::DVec3;

use crate::common::{adapter, digest, gpu, on_gpu, same_with_any_number_of_threads, scene_from as scene};

/// A tank of 12^3 cells; `level`: m, 1 for a full one.
fn tank(level: f64, solids: &str) -> String {
    format!(
        "[domain]
size = [1, 1, 1]
cells = [12, 12, 12]
[time]
duration = 1
frames_per_second = 100
fixed_step = 0.01
[liquid]
surface = \"markers\"
[[liquid.region]]
box = {{ min = [0, 0, 0], max = [1, {level}, 1] }}
{solids}"
    )
}

fn ball(name: &str, at: [f64; 3], density: f64) -> String {
    format!(
        "[[solid]]
name = \"{name}\"
mesh = {{ sphere = {{ radius = 0.15, cell_size = 0.1 }} }}
placement = {{ translate = {at:?} }}
density = {density:?}
young = 1e5
poisson = 0.35
damping = {{ mass = 0.2, stiffness = 0.01 }}
"
    )
}

const POST: &str = "[[obstacle]]
box = { min = [0.57, 0.0, 0.35], max = [0.83, 0.26, 0.62] }
";

const PINNED: &str = "[[solid.pin]]
region = { box = { min = [0, 0, 0], max = [1, 1, 1] } }
";

/// A block all of which moves, its upper half by `upper` in a second, the lower half by `lower`, m.
fn carried([upper, lower]: [f64; 2]) -> String {
    let script = |low: f64, high: f64, up: f64| {
        format!(
            "[[solid.script]]
region = {{ box = {{ min = [0, {low:?}, 0], max = [1, {high:?}, 1] }} }}
keyframes = [{{ t = 0 }}, {{ t = 1, translate = [0.05, {up:?}, 0] }}]
"
        )
    };
    format!(
        "[[solid]]
name = \"block\"
mesh = {{ box = {{ size = [0.3, 0.3, 0.3], cells = [2, 2, 2] }} }}
placement = {{ translate = [0.5, 0.5, 0.5] }}
density = 2000.0
young = 1e6
poisson = 0.4
{}{}",
        script(0.6, 1.0, upper),
        script(0.0, 0.6, lower),
    )
}

/// Every ugly thing that scenes of both may have, on a small grid.
fn cases() -> Vec<(&'static str, Scene)> {
    let light = ball("light", [0.31, 0.34, 0.52], 300.0);
    let heavy = ball("heavy", [0.7, 0.42, 0.47], 3000.0);
    let both = format!("{light}{heavy}");
    let pool = tank(0.55, &format!("{both}{}", forces(&["heavy"])));
    let full = tank(1.0, &light);
    let still = tank(1.0, &format!("{light}{PINNED}"));
    let leaves =
        tank(0.55, &format!("{}initial = {{ velocity = [0, 4, 0] }}\n", ball("leaves", [0.45, 0.5, 0.52], 300.0)));
    let separates = ["liquid.separation=walls"];
    let bar = "[[solid]]
name = \"bar\"
mesh = { box = { size = [0.4, 0.08, 1.0], cells = [4, 1, 8] } }
placement = { translate = [0.5, 0.5, 0.5], rotate = { axis = [0, 0, 1], degrees = 25 } }
density = 800.0
young = 1e6
poisson = 0.3
";
    vec![
        ("two balls in a pool", scene(&pool, &[])),
        ("pressure of the last step", scene(&pool, &["solver.pressure_on_patches=gradient"])),
        ("the two-field form", scene(&pool, &["solver.formulation=two_field"])),
        ("in single precision", scene(&pool, &["solver.precision=f32", "solver.tolerance=1e-5"])),
        ("weak coupling", scene(&pool, &["solver.coupling=weak"])),
        (
            "weak coupling with a block that is carried through a full tank",
            scene(&tank(1.0, &carried([0.1, 0.1])), &["liquid.surface=fixed", "solver.coupling=weak"]),
        ),
        ("damping-only coupling", scene(&pool, &["solver.coupling=damping_only"])),
        (
            "damping-only coupling above an obstacle",
            scene(
                &tank(0.6, &format!("{heavy}{POST}")),
                &["solver.coupling=damping_only", "solver.formulation=two_field"],
            ),
        ),
        ("a ball that the water lets go", scene(&leaves, &separates)),
        (
            "a ball that the water lets go, in weak coupling",
            scene(&leaves, &[&separates[..], &["solver.coupling=weak"]].concat()),
        ),
        (
            "a ball that the water lets go, in damping-only coupling",
            scene(&leaves, &[&separates[..], &["solver.coupling=damping_only"]].concat()),
        ),
        ("pressure constant in cells", scene(&pool, &["solver.pressure_on_patches=cell"])),
        ("areas from corners", scene(&pool, &["solver.face_areas=nodal"])),
        ("a fixed surface", scene(&pool, &["liquid.surface=fixed"])),
        ("a ball above an obstacle", scene(&tank(0.6, &format!("{heavy}{POST}")), &[])),
        ("a ball in a full tank", scene(&full, &["liquid.surface=fixed"])),
        ("a ball that is held in a full tank", scene(&still, &["liquid.surface=fixed"])),
        (
            "a block that is carried through a full tank",
            scene(&tank(1.0, &carried([0.1, 0.1])), &["liquid.surface=fixed"]),
        ),
        (
            "a block that is pulled long in a full tank",
            scene(&tank(1.0, &carried([0.1, 0.05])), &["liquid.surface=fixed"]),
        ),
        ("out of the liquid", scene(&tank(0.2, &ball("dry", [0.5, 0.6, 0.5], 1000.0)), &[])),
        ("a bar from wall to wall", scene(&tank(0.6, bar), &[])),
    ]
}

/// Probes of the forces on these solids.
fn forces(solids: &[&str]) -> String {
    let probe = |name: &&str| format!("[[probe]]\nname = \"on_{name}\"\nforce = {{ solid = \"{name}\" }}\n");
    solids.iter().map(probe).collect()
}

/// Probes tell the force of the liquid on each solid: on one alone what steps.csv has, on several what sums up to it; where nothing is wet,
/// none; with the correction and without.
#[test]
fn forces_on_each_solid_sum_up_to_those_on_all() {
    let Some(_) = gpu() else { return };
    let light = ball("light", [0.31, 0.34, 0.52], 300.0);
    let heavy = ball("heavy", [0.7, 0.42, 0.47], 3000.0);
    let dry = ball("dry", [0.5, 0.8, 0.5], 1000.0);
    let cell = "solver.pressure_on_patches=cell";
    let all = format!("{light}{heavy}{dry}");
    for (solids, names, overrides) in [
        (&light, &["light"][..], &[][..]),
        (&all, &["heavy", "light", "dry"], &[]),
        (&all, &["heavy", "light", "dry"], &[cell]),
    ] {
        let text = tank(0.55, &format!("{solids}{}", forces(names)));
        let scene = scene(&text, overrides);
        let mut on_each = Vec::new();
        for backend in [Backend::Gpu(adapter()), Backend::Cpu] {
            let mut simulation = Simulation::new(&scene, &backend).unwrap();
            simulation.step().unwrap();
            let report = simulation.step().unwrap().coupling.unwrap();
            let probes = simulation.probes().unwrap();
            let found: Vec<DVec3> = probes.chunks_exact(3).map(DVec3::from_slice).collect();
            assert_eq!(found.len(), names.len());
            let wanted = DVec3::from(report.force) + DVec3::from(report.correction);
            let gross: f64 = found.iter().map(|force| force.length()).sum();
            let off = found.iter().sum::<DVec3>().distance(wanted);
            // The device adds them up in f32 where it has no f64, some hundred nodes in a tree.
            assert!(off <= 1e-5 * gross, "{names:?}, {backend:?}: {found:?}, {report:?}");
            let corrected = DVec3::from(report.correction).length() > 0.0;
            assert_eq!(corrected, overrides.is_empty(), "{names:?}: {report:?}");
            for (force, name) in found.iter().zip(names) {
                assert_eq!(*force == DVec3::ZERO, *name == "dry", "{name}: {force}");
            }
            on_each.extend(found);
        }
        let (device, host) = on_each.split_at(names.len());
        for (device, host) in device.iter().zip(host) {
            let off = device.distance(*host);
            assert!(off <= 1e-3 * host.length(), "{names:?}: {device} and {host}");
        }
    }
}

/// Largest difference of two fields.
pub(crate) fn off<'a>(found: impl IntoIterator<Item = &'a f64>, twin: impl IntoIterator<Item = &'a f64>) -> f64 {
    let pairs = found.into_iter().zip(twin);
    pairs.fold(0.0, |m, (a, b)| f64::max(m, (a - b).abs()))
}

/// Every sub-step from the state that the device is in.
#[test]
fn steps_are_the_twins() {
    let Some(_) = gpu() else { return };
    for (name, scene) in cases() {
        let markers = scene.liquid.as_ref().unwrap().surface == Surface::Markers;
        let mut simulation = on_gpu(&scene);
        let mut reference = reference_path(&scene).unwrap();
        for step in 0..2 {
            reference.reset(simulation.state().unwrap()).unwrap();
            let twin = reference.step(reference.next_time_step()).unwrap();
            let report = simulation.step().unwrap();
            let (found, wanted) = (simulation.state().unwrap(), reference.state());
            let what = format!("{name}, sub-step {step}: {report:?} and {twin:?}");
            // What is pulled long has to take room from a liquid that cannot give any.
            let status = match name.contains("pulled") {
                true => SolveStatus::Incompatible,
                false => SolveStatus::Converged,
            };
            for (solve, twin) in report.solves().zip(twin.solves()) {
                assert_eq!([solve.status, twin.status], [status; 2], "{what}");
                assert!(solve.residual <= scene.solver.tolerance, "{what}");
            }
            // Volumes are f32, and what volume control makes of 1e-7 of them in a frame of 0.01 s is 1e-5 m/s. Without it, velocities are of
            // up to 0.1 m/s, and the solve leaves as much as rounding to f32; in f32, it leaves its tolerance.
            let of_velocity = match (markers, scene.solver.precision == Precision::F32) {
                (_, true) => 1e-4,
                (true, false) => 2e-5,
                (false, false) => 2e-7,
            };
            for axis in 0..3 {
                let u = off(&found.velocity[axis], &wanted.velocity[axis]);
                assert!(u <= of_velocity, "{u:e} m/s, {what}");
            }
            let v = off(found.node_velocity.as_flattened(), wanted.node_velocity.as_flattened());
            assert!(v <= of_velocity, "{v:e} m/s, {what}");
            // rho dx / dt, the impedance of a cell, times that, over the depth of twelve cells.
            let p = off(&found.pressure, &wanted.pressure);
            assert!(p <= 12.0 * 1e5 / 12.0 * of_velocity, "{p:e} Pa, {what}");
            let phi = off(&found.liquid_distance, &wanted.liquid_distance);
            assert!(phi <= 1e-6, "{phi:e} m, {what}");
            let moved = off(found.displacement.as_flattened(), wanted.displacement.as_flattened());
            assert!(moved <= 1e-7, "{moved:e} m, {what}");

            let [of_twin, of_device] = [&twin, &report].map(|report| (report.liquid.unwrap(), report.solid.unwrap()));
            let [contact, twins] = [of_device.1.contact, of_twin.1.contact];
            assert_eq!(ContactReport { closing_rate: twins.closing_rate, ..contact }, twins, "{what}");
            // Of velocities as above, over gaps in f32 of at least a thousandth of a cell.
            let of_rate = of_velocity / (1e-3 * scene.grid().dx) + 1e-4 * twins.closing_rate;
            assert!((contact.closing_rate - twins.closing_rate).abs() <= of_rate, "{what}");
            assert_eq!(of_device.0.closed_components, of_twin.0.closed_components, "{what}");
            let [found, wanted] =
                [of_device, of_twin].map(|(liquid, solid)| [liquid.solve, solid.solve].map(|solve| solve.unknowns));
            assert_eq!(found, wanted, "{what}");
            let separated = of_twin.0.separation.map_or(0, |separation| separation.cells);
            assert!(!name.contains("lets go") || separated > 0, "{what}");
            let [twin, report] = [twin, report].map(|report| report.coupling.unwrap());
            assert_eq!(report.touching, twin.touching, "{what}");
            for (found, wanted) in [(report.force, twin.force), (report.correction, twin.correction)] {
                // In weak coupling what is left of pushes from both sides, which are at least the weight of the water that a ball
                // displaces: 139 N. There volume control pushes too; where volumes are summed in f32 it makes 1e-5 m/s in a sub-step of
                // these 14.2 kg.
                let sums_in_f32 = !simulation.gpu().unwrap().has_f64();
                let (least, of_volume) = match scene.solver.coupling {
                    CouplingScheme::Weak if markers && sums_in_f32 => (139.0, 14.2 * 1e-5 / 0.01),
                    CouplingScheme::Weak => (139.0, 0.0),
                    CouplingScheme::Strong | CouplingScheme::DampingOnly => (1.0, 0.0),
                };
                let weight = DVec3::from(twin.force).length().max(least);
                let off = DVec3::from(found).distance(wanted.into());
                assert!(off <= 1e-4 * weight + of_volume, "{off:e} N, {what}");
            }
            assert_eq!(report.overlap_cells, twin.overlap_cells, "{what}");
            // Rounding of the velocities over a cell, and, where the device has no f64, of potentials of 0.6 m/s on both sides of its faces.
            let divergences = [of_device.0, of_twin.0].map(|liquid| liquid.diagnosis.divergence);
            let off = (divergences[0] - divergences[1]).abs();
            let of_potential = match simulation.gpu().unwrap().has_f64() {
                true => 0.0,
                false => 6.0 * 0.6 * f64::from(f32::EPSILON),
            };
            let bound = (of_velocity + of_potential) * 12.0;
            assert!(off <= bound, "{divergences:?} 1/s, {what}");
        }
    }
}

/// A box sinks to the floor and rests on it. No liquid is below it then, wherever rounding puts its nodes: what pushes it is above it.
#[test]
fn no_liquid_is_below_what_rests_on_the_floor() {
    let Some(_) = gpu() else { return };
    let solid = "[[solid]]
name = \"box\"
mesh = { box = { size = [0.4, 0.3, 0.4], cells = [2, 2, 2] } }
placement = { translate = [0.5, 0.16, 0.5] }
density = 1500.0
young = 1e6
poisson = 0.3
";
    let mut scene = scene(&tank(0.8, solid), &["liquid.surface=fixed"]);
    let dt = 1.0 / 25.0;
    (scene.time.frames_per_second, scene.time.fixed_step) = (1.0 / dt, Some(dt));
    let mut both = [on_gpu(&scene), Simulation::new(&scene, &Backend::Cpu).unwrap()];
    for step in 0..12 {
        let coupling = both.each_mut().map(|simulation| simulation.step().unwrap().coupling.unwrap());
        let [force, twin] = coupling.map(|of| DVec3::from(of.force) + DVec3::from(of.correction));
        assert!(force.distance(twin) <= 1e-3 * twin.length(), "sub-step {step}: {coupling:?}");
        if step == 11 {
            // The water above it, 0.5 m of it.
            let above = -1000.0 * 9.81 * 0.5 * 0.4 * 0.4;
            assert!((twin.y / above - 1.0).abs() < 1e-2, "{twin} N, not {above} N");
        }
    }
}

/// Buffers, kernels and stages of coupled scenes are those planned, and a sub-step of solids that are dry runs none of the solve for both.
#[test]
fn both_take_what_is_planned() {
    let Some(gpu) = gpu() else { return };
    // Drivers without f64 are slow, and differ in the form and the precision of the solve.
    let of_solve = [
        "two balls in a pool",
        "the two-field form",
        "in single precision",
        "a block that is carried through a full tank",
    ];
    // The others differ in numbers only.
    let of_kernels = |(name, _): &(&str, Scene)| {
        !name.starts_with("a ball") && !name.contains("from") && (gpu.has_f64() || of_solve.contains(name))
    };
    for (name, scene) in cases().into_iter().filter(of_kernels) {
        assert_planned(name, &scene);
    }
}

/// The diagonal for a preconditioner, and its blocks, in contact: the same sub-steps, and what is planned.
#[test]
fn diagonals_serve_whole_steps() {
    let Some(_) = gpu() else { return };
    // Soft, so that iterations are some hundred.
    let soft = ball("heavy", [0.7, 0.42, 0.47], 3000.0).replace("young = 1e5", "young = 1e3");
    let text = tank(0.6, &format!("{soft}{POST}"));
    let step = |overrides: &[&str]| {
        let mut simulation = on_gpu(&scene(&text, overrides));
        let report = simulation.step().unwrap();
        for solve in report.solves() {
            assert_eq!(solve.status, SolveStatus::Converged, "{overrides:?}");
        }
        (simulation.state().unwrap(), report.solid.unwrap().solve.iterations)
    };
    let (wanted, iterations) = step(&["solver.formulation=two_field"]);
    // The block is soft and the polynomial has its degree: as many as on the base scene (`two_field::iterations_stay_few`).
    assert!(iterations <= 30, "{iterations}");
    for kind in ["jacobi", "block_jacobi"] {
        let overrides = [&format!("solver.preconditioner={kind}")[..], "solver.max_iterations=20000"];
        assert_planned(kind, &scene(&text, &overrides));
        let (found, iterations) = step(&overrides);
        let found = found.node_velocity.as_flattened();
        let off = off(found, wanted.node_velocity.as_flattened());
        // What the tolerance leaves.
        assert!(off <= 1e-6, "{kind}: {off:e} m/s");
        println!("{kind}: {iterations} iterations; {off:e} m/s");
    }
}

/// Where solids have no factor the form is the two-field one; where the scene asks for the other, the solve breaks down and moves nothing.
#[test]
fn without_a_factor_the_form_is_two_field() {
    let Some(gpu) = gpu() else { return };
    let mut scene = BaseScene::new(12, &BaseBeam::default()).unwrap();
    // What is held has rows in the factor, and no part in anything else.
    let mut nodes = scene.solids.prescribed.iter();
    let held = nodes.position(|held| *held == [true; 3]).unwrap();
    scene.solids.mass[held] = -1e6;
    let system = scene.coupled_system();
    for (formulation, status) in
        [(Formulation::Auto, SolveStatus::Converged), (Formulation::Condensed, SolveStatus::Breakdown)]
    {
        let solver = Solver { formulation, ..Solver::default() };
        let device = DeviceScene::new(gpu, &scene, &system, &solver).unwrap();
        device.reset();
        let outcome = device.solve().unwrap();
        assert_eq!(outcome.parts[0].status, status, "{outcome:?}");
        let (_, velocity) = device.answer().unwrap();
        let moves = velocity.as_flattened().iter().any(|v| *v != 0.0);
        assert_eq!(moves, status == SolveStatus::Converged, "{outcome:?}");
        assert!(!(moves && outcome.condensed), "{outcome:?}");
    }
}

/// A block of which 866 nodes are wet, more than are worth the dense inverse where corrections of both fields are quick: of stiff bodies these
/// would take more iterations than there are, and the scene may ask for either.
#[test]
fn many_wet_nodes_are_condensed_where_the_polynomial_ends_early() {
    let Some(_) = gpu() else { return };
    let block = |young: &str| {
        format!(
            "[[solid]]
name = \"block\"
mesh = {{ box = {{ size = [0.4, 0.4, 0.4], cells = [12, 12, 12] }} }}
placement = {{ translate = [0.5, 0.4, 0.5] }}
density = 300.0
young = {young}
poisson = 0.3
"
        )
    };
    for (young, formulation, condensed) in [("1e8", "auto", true), ("1e3", "auto", false), ("1e3", "condensed", true)] {
        let form = format!("solver.formulation={formulation}");
        let mut simulation = on_gpu(&scene(&tank(0.8, &block(young)), &[&form]));
        let report = simulation.step().unwrap();
        let case = format!("{young} Pa, {formulation}");
        assert_eq!(report.coupling.unwrap().condensed, condensed, "{case}");
        for solve in report.solves() {
            assert_eq!(solve.status, SolveStatus::Converged, "{case}: {solve:?}");
        }
    }
}

/// Buffers, kernels and stages of a coupled scene are those planned.
fn assert_planned(name: &str, scene: &Scene) {
    let sums = |list: Vec<(String, u64)>| {
        let mut sums = BTreeMap::<String, u64>::new();
        for (label, bytes) in list {
            *sums.entry(label).or_default() += bytes;
        }
        // Their number is an estimate.
        sums.remove("liquid.markers");
        sums.remove("level.marker_velocity");
        sums
    };
    let mut simulation = on_gpu(scene);
    let plan = Plan::new(scene, simulation.adapter()).unwrap();
    let planned = plan.buffers.iter();
    let planned = planned.map(|plan| (plan.label.to_owned(), plan.bytes()));
    let allocated = || simulation.gpu().unwrap().allocated();
    assert_eq!(sums(planned.collect()), sums(allocated()), "{name}: buffers");
    let kernels = plan.stages.iter().flat_map(|stage| &stage.kernels).copied();
    let kernels: BTreeSet<&str> = kernels.collect();
    let compiled = simulation.gpu().unwrap().compiled();
    assert_eq!(kernels, compiled, "{name}: kernels");
    let before = allocated();
    simulation.step().unwrap();
    simulation.gpu().unwrap().start_trace();
    let report = simulation.step().unwrap();
    let gpu = simulation.gpu().unwrap();
    let touching = report.coupling.unwrap().touching;
    for (stage, kernel) in gpu.take_trace().dispatches {
        let planned = plan.stages.iter().find(|planned| planned.name == stage);
        let kernels = planned.map_or(&[][..], |planned| &planned.kernels);
        assert!(kernels.contains(&kernel), "{name}: {kernel} in {stage}");
        let of_both = kernel.starts_with("two_field");
        assert!(touching || !of_both, "{name}: {kernel}");
    }
    assert_eq!(gpu.allocated(), before, "{name}: a sub-step allocates");
    if simulation.adapter().unwrap().timestamps {
        let run: Vec<&str> = report.seconds.iter().map(|(stage, _)| *stage).collect();
        let every = plan.stages.iter().filter(|stage| stage.every_step);
        let every: Vec<&str> = every.map(|stage| stage.name).collect();
        assert_eq!(run, every, "{name}: stages");
    }
}

/// A cube that starts with an eighth of its volume and grows out of the room that was planned for it.
#[test]
fn room_grows_with_the_solids() {
    let Some(_) = gpu() else { return };
    let cube = "[[solid]]
name = \"cube\"
mesh = { box = { size = [0.5, 0.5, 0.5], cells = [3, 3, 3] } }
placement = { translate = [0.5, 0.4, 0.5] }
initial = { scale = 0.3 }
density = 1000.0
young = 2e5
poisson = 0.3
damping = { stiffness = 0.01 }
";
    let scene = scene(&tank(0.7, cube), &[]);
    let mut simulation = on_gpu(&scene);
    let before = simulation.gpu().unwrap().allocated().len();
    let mut reference = reference_path(&scene).unwrap();
    for _ in 0..8 {
        let state = simulation.state().unwrap();
        reference.reset(state).unwrap();
        let twin = reference.step(reference.next_time_step()).unwrap();
        let report = simulation.step().unwrap();
        assert_eq!(report.solid.unwrap().solve.status, SolveStatus::Converged);
        let [found, wanted] = [&report, &twin].map(|report| report.solid.unwrap().diagnosis);
        let off = (found.kinetic_energy / wanted.kinetic_energy - 1.0).abs();
        assert!(off <= 1e-4, "{found:?} {wanted:?}");
    }
    let after = simulation.gpu().unwrap().allocated().len();
    assert!(after > before, "{before} and {after} buffers");
}

/// Bit for bit, in one process and with any number of threads; and a state in the middle goes on as if nothing had happened.
#[test]
fn runs_repeat() {
    let Some(_) = gpu() else { return };
    let (_, scene) = cases().swap_remove(1);
    let mut first = on_gpu(&scene);
    let mut again = on_gpu(&scene);
    for _ in 0..3 {
        let [a, b] = [&mut first, &mut again].map(|simulation| simulation.step().unwrap());
        assert_eq!((a.liquid, a.solid, a.coupling), (b.liquid, b.solid, b.coupling));
    }
    let state = first.state().unwrap();
    assert_eq!(state, again.state().unwrap());
    again.reset(&state).unwrap();
    let [a, b] = [&mut first, &mut again].map(|simulation| simulation.step().unwrap());
    let [force, resumed] = [a, b].map(|report| DVec3::from(report.coupling.unwrap().force));
    // The pressure of a state is Pa, and that of the device a potential.
    assert!(force.distance(resumed) <= 1e-6 * force.length());
    let end = first.state().unwrap();
    let values = end.pressure.iter().chain(end.node_velocity.as_flattened());
    println!("digest of both: {:x}", digest(values.copied()));
}

#[test]
fn threads_do_not_matter() {
    if gpu().is_some() {
        same_with_any_number_of_threads("coupled_gpu::runs_repeat", 1);
    }
}

/// `compare` passes on every case.
#[test]
fn every_stage_is_compared() {
    let Some(_) = gpu() else { return };
    for (name, scene) in cases() {
        if scene.solver.coupling != CouplingScheme::Strong {
            let refused = compare(&scene, 1, &adapter(), &mut |_, _| {});
            let message = refused.unwrap_err().to_string();
            assert!(message.contains("solver.coupling=strong"), "{message}");
            continue;
        }
        let compared = compare(&scene, 2, &adapter(), &mut |_, _| {}).unwrap();
        let stages: BTreeSet<&str> = compared.rows.iter().map(|row| row.stage).collect();
        let touching = name != "out of the liquid";
        let together = compared.rows.iter().any(|row| row.quantity == "v, with liquid");
        assert_eq!(together, touching, "{name}");
        for stage in ["clip", "move_solid", "solve", "extrapolate", "diagnose"] {
            assert!(stages.contains(stage), "{name}: no {stage} in {stages:?}");
        }
        compared.verdict().unwrap_or_else(|error| panic!("{name}: {error}"));
    }
}

/// What `export` wrote of a sub-step.
struct Exported {
    spd: Csr,
    indefinite: Csr,
    /// Of the indefinite system; of the other.
    rhs: [Vec<f64>; 2],
    solution: Vec<f64>,
    /// Rows of the pressure.
    n_cells: usize,
    cells: String,
}

impl Exported {
    fn new(scene: &Scene, backend: Backend) -> Exported {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("system");
        let options = export::Options { backend, step: 0, start: None, out: out.clone() };
        export::export(scene, &options).unwrap();
        let matrix = |name: &str| read_matrix(&out.join(name)).unwrap();
        let vector = |name: &str| read_vector(&out.join(name)).unwrap();
        Exported {
            spd: matrix("spd.mtx"),
            indefinite: matrix("indefinite.mtx"),
            rhs: ["indefinite_rhs.mtx", "spd_rhs.mtx"].map(vector),
            solution: vector("solution.mtx"),
            n_cells: matrix("B.mtx").n_rows(),
            cells: std::fs::read_to_string(out.join("cells.csv")).unwrap(),
        }
    }

    /// Largest differences of pressures and of velocities, relative to the largest of each; what gravity does in a step is one of these.
    fn off(&self, [found, wanted]: [&[f64]; 2]) -> [f64; 2] {
        let parts = [(0..self.n_cells, 0.0), (self.n_cells..wanted.len(), 0.0981)];
        parts.map(|(range, least)| {
            let largest = wanted[range.clone()].iter().fold(least, |m, x| f64::max(m, x.abs()));
            off(&found[range.clone()], &wanted[range]) / largest
        })
    }

    /// By factors, one correction each.
    fn direct(&self) -> [Vec<f64>; 2] {
        let indefinite = SymbolicCholesky::new(&self.indefinite).unwrap();
        let spd = SymbolicCholesky::new(&self.spd).unwrap();
        let indefinite = indefinite.factorise_quasi_definite(&self.indefinite).unwrap();
        let positive = "spd.mtx is positive definite";
        let spd = spd.factorise(&self.spd).expect(positive);
        let solve = |matrix: &Csr, which: usize, correct: &dyn Fn(&mut [f64])| {
            let mut x = vec![0.0; self.solution.len()];
            for _ in 0..2 {
                let mut product = vec![0.0; x.len()];
                matrix.multiply(&x, &mut product);
                let pairs = self.rhs[which].iter().zip(&product);
                let mut correction: Vec<f64> = pairs.map(|(b, y)| b - y).collect();
                correct(&mut correction);
                x.iter_mut().zip(correction).for_each(|(x, dx)| *x += dx);
            }
            x
        };
        [solve(&self.indefinite, 0, &|x| indefinite.solve(x)), solve(&self.spd, 1, &|x| spd.solve(x))]
    }
}

/// The system that a device stored, its answer, and that of the f64 path: liquid at rest, held and carried nodes, closed components, nodes
/// on walls.
#[test]
fn exported_systems_are_the_stored_ones() {
    let Some(gpu) = gpu() else { return };
    let chosen = [
        "two balls in a pool",
        "the two-field form",
        "a ball above an obstacle",
        "a ball that is held in a full tank",
        "a block that is carried through a full tank",
        "a bar from wall to wall",
    ];
    for (name, mut scene) in cases() {
        if !chosen.contains(&name) {
            continue;
        }
        // What the residual may leave of the answer, and in f32, rounding. Of the difference to the f64 path, coefficients in f32
        // and, with markers, volumes: see `steps_are_the_twins`.
        let markers = scene.liquid.as_ref().unwrap().surface == Surface::Markers;
        let [of_solve, of_f32] = match (gpu.has_f64(), markers) {
            (true, true) => [1e-8, 2e-5 / 0.0981],
            (true, false) => [1e-8, 1e-5],
            (false, _) => [1e-6, 2e-5 / 0.0981],
        };
        if gpu.has_f64() {
            scene.solver.tolerance = 1e-12;
        }
        let device = Exported::new(&scene, Backend::Gpu(adapter()));
        let host = Exported::new(&scene, Backend::Cpu);
        let [indefinite, spd] = device.direct();
        let found = device.off([&device.solution, &indefinite]);
        assert!(found.iter().all(|off| *off <= of_solve), "{name}: {found:?}");
        // A22 is a product of matrices: what its condition costs.
        let forms = device.off([&spd, &indefinite]);
        assert!(forms.iter().all(|off| *off <= 1e-9), "{name}: {forms:?}");
        assert_eq!(device.cells, host.cells, "{name}");
        let paths = device.off([&device.solution, &host.solution]);
        assert!(paths.iter().all(|off| *off <= of_f32), "{name}: {paths:?}");
        println!("{name}: {found:?} {forms:?} {paths:?}");
        for (one, two) in [(&device.spd, &host.spd), (&device.indefinite, &host.indefinite)] {
            assert_eq!(one.n_entries(), two.n_entries(), "{name}");
            for (row, column, value) in one.triplets() {
                let size = (two.get(row, row) * two.get(column, column)).abs().sqrt();
                let off = (two.get(row, column) - value).abs();
                assert!(off <= 1e-5 * size, "{name}, {row}, {column}: {off:e} of {size:e}");
            }
        }
    }
}

/// Above the liquid there is no system of both.
#[test]
fn solids_out_of_the_liquid_store_no_system_of_both() {
    let Some(_) = gpu() else { return };
    let (_, scene) = cases().into_iter().find(|(name, _)| *name == "out of the liquid").unwrap();
    let options = export::Options {
        backend: Backend::Gpu(adapter()),
        step: 0,
        start: None,
        out: tempfile::tempdir().unwrap().path().join("system"),
    };
    let error = export::export(&scene, &options).unwrap_err().to_string();
    assert!(error.contains("do not touch"), "{error}");
}
