//! Separation on the GPU: the conditions of its result, its twin, and resumed runs.

use cutwater::measure::compare::compare;
use cutwater::reference::touching_cells;
use cutwater::scene::Scene;
use cutwater::sim::{Backend, Simulation, reference_path};
use cutwater::state::{SolveStatus, State};

use crate::common::{adapter, gpu};
use crate::liquid_case::EPS;
use crate::separation::{
    DAM, GRAVITY, Solved, assert_complementary, ceiling, domain, filled, piston, pulled_block, scene, separation, speed,
};

fn on_gpu(text: &str) -> Simulation {
    Simulation::new(&scene(text), &Backend::Gpu(adapter())).unwrap()
}

/// The wave of the dam on its way along the ceiling, rounded as on the device.
fn wave(kind: &str) -> (Simulation, State) {
    let (height, _) = DAM;
    let text = ceiling(kind);
    let mut reference = reference_path(&scene(&text)).unwrap();
    while reference.state().time < 2.2 * (height / GRAVITY).sqrt() {
        reference.step(reference.next_time_step()).unwrap();
    }
    let mut simulation = on_gpu(&text);
    simulation.reset(reference.state()).unwrap();
    let state = simulation.state().unwrap();
    assert_eq!(state.separated, reference.state().separated);
    (simulation, state)
}

#[test]
fn pressures_and_openings_of_the_device_are_complementary() {
    let Some(_) = gpu() else { return };
    let (mut simulation, mut before) = wave("walls");
    let scene = scene(&ceiling("walls"));
    let mut separated = 0;
    for _ in 0..8 {
        let report = separation(&simulation.step().unwrap());
        let state = simulation.state().unwrap();
        let cut = simulation.cut_cells();
        let cells = assert_complementary(&Solved {
            scene: &scene,
            cut,
            flux: Vec::new(),
            touching: touching_cells(&scene.grid(), &cut.open, None),
            state: &state,
            speed_before: speed(&before),
            unit: EPS,
        });
        assert_eq!(cells, report.cells);
        separated += cells;
        before = state;
    }
    assert!(separated > 0, "the case has separated cells");
}

/// Both paths from the same state. Rounding may decide whether a cell with almost no pressure separates, and the pressure depends
/// on the data continuously.
#[test]
fn a_sub_step_is_that_of_the_twin() {
    let Some(_) = gpu() else { return };
    for kind in ["walls", "from_air"] {
        let (mut simulation, state) = wave(kind);
        let mut reference = reference_path(&scene(&ceiling(kind))).unwrap();
        reference.reset(state).unwrap();
        for _ in 0..3 {
            let report = separation(&simulation.step().unwrap());
            let twin = reference.step(reference.next_time_step()).unwrap();
            let twin = separation(&twin);
            let (ours, theirs) = (simulation.state().unwrap(), reference.state());
            let largest = theirs.pressure.iter().fold(0.0, |max: f64, p| max.max(p.abs()));
            // Velocities and distances have passed several stages in f32; theta is a quotient with a floor of 0.15.
            let bound = 1e3 * EPS / 0.15 * largest;
            for (cell, (p, twin)) in ours.pressure.iter().zip(&theirs.pressure).enumerate() {
                assert!((p - twin).abs() <= bound, "{kind}, cell {cell}: {p} Pa, twin {twin} Pa");
            }
            let pairs = ours.separated.iter().zip(&theirs.separated);
            let other = pairs.filter(|(ours, theirs)| ours != theirs).count();
            assert!(other * 20 <= twin.cells, "{kind}: {other} of {} cells", twin.cells);
            let opened = (report.opened - twin.opened).abs();
            assert!(opened <= 1e-2 * twin.opened, "{kind}: {report:?}, twin {twin:?}");
            assert!((report.least_pressure - twin.least_pressure).abs() <= bound);
            reference.reset(ours).unwrap();
        }
    }
}

