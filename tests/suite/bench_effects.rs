//! `bench effects` on small scenes: what an effect adds is its own, and what is not there adds nothing. An effect that is taken away
//! leaves nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use cutwater::effects::Effects;
use cutwater::measure::bench::Event;
use cutwater::measure::bench::effects::{ABSENT, COUPLING, EFFECTS, ITSELF, Options, PROBES, costs, measure};
use cutwater::measure::bench::table::Row;
use cutwater::scene::Scene;

use crate::bench::{numbers, row, settings};
use crate::common::{adapter, gpu, on_gpu, project_scene, scene_from};

#[test]
fn effects_add_what_is_theirs() {
    let Some(_) = gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let load = |name: &str, scale| project_scene(name, scale, &["camera.size=[160, 90]"]);
    let options = Options {
        scenes: [("dam_break", 0.12), ("hydrostatic_block", 0.3), ("gate", 0.5)]
            .map(|(name, scale)| load(name, scale))
            .to_vec(),
        frames: 2,
        adapter: adapter(),
    };
    let mut told = 0;
    let results = measure(&options, &settings(folder.path(), 1), &mut |event| {
        let Event::Row(table, row) = event else {
            return;
        };
        told += 1;
        assert_eq!(table.name, "effects");
        let written = folder.path().join("effects.csv").is_file();
        let expected = row.text("scene") != "dam_break";
        assert_eq!(written, expected, "before those of {row:?} are written");
    })
    .unwrap();
    let table = results.rows("effects");
    assert_eq!(told, table.len());
    let row = |scene: &str, effect: &str| -> &Row {
        let mut rows = table.iter();
        rows.find(|row| row.text("scene") == scene && row.text("effect") == effect).unwrap()
    };
    for (scene, effect, kernels, bytes) in [
        ("dam_break", "markers", &["advect_markers"][..], true),
        ("dam_break", "solids", &["cut_quads", "node_forces"], true),
        ("dam_break", "patch_correction", &["patch_pressure"], true),
        ("dam_break", "corotation", &[], false),
        ("hydrostatic_block", "obstacles", &["slip"], true),
        ("hydrostatic_block", "probes", &["probe_points"], true),
        ("dam_break", "probe_node", &[], true),
        ("gate", "probe_height", &[], true),
        ("gate", "moving_obstacles", &["cut_quads", "obstacle_flux"], true),
    ] {
        let row = row(scene, effect);
        assert!(row.flag("present") && row.count("pairs") == 2, "{row:?}");
        let own: Vec<&str> = row.text("kernels").split(' ').collect();
        assert!(kernels.iter().all(|kernel| own.contains(kernel)), "{row:?}");
        assert_eq!(row.number("bytes_added") > 0.0, bytes, "{row:?}");
        assert_timed(row);
    }
    for (scene, effect) in [
        ("dam_break", "obstacles"),
        ("dam_break", "damping"),
        ("hydrostatic_block", "solids"),
        ("hydrostatic_block", "moving_obstacles"),
        ("hydrostatic_block", "patch_correction"),
        ("gate", ABSENT),
    ] {
        let row = row(scene, effect);
        assert!(!row.flag("present") && row.count("pairs") == 2, "{row:?}");
        assert_timed(row);
        assert_eq!(row.text("kernels"), "", "{row:?}");
        let added = numbers(row, ["bytes_added", "dispatches_added"]);
        assert_eq!(added, [0.0; 2], "{row:?}");
    }
    // Stages that neither part has, and what both have counted twice.
    let [both, no_liquid, no_solids] = [COUPLING, "liquid", "solids"].map(|effect| row("dam_break", effect));
    assert!(both.flag("present") && both.count("pairs") == 2, "{both:?}");
    let mut kernels = both.text("kernels").split(' ');
    assert!(kernels.any(|kernel| kernel == "cut_quads"), "{both:?}");
    assert_timed(both);
    let [whole, a, b] = [both, no_liquid, no_solids].map(|row| row.number("seconds_without"));
    // Medians of two pairs are their means, so that of a sum is the sum.
    assert!((whole / (a + b) - 1.0).abs() <= 1e-12, "{whole} {a} {b}");
    assert!(!row("gate", COUPLING).flag("present"));
    // Of the kinds of probes each has its row, and those that are there say so.
    for (scene, kinds) in [
        ("dam_break", ["probe_front", "probe_node"]),
        ("hydrostatic_block", ["probe_pressure", "probe_velocity"]),
        ("gate", ["probe_height", "probe_front"]),
    ] {
        for kind in PROBES {
            let row = row(scene, kind.name);
            assert_eq!(row.flag("present"), kinds.contains(&kind.name), "{row:?}");
        }
    }
    // A path of the same scene takes the same buffers, kernels and dispatches, in the solve as many as its earlier solves let it record. The rounds
    // of separation of the gate differ between frames. Of two pairs nothing is told.
    for scene in ["dam_break", "hydrostatic_block", "gate"] {
        for effect in [ABSENT, ITSELF] {
            let row = row(scene, effect);
            assert_eq!(numbers(row, ["bytes_added", "dispatches_added", "dispatches_differ"]), [0.0; 3], "{row:?}");
            assert!(scene == "gate" || row.number("solve_dispatches_added") == 0.0, "{row:?}");
            assert_eq!(row.text("seconds_told"), "too few pairs", "{row:?}");
            assert!(!row.has("seconds_told_low"), "{row:?}");
        }
    }
    // Without its liquid there is nothing left of it: its own seconds are known, and nothing of what it costs.
    let all = row("hydrostatic_block", "liquid");
    assert!(all.flag("present") && all.count("pairs") == 0, "{all:?}");
    assert!(all.number("seconds_with") > 0.0, "{all:?}");
    let known = ["seconds_without", "seconds_added", "bytes_added"].map(|name| all.has(name));
    assert_eq!(known, [false; 3], "{all:?}");
    let text = fs::read_to_string(folder.path().join("effects.csv")).unwrap();
    let line = |line: &&str| line.starts_with("hydrostatic_block,liquid,true,");
    let line = text.lines().find(line).unwrap();
    assert!(line.ends_with(",,,,,,,,,,,,,0,"), "{line}");
    for file in ["effects.csv", "effects.json", "effects.svg"] {
        let text = fs::read_to_string(folder.path().join(file)).unwrap();
        assert!(!text.is_empty() && !text.contains("NaN"), "{file}");
        if file.ends_with(".json") {
            crate::common::json(text);
        }
    }

    results.verdict().unwrap();
    let control = row("gate", ABSENT).clone();
    assert!(!costs(&control) && costs(&control.with(row! { bytes_added: 16_usize })));
}

