//! `bench step` on small scenes: complete tables, the same liquid in both domains.

use std::fs;
use std::path::Path;

use cutwater::gpu::AdapterChoice;
use cutwater::measure::bench_step::{Options, bench_step};
use cutwater::scene::Scene;

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
            }
        }
    }
    for name in ["step.csv", "step_stages.csv", "step.json", "step.svg"] {
        let text = fs::read_to_string(folder.path().join(name)).unwrap();
        assert!(text.contains("drop_into_pool x 1,8,1"), "{name}");
    }
}