/// Liquid that falls off the floor of a tank, from its open side on. Rows of cells end within a quad. Pressures at the floor are far from 0, so the sets
/// are the same.
#[test]
fn liquid_leaves_a_floor_from_an_open_side_on_as_in_the_twin() {
    let Some(_) = gpu() else { return };
    let liquid = "separation = \"from_air\"\nvolume_control = false\n".to_owned() + &filled([0.9, 0.3]);
    let text = domain([18, 12, 5], 0.05, GRAVITY, &liquid);
    let text = text.replace("gravity", "open = [\"+x\"]\ngravity");
    let mut simulation = on_gpu(&text);
    let mut reference = reference_path(&scene(&text)).unwrap();
    reference.reset(simulation.state().unwrap()).unwrap();
    let report = separation(&simulation.step().unwrap());
    reference.step(reference.next_time_step()).unwrap();
    let ours = simulation.state().unwrap().separated;
    assert_eq!(ours, reference.state().separated);
    let grid = scene(&text).grid();
    let on_floor = |x: usize| ours.get(grid.cell([x, 0, 2])).copied().unwrap_or_default();
    assert!(on_floor(17) && !on_floor(2), "{report:?}");
}

/// Iterations and rounds of a number of sub-steps.
fn cost(mut simulation: Simulation, steps: usize) -> (u32, u32) {
    let (mut iterations, mut rounds) = (0, 0);
    for _ in 0..steps {
        let report = simulation.step().unwrap();
        iterations += report.liquid.unwrap().solve.iterations;
        rounds += separation(&report).rounds;
    }
    (iterations, rounds)
}

/// Two rough solves mostly find the set: all rounds after the first add at most 60 % of a solve. Where the host refines they start from zero, and cost more.
#[test]
fn a_set_that_changes_costs_little() {
    if !gpu().is_some_and(|gpu| gpu.has_f64()) {
        return;
    }
    let [without, with] = ["none", "walls"].map(|kind| {
        let (simulation, _) = wave(kind);
        cost(simulation, 8)
    });
    assert!(with.1 > 16, "the set changes: {with:?}");
    assert!(10 * with.0 <= 16 * without.0, "{with:?}, {without:?}");
}

/// A tilted plate leaves water, and a ball enters it beside a shelf.
fn bodies() -> [String; 2] {
    let plate = "[[obstacle]]\nbox = { min = [0.3, 0.37, -1], max = [0.7, 0.41, 1] }\n\
                 placement = { rotate = { axis = [0, 0, 1], degrees = 3 } }\n\
                 keyframes = [{ t = 0 }, { t = 0.4, translate = [0, 0.6, 0] }]\n";
    let ball = "[[obstacle]]\nsphere = { centre = [0.5, 0.62, 0.125], radius = 0.1 }\n\
                keyframes = [{ t = 0 }, { t = 0.3, translate = [0, -0.9, 0] }]\n\
                [[obstacle]]\nbox = { min = [0, 0.3, -1], max = [0.2, 0.35, 1] }\n\
                placement = { rotate = { axis = [0, 0, 1], degrees = 20 } }\n";
    [("from_air", 0.4, plate), ("walls", 0.5, ball)].map(|(kind, level, bodies)| {
        let text = format!("separation = \"{kind}\"\n{}{bodies}", filled([1.0, level]));
        domain([24, 24, 6], 1.0 / 24.0, -GRAVITY, &text)
    })
}

