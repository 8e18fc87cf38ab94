//! `bench stability` on a fixed subset of its cases: rows say what happened, and failures are named.

use std::fs;

use cutwater::gpu::AdapterChoice;
use cutwater::measure::bench_stability::{
    KNOWN_FAILURES, Options, Place, Row, Told, bench_stability, cases, limits,
};
use cutwater::sim::Backend;

use crate::common::{gpu, root};

/// Sub-steps on the GPU path.
const STEPS: u64 = 8;
/// On the f64 path: in these columns break and droplets land.
const STEPS_F64: u64 = 16;
/// Sub-steps of the thesis's scene, 0.6 s: the front is at the beam after 0.2.
const THESIS_STEPS: u64 = 60;
/// `young_1e3` fails in sub-step 13.
const YOUNG_STEPS: u64 = 20;

fn options(names: &[&str]) -> Options {
    Options {
        steps: STEPS,
        cases: names.iter().map(|&name| name.to_owned()).collect(),
        scale: 1.0,
        backend: Backend::Gpu(AdapterChoice::Best),
    }
}

/// What holds in every hostile case, after so many sub-steps. Of cases that fail later it would say nothing.
fn assert_sound(row: &Row, steps: u64) {
    assert!(!known(&row.name), "{row:?}");
    assert!(row.passed && row.completed(), "{row:?}");
    let plain = row.missed + row.unsettled == 0;
    assert_eq!(row.status == "completed", plain, "{row:?}");
    assert_eq!((row.sub_steps, row.non_finite), (steps, 0), "{row:?}");
    // In the end there is no more than at the start and what falling gains: the bound without its tenth. It is measured: no longer 1.
    let most = row.energy_bound - 0.1;
    let measured = row.energy_end > 0.0 && row.energy_end != 1.0;
    assert!(measured && row.energy_end <= most, "{row:?}");
    // What a fall through the whole box gains in a sub-step of any of these is a fraction of what it has; of 1/15 s it is the most.
    let fraction = if row.name.ends_with("_15") { 1.0 } else { 0.7 };
    assert!(most > 1.0 && most < 1.0 + fraction, "{row:?}");
    assert!(
        row.motion > 0.0 && row.motion <= row.motion_bound,
        "{row:?}"
    );
    assert!(
        row.solid_speed > 0.0 && row.solid_speed <= row.solid_speed_bound,
        "{row:?}"
    );
    assert!(row.liquid_speed <= row.liquid_speed_bound, "{row:?}");
    // A beam of two cells in an obstacle: the centres of its cells are half a cell deep in both.
    assert!(row.name != "wall_through" || row.overlap > 0.5, "{row:?}");
    assert_eq!(row.min_det < 0.0, row.name == "start_inverted", "{row:?}");
    assert!(row.nodes > 60 && row.seconds > 0.0, "{row:?}");
}

fn known(name: &str) -> bool {
    KNOWN_FAILURES.iter().any(|(known, _)| *known == name)
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
    assert!(hostile.iter().all(|row| &row[steps] == "2000"));
    let failed = rows.iter().filter(|row| &row[passed] == "false");
    let failed: Vec<&str> = failed.map(|row| &row[name]).collect();
    assert_eq!(failed, KNOWN_FAILURES.map(|(name, _)| name));
    for page in ["docs/bench.md", "docs/measured/stability.md"] {
        let text = read(page);
        for name in &failed {
            assert!(text.contains(&format!("`{name}`")), "{page}: no {name}");
        }
    }
    let names: Vec<String> = cases(STEPS, 1.0)
        .into_iter()
        .map(|case| case.name)
        .collect();
    assert!(
        KNOWN_FAILURES
            .iter()
            .all(|(known, _)| names.iter().any(|name| name == known))
    );
}

