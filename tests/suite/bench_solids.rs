//! `bench solids` and `bench step` on small bodies: complete tables, answers that agree.

use std::fs;

use cutwater::gpu::AdapterChoice;
use cutwater::measure::bench_solids::{self, Body, Row, bench_solids};
use cutwater::measure::bench_step::{self, Case, bench_step};
use cutwater::scene::{Scene, Solver};

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
    let options = bench_solids::Options {
        bodies: vec![Body::Beam, Body::Block],
        nodes: vec![64],
        young: 1e5,
        density: 1000.0,
        step: 1e-3,
        repeats: 2,
        // Between the factors of the two bodies.
        largest_factor: 30e3,
        solver: Solver::default(),
        adapter: AdapterChoice::Best,
    };
    let csv = folder.path().join("solids.csv");
    let lines = || fs::read_to_string(&csv).map_or(0, |text| text.lines().count());
    let mut written = Vec::new();
    let table = bench_solids(&options, folder.path(), &mut |_| written.push(lines())).unwrap();
    // The first row is there before the second.
    assert_eq!((written, lines()), (vec![0, 2], 3));
    let [beam, block] = &table.rows[..] else {
        panic!("{:?}", table.rows)
    };
    // 1 x 8 x 1 cubes and 3 x 3 x 3, six elements each; the nodes at the upper end do not move.
    let sizes = |row: &Row| (row.body, row.nodes, row.elements, row.unknowns);
    assert_eq!(sizes(beam), ("beam", 36, 6 * 8, 3 * 32));
    assert_eq!(sizes(block), ("block", 64, 6 * 27, 3 * 48));
    for row in &table.rows {
        let seconds = [row.seconds_min, row.seconds_median, row.seconds_max];
        assert_ordered(seconds, row.share_of_copy_bandwidth);
        assert_eq!(row.status, "converged");
        assert!(row.residual > 0.0 && row.residual <= 1e-8, "{row:?}");
        assert_eq!(row.products, row.iterations * (row.degree + 1));
        // Three blocks and more in a row, 36 bytes and more each, in every product.
        assert!(row.bytes > 108.0 * f64::from(row.products) * row.nodes as f64);
        assert!(row.factor_bytes > 8.0 * row.unknowns as f64 && row.ordering_seconds > 0.0);
    }
    // The device has masses and rest positions in f32, which the stiffness and the tolerance multiply.
    let (factorised, left_out) = (beam, block);
    let difference = factorised.difference.unwrap();
    assert!(difference <= 1e-6, "{factorised:?}");
    let direct = factorised.factor_seconds.unwrap() + factorised.substitution_seconds.unwrap();
    // Medians of several repeats, added before or after.
    let ratio = direct / factorised.seconds_median;
    let off = factorised.ratio.unwrap() / ratio - 1.0;
    assert!(off.abs() < 1e-12, "{factorised:?}");
    let left = [left_out.factor_seconds, left_out.ratio, left_out.difference];
    assert_eq!(left, [None; 3], "{left_out:?}");

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

const SCENE: &str = "
[domain]
size = [1.0, 1.0, 1.0]
cells = [8, 8, 8]
[time]
duration = 1.0
[[solid]]
name = \"beam\"
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
";

#[test]
fn sub_steps_of_solids_have_bytes_for_every_stage() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("swing.toml");
    fs::write(&file, SCENE).unwrap();
    let options = bench_step::Options {
        scenes: vec![Case::new(Scene::load(&file, &[], 1.0).unwrap(), 1.0).unwrap()],
        frames: 3,
        repeats: 1,
        larger_domain: None,
        adapter: AdapterChoice::Best,
    };
    let table = bench_step(&options, folder.path(), &mut |_| ()).unwrap();
    let [row] = &table.rows[..] else {
        panic!("{:?}", table.rows)
    };
    let seconds = [row.seconds_min, row.seconds_median, row.seconds_max];
    assert_ordered(seconds, row.share_of_copy_bandwidth);
    assert_eq!((row.nodes, row.elements), (81, 6 * 32));
    assert_eq!(row.solid_unknowns, 3.0 * 72.0);
    assert!(row.solid_iterations >= 1.0, "{row:?}");
    let of_liquid = [row.unknowns, row.iterations, row.band_cells];
    assert_eq!((row.markers, of_liquid), (0, [0.0; 3]));
    if !gpu.report().timestamps {
        return;
    }
    let stages: Vec<&str> = table.stages.iter().map(|stage| stage.stage).collect();
    let expected = [
        "move_solid",
        "forces",
        "solid_matrices",
        "right_hand_side",
        "solve",
        "diagnose",
    ];
    assert_eq!(stages, expected);
    for stage in &table.stages {
        assert!(stage.bytes > 0.0, "no model of {}", stage.stage);
    }
    // Those of all stages, and of none that does not run.
    let sum: f64 = table.stages.iter().map(|stage| stage.bytes).sum();
    assert!(
        (row.bytes - sum).abs() <= 0.2 * sum,
        "{} of {sum}",
        row.bytes
    );
}
