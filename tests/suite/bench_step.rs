//! `bench step` on small scenes: complete tables, the same liquid in both domains, bytes of a solve for liquid and solids.

use std::fs;
use std::path::Path;

use cutwater::Error;
use cutwater::gpu::AdapterChoice;
use cutwater::measure::bench_step::{Case, Options, bench_step, largest_scale};
use cutwater::scene::{Precision, Scene, Solver};
use cutwater::sim::Plan;
use serde_json::Value;

use crate::common::gpu;

fn at_scale(file: &Path, scale: f64) -> Case {
    Case::new(Scene::load(file, &[], scale).unwrap(), 1.0).unwrap()
}

#[test]
fn tables_are_complete_and_both_domains_hold_the_same_liquid() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/drop_into_pool.toml");
    let options = Options {
        scenes: vec![at_scale(&file, 1.0 / 3.0)],
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
            ordered && row.seconds_min > 0.0 && row.sub_steps >= 2,
            "{row:?}"
        );
        assert_eq!((row.runs, row.kind), (2, "apart"));
        // The mean of a run lies between its sub-steps. Of two runs medians are means, which keep that.
        let mean = row.seconds_median;
        let bounds = [row.sub_step_seconds_min, row.sub_step_seconds_max];
        let slack = 1e-9 * mean;
        assert!(
            bounds[0] <= mean + slack && mean <= bounds[1] + slack,
            "{row:?}"
        );
        // Three frames of 1/24 s but for the first sub-step.
        assert!(row.simulated > 0.0 && row.simulated < 3.0 / 24.0, "{row:?}");
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
    let scene = at_scale(&file, 1.0);
    // The condensed form is not for f32.
    let mut refused = scene.clone();
    refused.scene.solver = Solver {
        precision: Precision::F32,
        ..scene.scene.solver
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
    assert_eq!(row.kind, "touching");
    // An iteration has a V-cycle and an inverse among the wet nodes in f32. A polynomial of degree 64, as a solve for solids by themselves has
    // here, would move 1 MB and more.
    let wet = (3.0 * row.nodes as f64).powi(2);
    let an_iteration = 300.0 * row.unknowns + 4.0 * wet;
    assert!(an_iteration < 0.25e6, "{row:?}");
    let bytes = row.bytes;
    assert!(bytes < (row.iterations + 10.0) * an_iteration, "{row:?}");
    assert!(bytes > row.iterations * 120.0 * row.unknowns, "{row:?}");

    let text = fs::read_to_string(out.join("step.json")).unwrap();
    let json = crate::common::json(text);
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

#[test]
fn solids_are_refined_beside_the_grid_and_kinds_of_sub_steps_are_told_apart() {
    if gpu().is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("block.toml");
    fs::write(&file, BLOCK).unwrap();
    let case = |scale, solids_scale| {
        let scene = Scene::load(&file, &[], scale).unwrap();
        Case::new(scene, solids_scale).unwrap()
    };
    let sizes = [[1.0, 0.5], [1.0, 1.0], [2.0, 0.5], [2.0, 1.0]];
    let scenes = sizes.map(|[scale, solids_scale]| case(scale, solids_scale));
    let options = Options {
        scenes: scenes.to_vec(),
        frames: 3,
        repeats: 1,
        larger_domain: None,
        adapter: AdapterChoice::Best,
    };
    let table = bench_step(&options, folder.path(), &mut |_| ()).unwrap();
    // 1 x 2 x 1 bricks and 2 x 4 x 2.
    let sizes: Vec<_> = table
        .rows
        .iter()
        .map(|row| (row.cells, row.nodes, row.kind))
        .collect();
    let expected = [(512, 12), (512, 45), (4096, 12), (4096, 45)];
    let expected = expected.map(|(cells, nodes)| (cells, nodes, "touching"));
    assert_eq!(sizes, expected, "{:?}", table.rows);
    let along: Vec<_> = table
        .growth
        .iter()
        .map(|growth| (growth.along, growth.fixed, growth.rows))
        .collect();
    let expected = [
        ("cells", Some(12), 2),
        ("nodes", Some(512), 2),
        ("both", None, 2),
        ("cells", Some(45), 2),
        ("nodes", Some(4096), 2),
    ];
    assert_eq!(along, expected, "{:?}", table.growth);
    // A bar has the stages of its own sub-steps.
    for row in &table.rows {
        let stages = table.stages.iter().filter(|stage| {
            (stage.scale, stage.solids_scale) == (row.scale, row.solids_scale)
                && stage.kind == row.kind
        });
        let names: Vec<_> = stages.map(|stage| stage.stage).collect();
        assert_eq!(names.iter().filter(|name| **name == "solve").count(), 1);
    }

    let error = Case::new(case(1.0, 1.0).scene, 0.0).unwrap_err();
    assert!(error.to_string().contains("--solids-scale 0"), "{error}");
}

#[test]
fn the_largest_scale_is_one_that_there_is_room_for() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("block.toml");
    fs::write(&file, BLOCK).unwrap();
    // A small adapter, so that the search ends soon whatever the machine has.
    let mut adapter = gpu.report().clone();
    adapter.storage_binding = adapter.storage_binding.min(1 << 22);
    let load = |scale| Case::new(Scene::load(&file, &[], scale)?, 1.0);
    let scale = largest_scale(&load, &adapter).unwrap();
    // 8 cells along an edge are a unit each, and ten of them a step.
    let cells = load(scale).unwrap().scene.domain.cells;
    assert!(cells[0].is_multiple_of(10), "{cells:?}");
    let fits = |scale: f64| {
        let plan = Plan::new(&load(scale).unwrap().scene, Some(&adapter)).unwrap();
        plan.check(&adapter)
    };
    fits(scale).unwrap();
    fits(scale + 10.0 / 8.0).unwrap_err();
}