/// That both sides took time, and what lies between them is in order.
fn assert_timed(row: &Row) {
    let order = ["seconds_added_low", "seconds_added", "seconds_added_high"];
    let order = order.map(|name| row.number(name));
    let timed = ["seconds_with", "seconds_without"].map(|name| row.number(name) > 0.0);
    assert!(order.is_sorted() && timed == [true; 2], "{row:?}");
}

const POOL: &str = "liquid.region=[{ box = { min = [0, 0, 0], max = [1, 0.5, 1] } }]";
const RAFT: &str = r#"solid=[{ name = "raft", model = "linear", mesh = { box = { size = [0.25, 0.25, 0.25], cells = [2, 2, 2] } }, placement = { translate = [0.7, 0.5, 0.5] }, density = 500, young = 1e5, poisson = 0.3 }]"#;
const SOURCE: &str = "source=[{ box = { min = [0.5, 0.75, 0.5], max = [0.75, 0.875, 0.75] }, velocity = [0, -1, 0] }]";
const SINK: &str = "sink=[{ box = { min = [0.875, 0, 0], max = [1, 0.125, 1] } }]";
const OPEN: &str = "domain.open=[\"+x\"]";
const BALL: &str = "obstacle=[{ sphere = { centre = [0.3, 0.3, 0.5], radius = 0.2 } }]";
const HEIGHT: &str = r#"probe=[{ name = "level", height = { x = 0.7, z = 0.2 } }]"#;
const NODE: &str = r#"probe=[{ name = "corner", node = { solid = "raft", rest_point = [0.6, 0.4, 0.4] } }]"#;
const THREE_PROBES: &str = r#"probe=[{ name = "force", force = { solid = "raft" } }, { name = "corner", node = { solid = "raft", rest_point = [0.6, 0.4, 0.4] } }, { name = "level", height = { x = 0.7, z = 0.2 } }]"#;

/// A box of 8^3 cells with what is set.
fn small(set: &[&str]) -> Scene {
    let text = "[domain]\nsize = [1.0, 1.0, 1.0]\ncells = [8, 8, 8]\n[time]\nduration = 0.5\n";
    scene_from(text, set)
}

/// What a scene takes: bytes of its buffers by label, kernels, and stages and kernels of the dispatches of its first sub-step with its probes.
struct Taken {
    bytes: BTreeMap<String, u64>,
    kernels: BTreeSet<&'static str>,
    dispatches: Vec<(&'static str, &'static str)>,
}

