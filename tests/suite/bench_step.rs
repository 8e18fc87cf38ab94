//! `bench step` on small scenes: complete tables, kinds of sub-steps, growth, the largest scale.

use std::fs;
use std::path::Path;

use cutwater::Error;
use cutwater::measure::bench::Event;
use cutwater::measure::bench::statistics::Spread;
use cutwater::measure::bench::step::{Case, Options, derive, largest_scale, measure};
use cutwater::measure::bench::table::{Row, Table};
use cutwater::scene::{Precision, Scene, Solver};
use cutwater::sim::Plan;

use crate::bench::{assert_spread, counted, numbers, row, settings};
use crate::common::{adapter, assert_has, gpu};

fn at_scale(file: &Path, scale: f64) -> Case {
    Case::new(Scene::load(file, &[], scale).unwrap(), 1.0).unwrap()
}

#[test]
fn tables_are_complete() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/drop_into_pool.toml");
    let options = Options { scenes: vec![at_scale(&file, 1.0 / 3.0)], frames: 3, adapter: adapter() };
    let mut told = 0;
    let results = {
        let mut listener = counted(&mut told);
        measure(&options, &settings(folder.path(), 2), &mut listener).unwrap()
    };
    let [row] = results.rows("step") else { panic!("{:?}", results.rows("step")) };
    assert_spread(row, "seconds");
    assert!(row.count("sub_steps") >= 2, "{row:?}");
    assert_eq!((row.count("runs"), row.text("kind")), (2, "apart"));
    // The mean of a run lies between its sub-steps. Of two runs medians are means, which keep that.
    let ends = ["sub_step_seconds_min", "seconds_median", "sub_step_seconds_max"];
    let [least, mean, most] = numbers(row, ends);
    let slack = 1e-9 * mean;
    assert!(least <= mean + slack && mean <= most + slack, "{row:?}");
    // Three frames of 1/24 s but for the first sub-step.
    let simulated = row.number("simulated");
    assert!(simulated > 0.0 && simulated < 3.0 / 24.0, "{row:?}");
    let stages = results.rows("step_stages");
    // A row and its stages after each of two runs.
    assert_eq!(told, 2 * (1 + stages.len()));
    if gpu.report().timestamps {
        assert_eq!(stages.len(), 23, "{stages:?}");
        for stage in stages {
            assert_eq!(stage.text("where"), "device", "{stage:?}");
        }
    }
    for name in ["step.csv", "step_stages.csv", "step.json", "step.svg"] {
        let text = fs::read_to_string(folder.path().join(name)).unwrap();
        assert!(text.contains("drop_into_pool"), "{name}");
    }
    // With --resume all is there; with another request nothing is kept.
    let again = |frames, resume| {
        let mut told = 0;
        let options = Options { frames, ..options.clone() };
        let settings = cutwater::measure::bench::Settings { resume, ..settings(folder.path(), 2) };
        let results = measure(&options, &settings, &mut counted(&mut told));
        results.map(|results| (told, results))
    };
    let (told, kept) = again(3, true).unwrap();
    assert_eq!((told, kept.rows("step")), (0, results.rows("step")));
    let refused = again(2, true).unwrap_err().to_string();
    assert_has(&refused, &["request", "--resume"]);
    assert!(again(2, false).unwrap().0 > 0);
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
fn a_scene_is_written_before_another_one_fails() {
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
    refused.scene.solver = Solver { precision: Precision::F32, ..scene.scene.solver };
    let options = Options { scenes: vec![scene, refused], frames: 3, adapter: adapter() };
    let mut told = Vec::new();
    let error = measure(&options, &settings(&out, 1), &mut |event| {
        if let Event::Row(table, row) = event
            && table.name == "step"
        {
            told.push(row.clone());
        }
    })
    .unwrap_err();
    assert!(matches!(error, Error::Limit { .. }), "{error}");
    let [row] = &told[..] else { panic!("{told:?}") };
    assert_eq!((row.count("nodes"), row.count("elements")), (45, 6 * 16));
    assert_eq!(row.text("kind"), "touching");
    let text = fs::read_to_string(out.join("step.json")).unwrap();
    let json = crate::common::json(text);
    assert_eq!(json["rows"][0]["kind"], "touching");
    assert!(!out.join("step_growth.csv").exists());
    let stages = json["stages"].as_array().unwrap();
    let clip = stages.iter().find(|stage| stage["stage"] == "clip");
    let clip = clip.unwrap();
    let place = match gpu.report().timestamps {
        true => "host and device",
        false => "host",
    };
    assert_eq!(clip["where"], place);
    // All parts of the bar have their name.
    let svg = fs::read_to_string(out.join("step.svg")).unwrap();
    for stage in stages {
        let name = stage["stage"].as_str().unwrap();
        assert!(svg.contains(&format!("\n{name}\n")), "{name}");
    }
}

/// A beam that hangs from a script, beside an obstacle.
const SWING: &str = r#"
[domain]
size = [1.0, 1.0, 1.0]
cells = [8, 8, 8]
[time]
duration = 1.0
[[solid]]
name = "beam"
mesh = { box = { size = [0.1, 0.4, 0.1], cells = [2, 8, 2] } }
placement = { translate = [0.3, 0.6, 0.5] }
density = 1000.0
young = 1e5
poisson = 0.4
[[solid.script]]
region = { box = { min = [0, 0.79, 0], max = [1, 1, 1] } }
keyframes = [{ t = 0 }, { t = 1, translate = [0.2, 0, 0] }]
[[obstacle]]
box = { min = [0.7, 0, 0], max = [1, 0.2, 1] }
"#;

