//! `bench stability` on a fixed subset of its cases: rows say what happened, and failures are named.

use std::fs;

use cutwater::measure::bench::stability::{
    Budget, Case, Expected, Options, cases, check, completed, count, growth, lost, measure, name_misses,
    solid_diagnosis,
};
use cutwater::measure::bench::table::Row;
use cutwater::reference::diagnose_liquid;
use cutwater::scene::Scene;
use cutwater::sim::{Backend, Simulation};
use cutwater::state::{Diagnosis, SolidDiagnosis, State};

use crate::bench::{measured, numbers, row, settings};
use crate::common::{adapter, gpu, root};

/// Sub-steps on the GPU path.
const STEPS: u64 = 8;
/// On the f64 path: in these columns break and droplets land.
const STEPS_F64: u64 = 16;
/// Sub-steps of the thesis's scene, 0.6 s: the front is at the beam after 0.2.
const THESIS_STEPS: u64 = 60;
/// `young_1e3` fails in sub-step 23.
const YOUNG_STEPS: u64 = 30;

fn options(names: &[&str]) -> Options {
    Options {
        steps: STEPS,
        cases: names.iter().map(|&name| name.to_owned()).collect(),
        scale: 1.0,
        backend: Backend::Gpu(adapter()),
    }
}

/// What holds in every hostile case, after so many sub-steps. Of cases that fail later it would say nothing.
fn assert_sound(row: &Row, steps: u64) {
    assert!(!known(row.text("name")), "{row:?}");
    assert!(row.flag("passed") && completed(row), "{row:?}");
    let plain = row.count("missed") + row.count("unsettled") == 0;
    assert_eq!(row.text("status") == "completed", plain, "{row:?}");
    let counts = ["sub_steps", "non_finite"].map(|name| row.count(name));
    assert_eq!(counts, [steps as usize, 0], "{row:?}");
    // In the end there is no more than at the start and what falling gains: the bound without its tenth. It is measured: no longer 1.
    let most = row.number("energy_bound") - 0.1;
    let measured = row.number("energy_end") > 0.0 && row.number("energy_end") != 1.0;
    assert!(measured && row.number("energy_end") <= most, "{row:?}");
    // What a fall through the whole box gains in a sub-step of any of these is a fraction of what it has; of 1/15 s it is the most.
    let name = row.text("name");
    let fraction = if name.ends_with("_15") { 1.0 } else { 0.7 };
    assert!(most > 1.0 && most < 1.0 + fraction, "{row:?}");
    let [motion, speed, seconds] = numbers(row, ["motion", "solid_speed", "seconds"]);
    assert!(motion > 0.0 && speed > 0.0 && seconds > 0.0, "{row:?}");
    for name in ["motion", "solid_speed", "liquid_speed"] {
        assert!(row.number(name) <= row.number(&format!("{name}_bound")), "{row:?}");
    }
    // A beam of two cells in an obstacle: the centres of its cells are half a cell deep in both.
    let overlaps = row.number("overlap") > 0.5;
    assert!(name != "wall_through" || overlaps, "{row:?}");
    let inverts = row.number("min_det") < 0.0;
    assert_eq!(inverts, name == "start_inverted", "{row:?}");
    assert!(row.count("nodes") > 60, "{row:?}");
}

/// Names of all cases, and of those that are known to fail.
fn names() -> [Vec<String>; 2] {
    let cases = cases(STEPS, 1.0).unwrap();
    let failing = cases.iter().filter(|case| case.known_failure.is_some());
    let failing = failing.map(|case| case.name.clone()).collect();
    [cases.into_iter().map(|case| case.name).collect(), failing]
}

fn known(name: &str) -> bool {
    names()[1].iter().any(|known| known == name)
}

