//! `bench stability` on a fixed subset of its cases: rows say what happened, and failures are named.

use std::fs;

use cutwater::gpu::AdapterChoice;
use cutwater::measure::bench_stability::{Options, Told, bench_stability, cases, limits};
use cutwater::sim::Backend;

use crate::common::gpu;

const STEPS: u64 = 8;

fn options(names: &[&str]) -> Options {
    Options {
        steps: STEPS,
        cases: names.iter().map(|&name| name.to_owned()).collect(),
        scale: 1.0,
        backend: Backend::Gpu(AdapterChoice::Best),
    }
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
        "droplet_one",
        "closed_stiff",
        "wall_obstacle",
        "empty_nothing",
    ];
    let mut told = 0;
    let mut table =
        bench_stability(&options(&names), folder.path(), &mut |_: Told| told += 1).unwrap();
    assert_eq!((told, table.rows.len()), (names.len(), names.len()));
    for row in &table.rows {
        assert_eq!(
            (row.status.as_str(), row.passed),
            ("completed", true),
            "{row:?}"
        );
        assert_eq!(
            (row.sub_steps, row.non_finite, row.cells),
            (STEPS, 0, 4096),
            "{row:?}"
        );
        assert!(
            row.energy_ratio >= 1.0 && row.energy_ratio <= row.energy_bound,
            "{row:?}"
        );
        // What a fall through the whole box gains in a sub-step of any of these is a fraction of what it has.
        assert!(row.energy_bound > 1.1 && row.energy_bound < 2.0, "{row:?}");
        assert!(row.nodes > 60 && row.seconds > 0.0, "{row:?}");
    }
    let det = |name: &str| {
        let mut rows = table.rows.iter();
        rows.find(|row| row.name == name).unwrap().min_det
    };
    assert!(det("start_inverted") < 0.0);
    assert!(det("droplet_one") > 0.5);
    table.verdict().unwrap();
    table.rows[1].passed = false;
    let error = table.verdict().unwrap_err();
    assert_eq!(error.exit_code(), 1);
    assert!(error.to_string().contains(&table.rows[1].name), "{error}");
    for file in [
        "stability.csv",
        "stability_limit.csv",
        "stability.json",
        "stability.svg",
    ] {
        let text = fs::read_to_string(folder.path().join(file)).unwrap();
        assert!(!text.contains("NaN"), "{file}");
        if file != "stability_limit.csv" {
            assert!(names.iter().all(|name| text.contains(name)), "{file}");
        }
    }
}

/// The same on the f64 path, whose tables name no adapter.
#[test]
fn hostile_cases_keep_their_energy_on_the_cpu() {
    let folder = tempfile::tempdir().unwrap();
    let names = ["start_spun", "closed_stiff", "wall_obstacle"];
    let options = Options {
        backend: Backend::Cpu,
        ..options(&names)
    };
    let table = bench_stability(&options, folder.path(), &mut |_: Told| {}).unwrap();
    table.verdict().unwrap();
    assert!(table.backend == "cpu" && table.machine.is_none());
    assert_eq!(table.rows.len(), names.len());
    let picture = fs::read_to_string(folder.path().join("stability.svg")).unwrap();
    assert!(picture.contains("the f64 path"));
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
    let [a, b, c, d] = growth[..] else {
        panic!("{growth:?}")
    };
    for (got, expected) in [(a, 0.8), (b, 2.0), (c, 0.8), (d, 2.0)] {
        assert!((got / expected - 1.0).abs() <= 5e-3, "{growth:?}");
    }
    assert!(table.limits[0].dt > 3.0 * table.limits[2].dt);
}

#[test]
fn every_case_is_a_scene_of_its_own_name() {
    let cases = cases(STEPS, 1.0);
    assert!(cases.len() >= 44, "{}", cases.len());
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
    let folder = tempfile::tempdir().unwrap();
    let error = bench_stability(&options(&["no such"]), folder.path(), &mut |_| {}).unwrap_err();
    assert_eq!(error.exit_code(), 2);
}