/// Elastic bodies that leave water: a block pulled out, a plate lifted off the surface, and a light ball thrown out of a pool.
fn elastic_bodies() -> [(&'static str, String); 3] {
    let plate = "[[solid]]\nname = \"plate\"\nmesh = { box = { size = [0.5, 0.12, 0.2], cells = [8, 2, 3] } }\n\
                 placement = { translate = [0.5, 0.43, 0.125] }\ndensity = 300\nyoung = 1e6\npoisson = 0.3\n\
                 [[solid.script]]\nregion = { box = { min = [0.4, 0.46, -1], max = [0.6, 1, 1] } }\n\
                 keyframes = [{ t = 0 }, { t = 0.4, translate = [0, 0.6, 0] }]\n";
    let ball = "[[solid]]\nname = \"ball\"\nmesh = { sphere = { radius = 0.11, cell_size = 0.06 } }\n\
                placement = { translate = [0.5, 0.36, 0.125] }\ndensity = 200\nyoung = 1e5\npoisson = 0.3\n\
                initial = { velocity = [0.3, 2.5, 0] }\n";
    let with = |level: f64, body: &str| {
        let liquid = "separation = \"walls\"\nvolume_control = false\n".to_owned();
        let text = liquid + &filled([1.0, level]) + body;
        domain([20, 20, 5], 1.0 / 20.0, -GRAVITY, &text)
    };
    [("block", pulled_block()), ("plate", with(0.41, plate)), ("ball", with(0.4, ball))]
}

/// Both forms of the coupled solve, and the other schemes.
const SOLVERS: [&str; 4] = [
    "formulation = \"condensed\"",
    "formulation = \"two_field\"",
    "coupling = \"weak\"",
    "coupling = \"damping_only\"",
];

#[test]
fn pressures_and_openings_beside_elastic_solids_are_complementary_on_the_device() {
    if gpu().is_none() {
        return;
    }
    for (name, text) in elastic_bodies() {
        for solver in &SOLVERS[..2] {
            let text = format!("{text}[solver]\n{solver}\n");
            let (scene, mut simulation) = (scene(&text), on_gpu(&text));
            let grid = scene.grid();
            let mut before = simulation.state().unwrap();
            let mut separated = 0;
            for step in 0..10 {
                let report = simulation.step().unwrap();
                let together = report.coupling.unwrap().touching;
                let report = separation(&report);
                let state = simulation.state().unwrap();
                let clip = simulation.gpu_path().unwrap().clip().unwrap();
                let cut = simulation.cut_cells();
                let mut flux = vec![0.0; grid.n_cells()];
                let nodes = state.node_velocity.as_flattened();
                clip.coupling().add_product(nodes, &mut flux);
                let cells = assert_complementary(&Solved {
                    scene: &scene,
                    cut,
                    flux,
                    touching: touching_cells(&grid, &cut.open, Some(clip)),
                    state: &state,
                    speed_before: speed(&before),
                    unit: EPS,
                });
                assert_eq!(cells, report.cells, "{name}, {solver}, step {step}");
                assert!(together || step > 0, "{name}: liquid and solid touch at first");
                separated += cells;
                before = state;
            }
            assert!(separated > 0, "{name}, {solver}: cells separate");
        }
    }
}

/// The same beside elastic solids, in both forms.
#[test]
fn sets_beside_elastic_solids_cost_little() {
    if !gpu().is_some_and(|gpu| gpu.has_f64()) {
        return;
    }
    for (name, text) in elastic_bodies() {
        for solver in &SOLVERS[..2] {
            let [without, with] = ["none", "walls"].map(|kind| {
                let text = text.replace("\"walls\"", &format!("\"{kind}\""));
                cost(on_gpu(&format!("{text}[solver]\n{solver}\n")), 10)
            });
            assert!(with.1 > 15, "{name}, {solver}: the set changes: {with:?}");
            assert!(10 * with.0 <= 16 * without.0, "{name}, {solver}: {with:?}, {without:?}");
        }
    }
}

#[test]
fn every_stage_beside_elastic_solids_is_that_of_its_twin() {
    if gpu().is_none() {
        return;
    }
    for (name, text) in elastic_bodies() {
        for solver in &SOLVERS[..2] {
            let scene = scene(&format!("{text}[solver]\n{solver}\n"));
            assert_clean(&scene, 2, &format!("{name}, {solver}"));
        }
    }
}

/// Both forms find the same set, and pressures to the tolerance.
#[test]
fn both_forms_separate_the_same_cells() {
    if gpu().is_none() {
        return;
    }
    for (name, text) in elastic_bodies() {
        let [condensed, two_field] = [SOLVERS[0], SOLVERS[1]].map(|solver| {
            let mut simulation = on_gpu(&format!("{text}[solver]\n{solver}\ntolerance = 1e-9\n"));
            simulation.step().unwrap();
            simulation.state().unwrap()
        });
        let pairs = condensed.separated.iter().zip(&two_field.separated);
        let other = pairs.filter(|(ours, theirs)| ours != theirs).count();
        let cells = condensed.separated.iter().filter(|on| **on).count();
        // Rounding may decide whether a cell with almost no pressure separates.
        assert!(20 * other <= cells, "{name}: {other} of {cells} cells");
        assert!(cells > 0, "{name}");
    }
}

/// Compares every stage with its twin.
fn assert_clean(scene: &Scene, frames: u64, case: &str) {
    let comparison = compare(scene, frames, &adapter(), &mut |_, _| {}).unwrap();
    let breached: Vec<_> = comparison.rows.iter().filter(|row| row.breached()).collect();
    assert!(breached.is_empty(), "{case}: {breached:?}");
    assert!(comparison.verdict().is_ok(), "{case}");
}

#[test]
fn every_stage_is_that_of_its_twin() {
    let Some(_) = gpu() else { return };
    for text in bodies() {
        assert_clean(&scene(&text), 2, "");
    }
}

/// Enclosed liquid opens where its walls recede, by the room that they leave.
#[test]
fn enclosed_liquid_opens_as_in_its_twin() {
    if gpu().is_none() {
        return;
    }
    let with_markers = |text: String| text.replace("volume_control = false", "surface = \"markers\"");
    let cases = [("walls", false), ("from_air", false), ("walls", true), ("from_air", true)];
    let pistons = cases.map(|(kind, solid)| (kind, solid, piston(kind, solid)));
    let (text, speed) = piston("walls", false);
    // Volume control leaves closed liquid out, also where it opens.
    let controlled = ("walls", false, (with_markers(text), speed));
    for (kind, solid, (text, speed)) in pistons.into_iter().chain([controlled]) {
        let mut simulation = on_gpu(&text);
        let report = simulation.step().unwrap();
        let first = separation(&report);
        let (opened, room) = (first.opened, speed * report.dt * 0.25);
        assert!((opened - room).abs() < 1e-5 * room, "{kind}, {solid}: {opened} m^3 of {room} m^3");
        for _ in 0..3 {
            assert!(separation(&simulation.step().unwrap()).cells > 0);
        }
        assert_clean(&scene(&text), 2, &format!("{kind}, solid {solid}"));
    }
}

#[test]
fn runs_of_the_device_resume_with_their_separated_cells() {
    if gpu().is_none() {
        return;
    }
    let elastic = elastic_bodies().map(|(_, text)| text);
    let schemes = SOLVERS[1..].iter();
    let schemes = schemes.map(|solver| format!("{}[solver]\n{solver}\n", pulled_block()));
    for text in bodies().into_iter().chain(elastic).chain(schemes) {
        let mut whole = on_gpu(&text);
        let mut separated = 0;
        while whole.clock().frame < 1 {
            let liquid = whole.step().unwrap().liquid.unwrap();
            assert_eq!(liquid.solve.status, SolveStatus::Converged);
            separated += liquid.separation.unwrap().cells;
        }
        assert!(separated > 0);
        let (state, carried) = (whole.state().unwrap(), whole.carried().unwrap());
        let mut resumed = on_gpu(&text);
        resumed.resume(&state, &carried).unwrap();
        for simulation in [&mut whole, &mut resumed] {
            simulation.step().unwrap();
            simulation.step().unwrap();
        }
        assert_eq!(whole.state().unwrap(), resumed.state().unwrap());
    }
}