/// The rows that fail in the table of all cases, each over its whole run, are those known to; the pages name them all. Whoever mends one, or
/// breaks another, finds it here.
#[test]
fn the_measured_failures_are_the_known_ones() {
    let read = |file: &str| fs::read_to_string(root().join(file)).unwrap();
    let table = read("docs/measured/stability/stability.csv");
    let mut reader = csv::Reader::from_reader(table.as_bytes());
    let headers = reader.headers().unwrap().clone();
    let column = |name: &str| headers.iter().position(|header| header == name).unwrap();
    let [name, passed, expected, steps] = ["name", "passed", "expected", "steps"].map(column);
    let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    let hostile = rows.iter().filter(|row| &row[expected] == "completes");
    let hostile: Vec<&csv::StringRecord> = hostile.collect();
    assert!(hostile.len() >= 60, "{}", hostile.len());
    assert!(hostile.iter().all(|row| &row[steps] == "300"));
    let failed = rows.iter().filter(|row| &row[passed] == "false");
    let failed: Vec<&str> = failed.map(|row| &row[name]).collect();
    assert_eq!(failed, names()[1]);
    for page in ["docs/bench.md", "docs/measured/stability.md"] {
        let text = read(page);
        for name in &failed {
            assert!(text.contains(&format!("`{name}`")), "{page}: no {name}");
        }
    }
}

