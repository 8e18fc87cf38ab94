//! `bench effects` on small scenes: what an effect adds is its own, and what is not there adds nothing.

use std::fs;
use std::path::Path;

use cutwater::gpu::AdapterChoice;
use cutwater::measure::bench_effects::{Options, Row, bench_effects};
use cutwater::scene::Scene;

use crate::common::gpu;

#[test]
fn effects_add_what_is_theirs() {
    if gpu().is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let load = |name: &str, scale| {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenes/{name}.toml"));
        Scene::load(&file, &[], scale).unwrap()
    };
    let options = Options {
        scenes: vec![load("dam_break", 0.12), load("hydrostatic_block", 0.3)],
        frames: 2,
        adapter: AdapterChoice::Best,
    };
    let mut told = 0;
    let table = bench_effects(&options, folder.path(), &mut |_| told += 1).unwrap();
    assert_eq!(told, table.rows.len());
    let row = |scene: &str, effect: &str| -> &Row {
        let mut rows = table.rows.iter();
        rows.find(|row| row.scene == scene && row.effect == effect)
            .unwrap()
    };
    for (scene, effect, kernels, bytes) in [
        ("dam_break", "markers", &["advect_markers"][..], true),
        ("dam_break", "solids", &["cut_quads", "node_forces"], true),
        ("dam_break", "patch_correction", &["patch_pressure"], true),
        ("dam_break", "corotation", &[], false),
        ("hydrostatic_block", "obstacles", &["slip"], true),
        ("hydrostatic_block", "probes", &["probe_points"], true),
    ] {
        let row = row(scene, effect);
        assert!(row.present && row.pairs == 2, "{row:?}");
        let own: Vec<&str> = row.kernels.split(' ').collect();
        assert!(kernels.iter().all(|kernel| own.contains(kernel)), "{row:?}");
        assert_eq!(row.bytes_added > 0, bytes, "{row:?}");
        assert!(
            row.seconds_with > 0.0 && row.seconds_without > 0.0,
            "{row:?}"
        );
        let quartiles = [
            row.seconds_added_low,
            row.seconds_added,
            row.seconds_added_high,
        ];
        assert!(quartiles.is_sorted(), "{row:?}");
    }
    for (scene, effect) in [
        ("dam_break", "obstacles"),
        ("dam_break", "damping"),
        ("hydrostatic_block", "solids"),
        ("hydrostatic_block", "patch_correction"),
    ] {
        let row = row(scene, effect);
        assert!(
            !row.present && row.pairs == 0 && row.kernels.is_empty(),
            "{row:?}"
        );
        assert_eq!((row.bytes_added, row.dispatches_added), (0, 0), "{row:?}");
    }
    // Without its liquid there is nothing left of it.
    let all = row("hydrostatic_block", "liquid");
    assert!(all.present && all.pairs == 0, "{all:?}");
    for file in ["effects.csv", "effects.json", "effects.svg"] {
        let text = fs::read_to_string(folder.path().join(file)).unwrap();
        assert!(!text.is_empty() && !text.contains("NaN"), "{file}");
    }
}
