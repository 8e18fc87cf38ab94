//! `bench effects` on small scenes: what an effect adds is its own, and what is not there adds nothing; what outputs take.

use std::fs;
use std::path::Path;

use cutwater::gpu::AdapterChoice;
use cutwater::measure::bench_effects::{Options, Row, bench_effects};
use cutwater::measure::output_cost::OutputRow;
use cutwater::scene::Scene;
use cutwater::sim::{Backend, Simulation};

use crate::common::gpu;

#[test]
fn effects_add_what_is_theirs() {
    if gpu().is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let load = |name: &str, scale| {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenes/{name}.toml"));
        let small = ["camera.size=[160, 90]".to_owned()];
        Scene::load(&file, &small, scale).unwrap()
    };
    let options = Options {
        scenes: vec![
            load("dam_break", 0.12),
            load("hydrostatic_block", 0.3),
            load("gate", 0.5),
        ],
        frames: 2,
        adapter: AdapterChoice::Best,
    };
    let mut told = 0;
    let tables = bench_effects(&options, folder.path(), &mut |_| told += 1).unwrap();
    let (table, outputs) = (&tables.effects, &tables.outputs);
    assert_eq!(told, table.rows.len() + outputs.rows.len());
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
        (
            "gate",
            "moving_obstacles",
            &["cut_quads", "obstacle_flux"],
            true,
        ),
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
        ("hydrostatic_block", "moving_obstacles"),
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
    let of_scene = |scene: &str| -> Vec<(&str, bool)> {
        let rows = outputs.rows.iter().filter(|row| row.scene == scene);
        rows.map(|row| (row.output, row.present)).collect()
    };
    let solid_and_liquid = [
        ("read_back", true),
        ("particles", true),
        ("fields", false),
        ("surface", false),
        ("solids", true),
        ("checkpoint", true),
        ("preview", false),
    ];
    assert_eq!(of_scene("dam_break"), solid_and_liquid);
    assert!(
        !of_scene("hydrostatic_block")
            .iter()
            .any(|(name, _)| *name == "solids")
    );
    assert!(of_scene("gate").contains(&("moving_obstacles", true)));
    for row in &outputs.rows {
        let OutputRow {
            seconds_low,
            seconds,
            seconds_high,
            frames,
            ..
        } = *row;
        assert!(
            [0.0, seconds_low, seconds, seconds_high].is_sorted() && frames == 2,
            "{row:?}"
        );
        assert_eq!(row.bytes > 0, row.output != "read_back", "{row:?}");
    }
    // Three coordinates and three components of a velocity of four bytes for each marker, in base 64, and a little more.
    let gate = Simulation::new(&load("gate", 0.5), &Backend::Gpu(AdapterChoice::Best)).unwrap();
    let markers = gate.state().unwrap().markers.len() as f64;
    let particles = outputs
        .rows
        .iter()
        .find(|row| row.scene == "gate" && row.output == "particles");
    let bytes = particles.unwrap().bytes as f64;
    assert!(
        (32.0 * markers..60.0 * markers).contains(&bytes),
        "{bytes} for {markers} markers"
    );
    assert!(!folder.path().join("frames").exists(), "frames were left");
    for file in [
        "effects.csv",
        "effects.json",
        "effects.svg",
        "outputs.csv",
        "outputs.json",
    ] {
        let text = fs::read_to_string(folder.path().join(file)).unwrap();
        assert!(!text.is_empty() && !text.contains("NaN"), "{file}");
    }
}