/// A known failure is reported as one, with its cause.
#[test]
fn a_known_failure_fails_the_bench() {
    let options = Options { steps: YOUNG_STEPS, backend: Backend::Cpu, ..options(&["young_1e3", "young_1e5"]) };
    let table = measured(1, |settings, listener| measure(&options, settings, listener));
    let [soft, stiffer] = table.rows("stability") else { panic!("{:?}", table.rows("stability")) };
    assert!(stiffer.flag("passed") && completed(stiffer), "{stiffer:?}");
    let mended = "remove known_failure of young_1e3 from cases.toml and measure the table of docs/bench.md anew";
    let fails = !soft.flag("passed") && !completed(soft);
    assert!(fails, "{mended}: {soft:?}");
    let [motion, bound] = numbers(soft, ["motion", "motion_bound"]);
    assert!(motion > bound, "{soft:?}");
    let error = table.results.verdict().unwrap_err();
    let text = error.to_string();
    assert_eq!(error.exit_code(), 1);
    for part in ["1 of 2 cases", "young_1e3: step ", "energy of motion", "(known: the pool's pressure"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert!(!text.contains("young_1e5"), "{text}");
}

#[test]
fn hostile_cases_keep_their_energy() {
    let Some(_) = gpu() else { return };
    let names = [
        "start_inverted",
        "start_spun",
        "gap_solids_0.2_light",
        "droplet_rain",
        "closed_light",
        "wall_obstacle",
        "empty_nothing",
    ];
    let options = options(&names);
    let table = measured(1, |settings, listener| measure(&options, settings, listener));
    let rows = table.rows("stability");
    assert_eq!([table.told, rows.len()], [names.len(); 2]);
    for row in rows {
        assert_sound(row, STEPS);
        let found = (row.count("cells"), row.text("backend"));
        assert_eq!(found, (4096, "gpu"), "{row:?}");
        assert!(row.has("most_iterations"), "{row:?}");
    }
    table.results.verdict().unwrap();
    for file in ["stability.csv", "stability.json", "stability.svg"] {
        let text = table.text(file);
        assert!(names.iter().all(|name| text.contains(name)), "{file}");
        table.assert_written(&[file]);
    }
}

/// One or two of each group on the f64 path, where solves are direct. The tables name no adapter.
#[test]
fn a_case_of_each_group_keeps_its_energy_on_the_cpu() {
    let names = [
        "density_0.1",
        "young_1e9",
        "poisson_0.45",
        "damping_both",
        "step_60",
        "gravity_10g_stiff_light",
        "start_inverted",
        "start_spun",
        "sliver_turned",
        "gap_floor_0.1",
        "wall_through",
        "droplet_rain",
        "closed_heavy",
        "inside_half",
        "empty_nothing",
        "empty_never",
        "corner_light_soft_15",
        "corner_heavy_stiff_15",
        "corner_light_stiff_1000",
    ];
    let options = Options { steps: STEPS_F64, backend: Backend::Cpu, ..options(&names) };
    let table = measured(1, |settings, listener| measure(&options, settings, listener));
    table.results.verdict().unwrap();
    let rows = table.rows("stability");
    let found: Vec<&str> = rows.iter().map(|row| row.text("name")).collect();
    assert_eq!(found, names);
    for row in rows {
        assert_sound(row, STEPS_F64);
        assert_eq!(numbers(row, ["missed", "unsettled"]), [0.0; 2], "{row:?}");
        // Where a body alone gives liquid room, B is singular and the solve iterative.
        let sealed = matches!(row.text("group"), "closed" | "inside");
        assert!(sealed || !row.has("most_iterations"), "{row:?}");
        // A pool that only a body stirs keeps its volume to twice the dead band of its control; one that a body leaves as it unfolds or jumps out, or
        // that a body encloses, to the cells beside the body, a fiftieth of the pool.
        let pool = !["poisson", "damping", "step", "gravity", "droplet", "empty"].contains(&row.text("group"));
        let missing = 1.0 - row.number("volume_least");
        let most = if ["start", "inside", "corner"].contains(&row.text("group")) { 0.02 } else { 0.01 };
        assert!(!pool || missing <= most, "{row:?}");
    }
    let (json, machine) = (table.text("stability.json"), &table.results.machine);
    let json = crate::common::json(json);
    assert_eq!(json["rows"][0]["backend"], "cpu");
    assert_eq!(json["measured"], machine.measured.as_str());
    assert_eq!(json["cpu"].as_str(), machine.cpu.as_deref());
    assert!(json.get("adapter").is_none());
    assert!(table.text("stability.svg").contains("the f64 path"));
}

/// The thesis's section 6.3 on 14 cells an edge, as far as half a second tells. Weak coupling takes the finer grid of the bench to tear the beam.
#[test]
fn strong_coupling_keeps_the_thesis_beam_stiff() {
    let cases = cases(STEPS, 0.4).unwrap().into_iter();
    let ours = ["thesis_strong", "thesis_undamped"];
    let of_thesis = cases.filter(|case| ours.contains(&case.name.as_str()));
    let mut rows = of_thesis.map(|mut case| {
        case.steps = THESIS_STEPS;
        case.run(&Backend::Cpu).unwrap()
    });
    let [strong, undamped] = std::array::from_fn(|_| rows.next().unwrap());
    assert!(rows.next().is_none());
    for row in [&strong, &undamped] {
        // Stiff: its end goes by less than a tenth of its length, and rises by less than a hundredth.
        assert!(row.flag("passed") && row.count("missed") == 0, "{row:?}");
        assert!(row.number("deflection") > 0.0, "{row:?}");
        assert!(row.number("elastic_ratio") < 0.01, "{row:?}");
        // From a thousandth of all energy, where growth begins to count, to the hundredth that it stays below is 1.33 over four sub-steps.
        assert!(!row.has("growth") || row.number("growth") < 1.5, "{row:?}");
    }
}

#[test]
fn every_case_is_a_scene_of_its_own_name() {
    let cases = cases(STEPS, 1.0).unwrap();
    assert!(cases.len() >= 68, "{}", cases.len());
    let mut names: Vec<String> = cases.iter().map(|case| case.name.clone()).collect();
    let n = names.len();
    names.sort();
    names.dedup();
    assert_eq!(names.len(), n);
    for case in &cases {
        let name = &case.name;
        let scene = case.scene().unwrap_or_else(|error| panic!("{name}: {error}"));
        assert!(!scene.solids.is_empty() && scene.liquid.is_some(), "{name}");
    }
    // One unknown part is one too many, and nothing has run or is written by then.
    let folder = tempfile::tempdir().unwrap();
    let unknown = options(&["gap", "density_1e-4"]);
    let settings = settings(folder.path(), 1);
    let error = measure(&unknown, &settings, &mut |_| panic!("ran")).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    let told = error.to_string();
    let near = told.contains("`density_1e-4`") && told.contains("density_1e-3");
    assert!(near, "{told}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

const DT: f64 = 1.0 / 24.0;

fn case(name: &str) -> Case {
    let mut cases = cases(2000, 1.0).unwrap().into_iter();
    cases.find(|case| case.name == name).unwrap()
}

/// A case at its start.
struct Start {
    scene: Scene,
    simulation: Simulation,
    state: State,
    budget: Budget,
}

impl Start {
    fn new(case: &Case) -> Start {
        let scene = case.scene().unwrap();
        let simulation = Simulation::new(&scene, &Backend::Cpu).unwrap();
        let state = simulation.state().unwrap();
        let (liquid, solid) = diagnoses(&scene, &simulation, &state);
        let budget = Budget::new(&scene, simulation.solids(), &liquid, &solid);
        Start { scene, simulation, state, budget }
    }

    fn liquid(&self) -> Diagnosis {
        diagnoses(&self.scene, &self.simulation, &self.state).0
    }
}

fn diagnoses(scene: &Scene, simulation: &Simulation, state: &State) -> (Diagnosis, SolidDiagnosis) {
    let liquid = diagnose_liquid(scene, simulation.cut_cells(), state, 0.0).unwrap();
    (liquid, solid_diagnosis(simulation.solids(), state, scene.domain.gravity))
}

/// The row of a case after its start, changed.
fn checked(case: &Case, change: impl Fn(&mut State)) -> (Row, State) {
    let Start { scene, simulation, mut state, budget } = Start::new(case);
    change(&mut state);
    let (liquid, solid) = diagnoses(&scene, &simulation, &state);
    let mut row = case.row(&Backend::Cpu);
    check(&mut row, &budget.moment(&liquid, &solid), &budget, DT);
    (row, state)
}

/// The row of a case whose nodes have moved by `way` m, and so many of which move at `speed` m/s, upwards.
fn moved(name: &str, nodes: usize, way: f64, speed: f64) -> Row {
    let change = |state: &mut State| {
        state.displacement.iter_mut().for_each(|u| u[1] += way);
        let moving = state.node_velocity.iter_mut().take(nodes);
        moving.for_each(|v| v[1] += speed);
    };
    checked(&case(name), change).0
}

/// A number over its bound.
fn share(row: &Row, name: &str) -> f64 {
    let bound = format!("{}_bound", name.trim_end_matches("_ratio"));
    row.number(name) / row.number(&bound)
}

/// A block of 16 g: at 100 m/s it has 78 J, a tenth of what the pool has by lying there.
#[test]
fn a_light_solid_that_is_thrown_is_told_from_the_pool_at_rest() {
    let row = moved("density_1e-3", usize::MAX, 0.0, 100.0);
    assert!(!completed(&row) && share(&row, "energy_ratio") < 1.0, "{row:?}");
    assert!((70.0..90.0).contains(&row.number("motion")), "{row:?}");
    assert!(share(&row, "motion") > 1.5, "{row:?}");
    assert!(share(&row, "solid_speed") > 5.0, "{row:?}");
    // A node alone has next to no energy.
    let row = moved("density_1e-3", 1, 0.0, 100.0);
    assert!(row.text("status").contains("speed of a node"), "{row:?}");
    assert!(share(&row, "energy_ratio") < 1.0 && share(&row, "motion") < 1.0);
}

/// From where it is to the floor, 0.295 m.
#[test]
fn a_solid_that_falls_is_within_its_bounds_and_one_that_is_twice_as_fast_is_not() {
    let fall = (2.0 * 9.81 * 0.295_f64).sqrt();
    for name in ["density_1e-3", "density_1", "density_10"] {
        let row = moved(name, usize::MAX, -0.295, -fall);
        assert!(completed(&row), "{row:?}");
        assert!((row.number("energy_ratio") - 1.0).abs() < 1e-9, "{row:?}");
        assert!((row.number("solid_speed") - fall).abs() < 1e-12, "{row:?}");
    }
    // Of 16 kg, which the energy of the pool hides.
    let row = moved("density_1", usize::MAX, -0.295, -2.0 * fall);
    assert!(row.text("status").contains("energy of motion"), "{row:?}");
    assert!(share(&row, "energy_ratio") < 1.0, "{row:?}");
    // From the top of the domain to its floor without anything in the way.
    let row = moved("empty_never", usize::MAX, 0.0, -(2.0 * 9.81_f64).sqrt());
    assert!(share(&row, "solid_speed") < 0.5, "{row:?}");
}

#[test]
fn every_start_is_within_its_bounds() {
    for case in cases(1, 0.4).unwrap() {
        let (row, state) = checked(&case, |_| {});
        assert!(completed(&row) && row.number("motion_bound") > 0.0, "{row:?}");
        for name in ["energy", "motion", "solid_speed", "liquid_speed"] {
            assert!(row.number(&format!("{name}_bound")).is_finite(), "{row:?}");
        }
        let dry = state.liquid_distance.iter().all(|&phi| phi >= 0.0);
        assert_eq!(dry, case.name == "empty_never", "{row:?}");
    }
}

/// A full tank around a block of 1/64 m^3, which has markers nowhere: no surface.
#[test]
fn liquid_below_the_band_has_its_share_of_the_energy() {
    let (row, state) = checked(&case("closed_light"), |state| state.velocity[1].fill(-2.0));
    assert!(state.markers.is_empty(), "{}", state.markers.len());
    // Distances to the block give its edges to a fifth of its volume.
    let volume = row.number("motion") / (0.5 * 1000.0 * 4.0);
    assert!((volume - 63.0 / 64.0).abs() < 0.2 / 64.0, "{volume}: {row:?}");
    assert!(row.text("status").contains("energy above its bound"), "{row:?}");
    assert_eq!(row.number("liquid_speed"), 2.0, "{row:?}");
}

/// A pool 3.2 cells deep, each layer at the height of its centre, and a block of 500 / 64 kg with its centre at 0.7 m.
#[test]
fn a_pool_at_rest_has_the_energy_of_its_volume_and_a_marker_that_flies_that_of_its_own() {
    let case = case("empty_dry");
    let Start { budget, .. } = Start::new(&case);
    let layers = (0.5 + 1.5 + 2.5 + 0.2 * 3.5) / 16.0_f64.powi(2);
    let energy = 9.81 * (1000.0 * layers + 500.0 / 64.0 * 0.7);
    assert!((budget.energy / energy - 1.0).abs() < 1e-6, "{} where {energy}", budget.energy);
    let fly = |state: &mut State| {
        state.markers.push([0.1, 0.9, 0.1]);
        state.marker_velocity.push([0.0, -3.0, 0.0]);
        state.spray.push(true);
    };
    let (row, _) = checked(&case, fly);
    // An eighth of a cell. The mass stays that of the start.
    let volume = 0.125 / 16.0_f64.powi(3);
    let kinetic = 0.5 * 1000.0 * volume * 9.0 * 0.2 / (0.2 + volume);
    assert!((row.number("motion") / kinetic - 1.0).abs() < 1e-6, "{row:?} where {kinetic}");
}

#[test]
fn liquid_that_is_missing_for_25_sub_steps_is_lost_and_liquid_that_left_is_not() {
    let mut start = Start::new(&case("empty_dry"));
    // Half of the pool.
    start.state.liquid_distance.iter_mut().for_each(|phi| *phi += 0.1);
    let Start { budget, .. } = &start;
    let missing = |outflow| budget.missing(&start.liquid(), outflow);
    assert!((missing(0.0) - 0.5).abs() < 1e-6, "{}", missing(0.0));
    assert!((missing(0.06) - 0.2).abs() < 1e-6, "{}", missing(0.06));
    let mut series = vec![0.01; 10];
    series.extend([0.3; 24]);
    assert_eq!(lost(&series), 0.01);
    series.push(0.2);
    assert_eq!(lost(&series), 0.2);
    // Nothing is missing where there is more than at the start.
    assert_eq!([lost(&[-0.1; 30]), lost(&[0.5; 24])], [0.0; 2]);
}

#[test]
fn growth_is_the_mean_of_four_sub_steps_and_does_not_count_from_nothing() {
    assert_eq!(growth(&[0.0, 1e-9, 1e-6, 9e-4]), None);
    assert_eq!(growth(&[2e-3; 9]), Some(1.0));
    // Speeds double in each.
    let doubling: Vec<f64> = (0..9).map(|at| 1e-2 * 4f64.powi(at)).collect();
    assert!((growth(&doubling).unwrap() - 2.0).abs() < 1e-12);
    // Growth that ends before four sub-steps is spread over four.
    let ended = growth(&[1e-3, 0.256]).unwrap();
    assert!((ended - 2.0).abs() < 1e-12, "{ended}");
    assert!(growth(&[1.0, 0.1, 0.01]).unwrap() < 1.0);
}

#[test]
fn sub_steps_that_miss_are_named_and_more_than_a_hundredth_fail() {
    let mut row = case("young_1e9").row(&Backend::Cpu);
    count(&mut row, false, false);
    name_misses(&mut row);
    assert_eq!(row.text("status"), "completed");
    count(&mut row, true, true);
    (0..19).for_each(|_| count(&mut row, true, false));
    name_misses(&mut row);
    let named = "completed, 20 sub-steps missed a tolerance, 1 sub-step with contacts that did not settle";
    assert_eq!(row.text("status"), named);
    assert!(Expected::Completes.holds(&row));
    count(&mut row, true, false);
    name_misses(&mut row);
    let fails = |row: &Row, cause| !completed(row) && row.text("status").contains(cause);
    assert!(fails(&row, "missed"), "{row:?}");
    assert!(!Expected::Completes.holds(&row));
    let mut row = case("young_1e9").row(&Backend::Cpu);
    (0..21).for_each(|_| count(&mut row, false, true));
    assert!(fails(&row, "settle"), "{row:?}");
}

#[test]
fn the_wrong_buoyancy_pushes_upwards_and_an_instability_grows() {
    let row = case("thesis_damping_only").row(&Backend::Cpu);
    let holds = |row: &Row, way: f64, lift: f64| {
        let row = row.clone().with(row! { deflection: way, lift: lift });
        [Expected::PushedAway, Expected::StaysStiff].map(|expected| expected.holds(&row))
    };
    assert_eq!(holds(&row, 0.28, 0.05), [true, false]);
    // Aside, or down, is not where buoyancy pushes.
    assert_eq!(holds(&row, 0.28, 0.0), [false, false]);
    assert_eq!(holds(&row, 0.06, 0.003), [false, true]);
    assert_eq!(holds(&row, 0.06, 0.03), [false, false]);
    let failed = row.with(row! { status: "step 3: energy above its bound" });
    assert_eq!(holds(&failed, 0.28, 0.05), [false, false]);
    for (growth, elastic, fails) in [(2.0, 8.0, true), (1.1, 8.0, false), (2.0, 0.2, false)] {
        let grown = row! { growth: growth, elastic_ratio: elastic };
        assert_eq!(Expected::Fails.holds(&failed.clone().with(grown)), fails);
    }
}

#[test]
fn parts_of_names_that_no_case_has_are_told_with_those_near() {
    let [names, _] = names();
    let check = |parts: &[&str]| options(parts).check(&names);
    assert!(check(&[]).is_ok() && check(&["gap", "thesis_strong"]).is_ok());
    let error = check(&["gap", "young_1e8"]).unwrap_err().to_string();
    for near in ["`young_1e8`", "young_1e7", "young_1e9", "density"] {
        assert!(error.contains(near), "{error}");
    }
    assert!(check(&["gap", ""]).is_err());
}
