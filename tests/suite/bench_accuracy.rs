//! `bench accuracy` on small scenes: errors follow the tolerance, and what is recommended is the cheapest that meets its target.

use std::fs;
use std::path::Path;

use cutwater::gpu::AdapterChoice;
use cutwater::measure::bench_accuracy::{Options, bench_accuracy};
use cutwater::scene::{Formulation, Precision, Preconditioner, Scene};

use crate::common::gpu;

fn options(name: &str, scale: f64, overrides: &[&str]) -> Options {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenes/{name}.toml"));
    let overrides: Vec<String> = overrides.iter().map(|&text| text.to_owned()).collect();
    Options {
        scenes: vec![Scene::load(&file, &overrides, scale).unwrap()],
        frames: vec![1],
        precisions: vec![Precision::F32, Precision::Mixed],
        preconditioners: vec![Preconditioner::Multigrid],
        formulations: vec![Formulation::Condensed, Formulation::TwoField],
        tolerances: vec![1e-3, 1e-6, 1e-9],
        max_iterations: 500,
        repeats: 2,
        adapter: AdapterChoice::Best,
    }
}

#[test]
fn errors_follow_the_tolerance() {
    if gpu().is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    for (name, scale, forms) in [
        ("compressibility", 0.12, &["two-field", "condensed"][..]),
        ("hydrostatic_block", 0.4, &["apart"]),
        ("hanging_beam", 1.0, &["apart"]),
    ] {
        let options = options(name, scale, &[]);
        let mut told = 0;
        let table = bench_accuracy(&options, folder.path(), &mut |_| told += 1).unwrap();
        // In f32 there is no condensed form.
        assert_eq!(
            (told, table.rows.len()),
            (told, 3 * (1 + forms.len())),
            "{name}"
        );
        for row in &table.rows {
            assert!(forms.contains(&row.formulation), "{row:?}");
            assert_eq!(row.status, "converged", "{row:?}");
            let ordered =
                row.seconds_min <= row.seconds_median && row.seconds_median <= row.seconds_max;
            assert!(ordered && row.seconds_min > 0.0, "{row:?}");
            // What the device stores in f32 is off by a part in 1e7, which weak supports of the surface make more of.
            assert!(
                row.step_error_p <= 1e-2 && row.step_error_v <= 1e-2,
                "{row:?}"
            );
            if row.precision == "mixed" {
                // Errors are the tolerance times a condition number of some hundreds; the last keeps what f64 leaves.
                let bound = 300.0 * row.tolerance;
                assert!(row.error_p <= bound && row.error_v <= bound, "{row:?}");
            }
        }
        assert!(!table.best.is_empty(), "{name}");
        for best in &table.best {
            let meeting = table
                .rows
                .iter()
                .filter(|row| row.error_p.max(row.error_v) <= best.target);
            let least = meeting.fold(f64::INFINITY, |least, row| least.min(row.seconds_median));
            assert_eq!(best.seconds_median, least, "{best:?}");
            assert!(best.error_p.max(best.error_v) <= best.target, "{best:?}");
        }
    }
    for file in [
        "accuracy.csv",
        "accuracy_best.csv",
        "accuracy.json",
        "accuracy.svg",
    ] {
        let text = fs::read_to_string(folder.path().join(file)).unwrap();
        assert!(!text.is_empty() && !text.contains("NaN"), "{file}");
    }
}

#[test]
fn other_coupling_is_refused() {
    if gpu().is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let options = options("dam_break", 0.12, &["solver.coupling=weak"]);
    let error = bench_accuracy(&options, folder.path(), &mut |_| {}).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    assert!(
        error.to_string().contains("solver.coupling=strong"),
        "{error}"
    );
}
