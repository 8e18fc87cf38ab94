//! `bench step` on small scenes: complete tables, the same liquid in both domains, bytes of a solve for liquid and solids.

use std::fs;
use std::path::Path;

use cutwater::Error;
use cutwater::gpu::AdapterChoice;
use cutwater::measure::bench_step::{Options, bench_step};
use cutwater::scene::{Precision, Scene, Solver};
use serde_json::Value;

use crate::common::gpu;

#[test]
fn tables_are_complete_and_both_domains_hold_the_same_liquid() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/drop_into_pool.toml");
    let options = Options {
        scenes: vec![Scene::load(&file, &[], 1.0 / 3.0).unwrap()],
        frames: 3,
        repeats: 2,
        larger_domain: Some([1, 8, 1]),
        adapter: AdapterChoice::Best,
    };
    let mut told = 0;
    let table = bench_step(&options, folder.path(), &mut |_| told += 1).unwrap();
    let [own, larger] = &table.rows[..] else {
        panic!("{:?}", table.rows)
    };
    assert_eq!((told, larger.cells), (2, 8 * own.cells));
    for row in &table.rows {
        let ordered =
            row.seconds_min <= row.seconds_median && row.seconds_median <= row.seconds_max;
        assert!(
            ordered && row.seconds_min > 0.0 && row.sub_steps >= 4,
            "{row:?}"
        );
        // An iteration with a V-cycle moves 120 bytes a cell where each quad is uniform, 235 where none is.
        let per_iteration = row.bytes / (row.unknowns * row.iterations);
        assert!((120.0..1000.0).contains(&per_iteration), "{row:?}");
        assert!(row.share_of_copy_bandwidth > 0.0, "{row:?}");
    }
    // The jitter depends on the cell's number, so the markers are others, but about as many.
    let alike = |a: f64, b: f64, bound: f64| (a / b - 1.0).abs() <= bound;
    assert!(
        alike(own.markers as f64, larger.markers as f64, 0.02),
        "{own:?} {larger:?}"
    );
    assert!(
        alike(own.unknowns, larger.unknowns, 0.02),
        "{own:?} {larger:?}"
    );
    let [pair] = &table.pairs[..] else {
        panic!("{:?}", table.pairs)
    };
    assert_eq!(pair.ratio, larger.seconds_median / own.seconds_median);
    if gpu.report().timestamps {
        for row in &table.rows {
            let stages: Vec<_> = table
                .stages
                .iter()
                .filter(|stage| stage.scene == row.scene)
                .collect();
            assert_eq!(stages.len(), 12, "{}: {stages:?}", row.scene);
            for stage in stages {
                assert!(stage.bytes > 0.0, "no model of {}", stage.stage);
                assert_eq!(stage.place, "device", "{}", stage.stage);
                // A clock of the device may be too coarse for a short stage.
                let share = stage.share_of_copy_bandwidth;
                assert_eq!(share.is_some(), stage.seconds_median > 0.0, "{stage:?}");
            }
        }
    }
    for name in ["step.csv", "step_stages.csv", "step.json", "step.svg"] {
        let text = fs::read_to_string(folder.path().join(name)).unwrap();
        assert!(text.contains("drop_into_pool x 1,8,1"), "{name}");
    }
}

/// A stiff block below a level that is kept.
const BLOCK: &str = "
[domain]
size = [1.0, 1.0, 1.0]
cells = [8, 8, 8]
[time]
duration = 1.0
[liquid]
surface = \"fixed\"
[[liquid.region]]
box = { min = [0, 0, 0], max = [1, 0.81, 1] }
[[solid]]
name = \"block\"
mesh = { box = { size = [0.2, 0.4, 0.2], cells = [2, 4, 2] } }
placement = { translate = [0.5, 0.45, 0.5] }
density = 1000.0
young = 1e7
poisson = 0.4
[[solid.pin]]
region = { box = { min = [0, 0.64, 0], max = [1, 1, 1] } }
[solver]
formulation = \"condensed\"
";

#[test]
fn a_solve_for_both_counts_its_own_bytes_and_is_written_before_another_scene_fails() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("block.toml");
    fs::write(&file, BLOCK).unwrap();
    let out = folder.path().join("out");
    fs::create_dir(&out).unwrap();
    fs::write(out.join("step_growth.csv"), "of another run").unwrap();
    let scene = Scene::load(&file, &[], 1.0).unwrap();
    // The condensed form is not for f32.
    let refused = Scene {
        solver: Solver {
            precision: Precision::F32,
            ..scene.solver
        },
        ..scene.clone()
    };
    let options = Options {
        scenes: vec![scene, refused],
        frames: 3,
        repeats: 1,
        larger_domain: None,
        adapter: AdapterChoice::Best,
    };
    let mut told = Vec::new();
    let error = bench_step(&options, &out, &mut |row| told.push(row.clone())).unwrap_err();
    assert!(matches!(error, Error::Limit { .. }), "{error}");
    let [row] = &told[..] else { panic!("{told:?}") };
    assert_eq!((row.nodes, row.elements), (45, 6 * 16));
    // An iteration has a V-cycle and an inverse among the wet nodes in f32. A polynomial of degree 64, as a solve for solids by themselves has
    // here, would move 1 MB and more.
    let wet = (3.0 * row.nodes as f64).powi(2);
    let an_iteration = 300.0 * row.unknowns + 4.0 * wet;
    assert!(an_iteration < 0.25e6, "{row:?}");
    let bytes = row.bytes;
    assert!(bytes < (row.iterations + 10.0) * an_iteration, "{row:?}");
    assert!(bytes > row.iterations * 120.0 * row.unknowns, "{row:?}");

    let text = fs::read_to_string(out.join("step.json")).unwrap();
    let json: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(json["rows"][0]["bytes"], bytes);
    assert!(!out.join("step_growth.csv").exists());
    let stages = json["stages"].as_array().unwrap();
    let clip = stages.iter().find(|stage| stage["stage"] == "clip");
    let clip = clip.unwrap();
    let place = match gpu.report().timestamps {
        true => "host and device",
        false => "host",
    };
    assert_eq!(clip["where"], place);
    assert_eq!(clip["share_of_copy_bandwidth"], Value::Null);
    // All parts of the bar have their name.
    let svg = fs::read_to_string(out.join("step.svg")).unwrap();
    for stage in stages {
        let name = stage["stage"].as_str().unwrap();
        assert!(svg.contains(&format!("\n{name}\n")), "{name}");
    }
}