#[test]
fn sub_steps_of_solids_have_a_row_for_every_stage() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("swing.toml");
    fs::write(&file, SWING).unwrap();
    let options = Options { scenes: vec![at_scale(&file, 1.0)], frames: 3, adapter: adapter() };
    let table = measure(&options, &settings(folder.path(), 1), &mut |_| ()).unwrap();
    let [row] = table.rows("step") else { panic!("{:?}", table.rows("step")) };
    assert_spread(row, "seconds");
    assert_eq!((row.count("nodes"), row.count("elements")), (81, 6 * 32));
    assert_eq!(row.number("solid_unknowns"), 3.0 * 72.0);
    assert!(row.number("solid_iterations") >= 1.0, "{row:?}");
    let liquid = ["markers", "unknowns", "iterations", "band_cells"];
    assert_eq!(numbers(row, liquid), [0.0; 4]);
    if !gpu.report().timestamps {
        return;
    }
    let stages = table.rows("step_stages").iter();
    let stages: Vec<&str> = stages.map(|stage| stage.text("stage")).collect();
    let expected = "move_solid forces solid_matrices right_hand_side solve diagnose";
    assert_eq!(stages.join(" "), expected);
}

#[test]
fn solids_are_refined_beside_the_grid_and_kinds_of_sub_steps_are_told_apart() {
    let Some(_) = gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("block.toml");
    fs::write(&file, BLOCK).unwrap();
    let case = |scale, solids_scale| {
        let scene = Scene::load(&file, &[], scale).unwrap();
        Case::new(scene, solids_scale).unwrap()
    };
    let sizes = [[1.0, 0.5], [1.0, 1.0], [2.0, 0.5], [2.0, 1.0]];
    let scenes = sizes.map(|[scale, solids_scale]| case(scale, solids_scale));
    let options = Options { scenes: scenes.to_vec(), frames: 3, adapter: adapter() };
    let table = measure(&options, &settings(folder.path(), 1), &mut |_| ()).unwrap();
    // 1 x 2 x 1 bricks and 2 x 4 x 2.
    let rows = table.rows("step");
    let sizes: Vec<_> = rows.iter().map(|row| (row.count("cells"), row.count("nodes"), row.text("kind"))).collect();
    let expected = [(512, 12), (512, 45), (4096, 12), (4096, 45)];
    let expected = expected.map(|(cells, nodes)| (cells, nodes, "touching"));
    assert_eq!(sizes, expected, "{rows:?}");
    let along: Vec<_> = table.rows("step_growth").iter().map(of_growth).collect();
    let expected = [("cells", 12, 2), ("cells", 45, 2), ("nodes", 512, 2), ("nodes", 4096, 2), ("both", 0, 2)];
    assert_eq!(along, expected);
    // A bar has the stages of its own sub-steps.
    for row in rows {
        let stages = table.rows("step_stages").iter();
        let key = ["scale", "solids_scale", "kind"];
        let own = stages.filter(|stage| stage.only(&key) == row.only(&key));
        let solves = own.filter(|stage| stage.text("stage") == "solve");
        assert_eq!(solves.count(), 1);
    }

    let error = Case::new(case(1.0, 1.0).scene, 0.0).unwrap_err();
    assert!(error.to_string().contains("--solids-scale 0"), "{error}");
}

fn of_growth(row: &Row) -> (&str, usize, usize) {
    (row.text("along"), row.count("fixed"), row.count("rows"))
}

/// A row of a scene whose sub-steps take as many seconds as it has cells.
fn a_row(scale: f64, solids_scale: f64, cells: usize, nodes: usize, kind: &str) -> Row {
    let seconds = Spread::exact(cells as f64);
    row! {
        scene: "made_up", kind: kind, scale: scale, solids_scale: solids_scale, cells: cells, nodes: nodes, runs: 1_usize, seconds: seconds,
    }
}

fn growth_of(rows: &[Row]) -> Vec<Row> {
    let mut tables = ["step", "step_stages", "step_growth"].map(|name| Table::new(name, &[], &[]));
    tables[0].rows = rows.to_vec();
    derive(&mut tables);
    tables[2].rows.clone()
}

#[test]
fn rows_of_other_kinds_are_in_no_exponent() {
    let rows = [
        a_row(0.2, 1.0, 1000, 0, "touching"),
        a_row(0.4, 1.0, 8000, 0, "touching"),
        a_row(0.8, 1.0, 64000, 0, "apart"),
    ];
    let fitted = growth_of(&rows);
    let along: Vec<_> = fitted.iter().map(of_growth).collect();
    assert_eq!(along, [("cells", 0, 2)]);
    assert!((fitted[0].number("exponent") - 1.0).abs() < 1e-12);
    // One size is no growth, nor are meshes that no scale changes refined.
    let same = [a_row(0.2, 0.5, 1000, 50, "touching"), a_row(0.4, 1.0, 8000, 50, "touching")];
    let fitted = growth_of(&same);
    let along: Vec<_> = fitted.iter().map(of_growth).collect();
    assert_eq!(along, [("cells", 50, 2)]);
    assert!(growth_of(&rows[..1]).is_empty());
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