/// A known failure is reported as one, with its cause.
#[test]
fn a_known_failure_fails_the_bench() {
    let folder = tempfile::tempdir().unwrap();
    let options = Options {
        steps: YOUNG_STEPS,
        backend: Backend::Cpu,
        ..options(&["young_1e3", "young_1e5"])
    };
    let table = bench_stability(&options, folder.path(), &mut |_: Told| {}).unwrap();
    let [soft, stiffer] = &table.rows[..] else {
        panic!("{:?}", table.rows)
    };
    assert!(stiffer.passed && stiffer.completed(), "{stiffer:?}");
    let mended = "take young_1e3 from KNOWN_FAILURES and measure the table of docs/bench.md anew";
    assert!(!soft.passed && !soft.completed(), "{mended}: {soft:?}");
    assert!(soft.motion > soft.motion_bound, "{soft:?}");
    let error = table.verdict().unwrap_err();
    let text = error.to_string();
    assert_eq!(error.exit_code(), 1);
    for part in [
        "1 of 2 cases",
        "young_1e3: step ",
        "energy of motion",
        "(known: the pool's pressure",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert!(!text.contains("young_1e5"), "{text}");
}

#[test]
fn hostile_cases_keep_their_energy() {
    if gpu().is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let names = [
        "start_inverted",
        "start_spun",
        "gap_solids_0.2_light",
        "droplet_rain",
        "closed_light",
        "wall_obstacle",
        "empty_nothing",
    ];
    let mut told = 0;
    let mut table =
        bench_stability(&options(&names), folder.path(), &mut |_: Told| told += 1).unwrap();
    assert_eq!((told, table.rows.len()), (names.len(), names.len()));
    for row in &table.rows {
        assert_sound(row, STEPS);
        assert!(
            row.cells == 4096 && row.most_iterations.is_some() && row.backend == "gpu",
            "{row:?}"
        );
    }
    table.verdict().unwrap();
    table.rows[1].passed = false;
    let error = table.verdict().unwrap_err();
    assert_eq!(error.exit_code(), 1);
    assert!(error.to_string().contains(&table.rows[1].name), "{error}");
    for file in ["stability.csv", "stability.json", "stability.svg"] {
        let text = fs::read_to_string(folder.path().join(file)).unwrap();
        assert!(!text.contains("NaN"), "{file}");
        assert!(names.iter().all(|name| text.contains(name)), "{file}");
    }
    // No column was asked for.
    assert!(!folder.path().join("stability_limit.csv").exists());
}

/// One or two of each group on the f64 path, where every solve is direct, with the share of the markers that may be lost: none where
/// 2,000 sub-steps lose none (docs/measured/stability.md). The tables name no adapter.
#[test]
fn a_case_of_each_group_keeps_its_energy_on_the_cpu() {
    let folder = tempfile::tempdir().unwrap();
    let most_lost = [
        ("density_1e-3", 0.0),
        ("young_1e9", 0.0),
        ("poisson_0.45", 0.0),
        ("damping_both", 0.0),
        ("step_15_stiff_light", 0.005),
        ("gravity_10g_stiff_light", 0.005),
        ("start_inverted", 0.005),
        ("start_spun", 0.0),
        ("sliver_turned", 0.005),
        ("gap_floor_0.1", 0.0),
        ("wall_through", 0.0),
        ("droplet_rain", 0.0),
        ("closed_heavy", 0.005),
        ("inside_half", 0.0),
        ("empty_nothing", 0.0),
        ("empty_never", 0.0),
        ("corner_light_soft_15", 0.005),
        ("corner_heavy_stiff_15", 0.01),
        ("corner_light_stiff_1000", 0.0),
    ];
    let names = most_lost.map(|(name, _)| name);
    let options = Options {
        steps: STEPS_F64,
        backend: Backend::Cpu,
        ..options(&names)
    };
    let table = bench_stability(&options, folder.path(), &mut |_: Told| {}).unwrap();
    table.verdict().unwrap();
    let rows: Vec<&str> = table.rows.iter().map(|row| row.name.as_str()).collect();
    assert_eq!(rows, names);
    for (row, (_, most_lost)) in table.rows.iter().zip(most_lost) {
        assert_sound(row, STEPS_F64);
        let solved = (row.missed, row.unsettled, row.most_iterations);
        assert_eq!(solved, (0, 0, None), "{row:?}");
        assert!(row.lost <= most_lost, "{row:?}");
    }
    let Place::Cpu(host) = &table.place else {
        panic!("{:?}", table.place)
    };
    let read = |file: &str| fs::read_to_string(folder.path().join(file)).unwrap();
    let json = crate::common::json(read("stability.json"));
    assert_eq!(json["backend"], "cpu");
    assert_eq!(json["rows"][0]["backend"], "cpu");
    assert_eq!(json["measured"], host.measured.as_str());
    assert_eq!(json["cpu"].as_str(), host.cpu.as_deref());
    assert!(json.get("adapter").is_none() && json.get("place").is_none());
    assert!(read("stability.svg").contains("the f64 path"));
}

/// The thesis's section 6.3 on 14 cells an edge, as far as half a second tells. Weak coupling takes the finer grid of the bench to tear the beam.
#[test]
fn strong_coupling_keeps_the_thesis_beam_stiff() {
    let cases = cases(STEPS, 0.4).into_iter();
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
        assert!(row.passed && row.missed == 0, "{row:?}");
        assert!(row.deflection > Some(0.0), "{row:?}");
        assert!(row.elastic_ratio < 0.01, "{row:?}");
        // From a thousandth of all energy, where growth begins to count, to the hundredth that it stays below is 1.33 over four sub-steps.
        assert!(row.growth.is_none_or(|growth| growth < 1.5), "{row:?}");
    }
}