impl Taken {
    fn by(scene: &Scene) -> Taken {
        let mut simulation = on_gpu(scene);
        let mut bytes = BTreeMap::new();
        for (label, made) in simulation.gpu().unwrap().allocated() {
            *bytes.entry(label).or_default() += made;
        }
        simulation.gpu().unwrap().start_trace();
        simulation.step().unwrap();
        simulation.probes().unwrap();
        let gpu = simulation.gpu().unwrap();
        Taken { bytes, kernels: gpu.compiled(), dispatches: gpu.take_trace().dispatches }
    }
}

/// Each effect is added to a scene and taken away again: what is left takes what the scene takes that never had it.
#[test]
fn effects_that_are_taken_away_leave_nothing() {
    let Some(_) = gpu() else { return };
    let cases: [(&[&str], &[&str], &[&str]); 11] = [
        (
            &[POOL, "liquid.surface=markers", "liquid.volume_control=false"],
            &["liquid.volume_control=true", OPEN, SOURCE, SINK, BALL, HEIGHT],
            &["volume_control", "open_sides", "sources", "sinks", "obstacles", "probes"],
        ),
        // The floor of theta has other defaults with markers and without.
        (
            &[POOL, "liquid.surface=fixed", "solver.theta_floor=0.1"],
            &["liquid.surface=markers", OPEN, SOURCE, SINK],
            &["markers"],
        ),
        (
            // Separation has another default with markers.
            &[
                POOL,
                "liquid.surface=markers",
                "liquid.volume_control=false",
                "liquid.separation=none",
                "solver.theta_floor=0.1",
            ],
            &["liquid.surface=level"],
            &["level"],
        ),
        (
            &[POOL, "liquid.surface=level", "liquid.volume_control=false"],
            &["liquid.volume_control=true"],
            &["volume_shift"],
        ),
        (
            &[POOL, "liquid.surface=markers", "liquid.volume_control=false"],
            &["liquid.separation=walls"],
            &["separation"],
        ),
        (
            &[RAFT, NODE],
            &[
                THREE_PROBES,
                POOL,
                OPEN,
                SOURCE,
                SINK,
                BALL,
                "solid[0].model=corotational",
                "solid[0].damping.mass=0.5",
                "solid[0].pin=[{ region = { box = { min = [0, 0.6, 0], max = [1, 1, 1] } } }]",
                "solid[0].script=[{ region = { box = { min = [0, 0, 0], max = [1, 0.4, 1] } }, keyframes = [{ t = 0 }, { t = 1, translate = [0.1, 0, 0] }] }]",
                "solid[0].load=[{ region = { box = { min = [0, 0.4, 0], max = [1, 0.6, 1] } }, force = [0, 1, 0] }]",
            ],
            &["liquid", "corotation", "damping", "pins", "scripts", "loads", "obstacles"],
        ),
        (
            &[POOL, BALL, HEIGHT],
            &[RAFT, THREE_PROBES, "obstacle[0].keyframes=[{ t = 0 }, { t = 1, translate = [0.1, 0, 0] }]"],
            &["solids", "moving_obstacles"],
        ),
        (
            &[RAFT, NODE, BALL],
            &["obstacle[0].keyframes=[{ t = 0 }, { t = 1, translate = [0.1, 0, 0] }]"],
            &["pushing_obstacles"],
        ),
        (&[RAFT, NODE], &["solver.solid_contact=true"], &["solid_contact"]),
        (&[RAFT, NODE, "solver.solid_contact=true"], &["solid[0].friction=0.3"], &["friction"]),
        (
            &[POOL, RAFT, "solver.pressure_on_patches=cell"],
            &["solver.pressure_on_patches=hydrostatic"],
            &["patch_correction"],
        ),
    ];
    let mut away = BTreeSet::new();
    for (plain, more, names) in cases {
        let mut left = small(&[plain, more].concat());
        for effect in EFFECTS.iter().filter(|effect| names.contains(&effect.name)) {
            assert!((effect.present)(&left), "{} was not there", effect.name);
            (effect.without)(&mut left);
            assert!(!(effect.present)(&left), "{} is still there", effect.name);
            away.insert(effect.name);
        }
        let plain = small(plain);
        assert_eq!(Effects::of(&left), Effects::of(&plain), "{names:?}");
        let [left, plain] = [left, plain].map(|scene| Taken::by(&scene));
        assert_eq!(left.bytes, plain.bytes, "without {names:?}");
        assert_eq!(left.kernels, plain.kernels, "without {names:?}");
        let [n, n_plain] = [&left, &plain].map(|taken| taken.dispatches.len());
        assert!(
            left.dispatches == plain.dispatches,
            "without {names:?}: {n} dispatches, and {n_plain} of what never had them"
        );
    }
    assert_eq!(away.len(), EFFECTS.len(), "all but {away:?}");
}
