//! `bench solids` and `bench step` on small bodies: complete tables, answers that agree.

use std::fs;

use cutwater::gpu::AdapterChoice;
use cutwater::measure::bench::solids::{self, Body};
use cutwater::measure::bench::step::{self, Case};
use cutwater::measure::bench::table::Row;
use cutwater::scene::{Scene, Solver};

use crate::bench::settings;
use crate::common::gpu;

fn assert_ordered([min, median, max]: [f64; 3], share: f64) {
    let ordered = 0.0 < min && min <= median && median <= max;
    assert!(
        ordered && share > 0.0,
        "{min}, {median}, {max} s, share {share}"
    );
}

#[test]
fn a_row_per_body_with_the_factorisation_that_fits() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let options = solids::Options {
        bodies: vec![Body::Beam, Body::Block],
        nodes: vec![64],
        young: 1e5,
        density: 1000.0,
        step: 1e-3,
        // Between the factors of the two bodies.
        largest_factor: 30e3,
        solver: Solver::default(),
        adapter: AdapterChoice::Best,
    };
    let csv = folder.path().join("solids.csv");
    let lines = || fs::read_to_string(&csv).map_or(0, |text| text.lines().count());
    let mut written = Vec::new();
    let table = solids::measure(&options, &settings(folder.path(), 2), &mut |_| {
        written.push(lines())
    })
    .unwrap();
    // The first row is there before the second.
    assert_eq!((written, lines()), (vec![0, 2], 3));
    let [beam, block] = table.rows("solids") else {
        panic!("{:?}", table.rows("solids"))
    };
    // 1 x 8 x 1 cubes and 3 x 3 x 3, six elements each; the nodes at the upper end do not move.
    let sizes = |row: &Row| {
        (
            row.text("body").to_owned(),
            row.count("nodes"),
            row.count("elements"),
            row.count("unknowns"),
        )
    };
    assert_eq!(sizes(beam), ("beam".to_owned(), 36, 6 * 8, 3 * 32));
    assert_eq!(sizes(block), ("block".to_owned(), 64, 6 * 27, 3 * 48));
    for row in table.rows("solids") {
        let seconds = [
            row.number("seconds_min"),
            row.number("seconds_median"),
            row.number("seconds_max"),
        ];
        assert_ordered(seconds, row.number("share_of_copy_bandwidth"));
        assert_eq!(row.text("status"), "converged");
        assert!(
            row.number("residual") > 0.0 && row.number("residual") <= 1e-8,
            "{row:?}"
        );
        assert_eq!(
            row.count("products"),
            row.count("iterations") * (row.count("degree") + 1)
        );
        // Three blocks and more in a row, 36 bytes and more each, in every product.
        assert!(row.number("bytes") > 108.0 * row.number("products") * row.number("nodes"));
        assert!(
            row.number("factor_bytes") > 8.0 * row.number("unknowns")
                && row.number("ordering_seconds") > 0.0
        );
    }
    // The device has masses and rest positions in f32, which the stiffness and the tolerance multiply.
    let (factorised, left_out) = (beam, block);
    let difference = factorised.number("difference");
    assert!(difference <= 1e-6, "{factorised:?}");
    let direct = factorised.number("factor_seconds") + factorised.number("substitution_seconds");
    // The ratio is of the same round.
    let bounds = ["seconds_max", "seconds_min"].map(|end| 0.5 * direct / factorised.number(end));
    let ratio = factorised.number("ratio");
    assert!(
        bounds[0] < ratio && ratio < 8.0 * bounds[1],
        "{factorised:?}"
    );
    let left = ["factor_seconds", "ratio", "difference"].map(|name| left_out.has(name));
    assert_eq!(left, [false; 3], "{left_out:?}");

    let csv = fs::read_to_string(csv).unwrap();
    assert!(csv.starts_with("body,nodes,elements,"), "{csv}");
    let json = fs::read_to_string(folder.path().join("solids.json")).unwrap();
    let json = crate::common::json(json);
    assert_eq!(json["adapter"], gpu.report().name);
    assert_eq!(json["rows"][1]["nodes"], 64);
    let svg = fs::read_to_string(folder.path().join("solids.svg")).unwrap();
    // What was left out has no line, and no name in the key.
    for (name, drawn) in [
        ("beam, this solve", true),
        ("block, this solve", true),
        ("beam, sparse Cholesky", true),
        ("block, sparse Cholesky", false),
    ] {
        assert_eq!(svg.contains(name), drawn, "{name}");
    }
}

const SCENE: &str = r#"
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
fn sub_steps_of_solids_have_bytes_for_every_stage() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("swing.toml");
    fs::write(&file, SCENE).unwrap();
    let options = step::Options {
        scenes: vec![Case::new(Scene::load(&file, &[], 1.0).unwrap(), 1.0).unwrap()],
        frames: 3,
        adapter: AdapterChoice::Best,
    };
    let table = step::measure(&options, &settings(folder.path(), 1), &mut |_| ()).unwrap();
    let [row] = table.rows("step") else {
        panic!("{:?}", table.rows("step"))
    };
    let seconds = [
        row.number("seconds_min"),
        row.number("seconds_median"),
        row.number("seconds_max"),
    ];
    assert_ordered(seconds, row.number("share_of_copy_bandwidth"));
    assert_eq!((row.count("nodes"), row.count("elements")), (81, 6 * 32));
    assert_eq!(row.number("solid_unknowns"), 3.0 * 72.0);
    assert!(row.number("solid_iterations") >= 1.0, "{row:?}");
    let of_liquid = [
        row.number("unknowns"),
        row.number("iterations"),
        row.number("band_cells"),
    ];
    assert_eq!((row.count("markers"), of_liquid), (0, [0.0; 3]));
    if !gpu.report().timestamps {
        return;
    }
    let stages: Vec<&str> = table
        .rows("step_stages")
        .iter()
        .map(|stage| stage.text("stage"))
        .collect();
    let expected = [
        "move_solid",
        "forces",
        "solid_matrices",
        "right_hand_side",
        "solve",
        "diagnose",
    ];
    assert_eq!(stages, expected);
    for stage in table.rows("step_stages") {
        assert!(
            stage.number("bytes") > 0.0,
            "no model of {}",
            stage.text("stage")
        );
    }
    // Those of all stages, and of none that does not run.
    let sum: f64 = table
        .rows("step_stages")
        .iter()
        .map(|stage| stage.number("bytes"))
        .sum();
    assert!(
        (row.number("bytes") - sum).abs() <= 0.2 * sum,
        "{} of {sum}",
        row.number("bytes")
    );
}