#[test]
fn weak_coupling_grows_by_the_ratio_of_added_mass_whatever_the_sub_step() {
    if gpu().is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let names = ["limit_0.8_w_dt_0_", "limit_2_w_dt_0_"];
    let table = bench_stability(&options(&names), folder.path(), &mut |_| {}).unwrap();
    table.verdict().unwrap();
    let growth: Vec<f64> = table.limits.iter().map(|row| row.got).collect();
    let [a, b, c, d, ..] = growth[..] else {
        panic!("{growth:?}")
    };
    for (got, expected) in [(a, 0.8), (b, 2.0), (c, 0.8), (d, 2.0)] {
        assert!((got / expected - 1.0).abs() <= 5e-3, "{growth:?}");
    }
    assert!(table.limits[0].dt > 3.0 * table.limits[2].dt);
    // And against each other.
    let of_both = table.limits[4..].iter().map(|row| (row.expected, row.got));
    assert_eq!(of_both.collect::<Vec<_>>(), [(a, c), (b, d)]);
}

/// 5 % below the limit m_a / m_s = 1 + (w dt)^2 / 4 what there is of motion decays, 5 % above it grows.
#[test]
fn weak_coupling_has_its_limit_within_5_percent() {
    let folder = tempfile::tempdir().unwrap();
    let options = Options {
        backend: Backend::Cpu,
        ..options(&["limit_0.95_", "limit_1.05_"])
    };
    let table = bench_stability(&options, folder.path(), &mut |_| {}).unwrap();
    table.verdict().unwrap();
    let sides: Vec<(f64, f64, bool)> = table
        .limits
        .iter()
        .map(|row| (row.omega_dt, row.over_limit, row.got > 1.0))
        .collect();
    let expected = [1.0, 3.2].map(|omega_dt| [(omega_dt, 0.95, false), (omega_dt, 1.05, true)]);
    assert_eq!(sides, expected.concat());
    for row in &table.limits {
        let limit = row.over_limit * (1.0 + 0.25 * row.omega_dt.powi(2));
        assert!((row.ratio / limit - 1.0).abs() < 1e-12, "{row:?}");
        assert!(row.off.abs() <= 5e-3, "{row:?}");
    }
}

#[test]
fn every_case_is_a_scene_of_its_own_name() {
    let cases = cases(STEPS, 1.0);
    assert!(cases.len() >= 68, "{}", cases.len());
    let mut names: Vec<String> = cases.iter().map(|case| case.name.clone()).collect();
    names.extend(limits().iter().map(|limit| limit.name()));
    let n = names.len();
    names.sort();
    names.dedup();
    assert_eq!(names.len(), n);
    for case in &cases {
        let scene = case
            .scene()
            .unwrap_or_else(|error| panic!("{}: {error}", case.name));
        assert!(
            !scene.solids.is_empty() && scene.liquid.is_some(),
            "{}",
            case.name
        );
    }
    // One unknown part is one too many, and nothing has run or is written by then.
    let folder = tempfile::tempdir().unwrap();
    let unknown = options(&["gap", "density_1e-4"]);
    let error = bench_stability(&unknown, folder.path(), &mut |_| panic!("ran")).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    let told = error.to_string();
    assert!(
        told.contains("`density_1e-4`") && told.contains("density_1e-3"),
        "{told}"
    );
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}
