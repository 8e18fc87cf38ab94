//! The plan of a scene is what is made: effects, stages, kernels, buffers; and a scene that does not fit is refused at once.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use cutwater::effects::Effects;
use cutwater::gpu::AdapterReport;
use cutwater::grid::Axis;
use cutwater::scene::{Precision, Scene};
use cutwater::sim::{Backend, Plan, Simulation, solids_of};
use cutwater::{Error, geometry};

use crate::cli::{complains, cutwater, ends, folder, text};
use crate::common::{adapter, gpu, project_scene as scene, scene_from};
use crate::reference_physics::{pool, scene as written};

const SCENES: [(&str, f64); 7] = [
    ("fountain", 0.25),
    ("draining_tank", 0.25),
    ("dam_break_liquid", 0.25),
    ("drop_into_pool", 0.5),
    ("hydrostatic_block", 0.5),
    ("sphere_half_full", 0.5),
    ("standing_wave", 0.5),
];

/// Bytes by label.
fn by_label<'a>(list: impl IntoIterator<Item = (&'a str, u64)>) -> BTreeMap<String, u64> {
    let mut sums = BTreeMap::new();
    for (label, bytes) in list {
        *sums.entry(label.to_owned()).or_default() += bytes;
    }
    sums
}

fn allocated(simulation: &Simulation) -> Vec<(String, u64)> {
    simulation.gpu().unwrap().allocated()
}

/// The simulation of a scene, with its plan.
fn made(scene: &Scene) -> (Simulation, Plan) {
    let simulation = Simulation::new(scene, &Backend::Gpu(adapter())).unwrap();
    let plan = Plan::new(scene, simulation.adapter()).unwrap();
    (simulation, plan)
}

/// Compares every label but the markers, whose number is estimated, exactly, and the sum within 5 %.
fn assert_buffers(what: &str, plan: &Plan, simulation: &Simulation) {
    let allocated = allocated(simulation);
    let mut made = by_label(allocated.iter().map(|(label, bytes)| (&**label, *bytes)));
    let mut planned = by_label(plan.buffers.iter().map(|buffer| (&*buffer.label, buffer.bytes())));
    let total = |list: &BTreeMap<String, u64>| list.values().sum::<u64>() as f64;
    let ratio = total(&planned) / total(&made);
    assert!((ratio - 1.0).abs() <= 0.05, "{what}: planned over made {ratio}");
    for label in ["liquid.markers", "level.marker_velocity"] {
        made.remove(label);
        planned.remove(label);
    }
    assert_eq!(planned, made, "{what}");
}

#[test]
fn estimate_is_what_is_allocated() {
    let Some(_) = gpu() else { return };
    for (name, scale) in SCENES {
        let (simulation, plan) = made(&scene(name, scale, &[]));
        assert_buffers(name, &plan, &simulation);
    }
    for overrides in [
        ["solver.preconditioner=jacobi", "solver.precision=f32"],
        ["solver.preconditioner=multigrid", "solver.precision=f32"],
    ] {
        let (simulation, plan) = made(&scene("dam_break_liquid", 0.25, &overrides));
        assert_buffers(&overrides.join(" "), &plan, &simulation);
    }
}

#[test]
fn kernels_and_stages_are_those_planned() {
    let Some(_) = gpu() else { return };
    let fixed = "liquid.surface=fixed";
    let cases: [(&str, f64, &[&str]); 8] = [
        ("fountain", 0.25, &[]),
        ("draining_tank", 0.25, &[]),
        ("dam_break_liquid", 0.25, &[]),
        ("dam_break_liquid", 0.25, &[fixed]),
        ("sphere_half_full", 0.5, &[]),
        ("sphere_half_full", 0.5, &[fixed]),
        ("dam_break_liquid", 0.25, &["solver.preconditioner=jacobi", "solver.tolerance=1e-3"]),
        // Long enough sums to be folded in two levels.
        ("drop_into_pool", 1.0, &[]),
    ];
    for (name, scale, overrides) in cases {
        let what = format!("{name} {overrides:?}");
        let scene = scene(name, scale, overrides);
        let (mut simulation, plan) = made(&scene);
        let compiled = simulation.gpu().unwrap().compiled();
        let planned: BTreeSet<&str> = plan.stages.iter().flat_map(|stage| stage.kernels.iter().copied()).collect();
        assert_eq!(planned, compiled, "{what}: kernels");
        let report = simulation.step().unwrap();
        if simulation.adapter().unwrap().timestamps {
            let run: Vec<&str> = report.seconds.iter().map(|(stage, _)| *stage).collect();
            let planned: Vec<&str> = plan
                .stages
                .iter()
                // Probes are read on their own, after the step that the report is of.
                .filter(|stage| stage.every_step && stage.name != "probe")
                .map(|stage| stage.name)
                .collect();
            assert_eq!(planned, run, "{what}: stages");
        }
    }
}

/// A scene of solids with every effect of theirs but those left out by name.
fn solids_with(absent: &[&str], overrides: &[&str]) -> Scene {
    let with = |effect: &str, text: &str| match absent.contains(&effect) {
        true => String::new(),
        false => text.to_owned(),
    };
    let mut text = "[domain]\nsize = [1.0, 1.0, 1.0]\ncells = [12, 12, 12]\n[time]\nduration = 0.1\n\n".to_owned();
    for (name, x) in [("left", 0.3), ("right", 0.7)] {
        text += &format!(
            "[[solid]]\nname = \"{name}\"\nmesh = {{ box = {{ size = [0.2, 0.2, 0.4], cells = [2, 3, 4] }} }}\n\
             placement = {{ translate = [{x}, 0.5, 0.5] }}\ndensity = 1000.0\nyoung = 1e5\npoisson = 0.3\n"
        );
        text += &with("corotation", "model = \"corotational\"\n");
        if absent.contains(&"corotation") {
            text += "model = \"linear\"\n";
        }
        text += &with("damping", "damping = { mass = 0.5, stiffness = 0.01 }\n");
        let region = "region = { box = { min = [0.0, 0.0, 0.29], max = [1.0, 1.0, 0.31] } }";
        let upper = "region = { box = { min = [0.0, 0.0, 0.69], max = [1.0, 1.0, 0.71] } }";
        text += &with("pins", &format!("[[solid.pin]]\n{region}\ncomponents = \"x\"\n"));
        text += &with(
            "scripts",
            &format!(
                "[[solid.script]]\n{upper}\nkeyframes = [{{ t = 0.0 }}, {{ t = 0.1, translate = [0.0, 0.0, 0.02] }}]\n"
            ),
        );
        text += &with("loads", &format!("[[solid.load]]\n{region}\nforce = [0.0, 1.0, 0.0]\n"));
    }
    text += "[solver]\nsolid_contact = false\n";
    text += &with("obstacles", "[[obstacle]]\nsphere = { centre = [0.5, 0.1, 0.5], radius = 0.1 }\n");
    text += &with("probes", "[[probe]]\nname = \"tip\"\nnode = { solid = \"left\", rest_point = [0.3, 0.5, 0.5] }\n");
    scene_from(&text, overrides)
}

/// Effects of solids that a scene may lack.
const OF_SOLIDS: [&str; 7] = ["corotation", "damping", "pins", "scripts", "loads", "obstacles", "probes"];

#[test]
fn solids_take_what_is_planned_and_nothing_of_the_liquids() {
    let Some(_) = gpu() else { return };
    let liquid = made(&scene("dam_break_liquid", 0.25, &[])).0;
    let kernels_of = |simulation: &Simulation| simulation.gpu().unwrap().compiled();
    let labels_of = |simulation: &Simulation| -> BTreeSet<String> {
        allocated(simulation).into_iter().map(|(label, _)| label).collect()
    };
    let f32 = ["solver.precision=f32", "solver.tolerance=1e-5"];
    let mut cases: Vec<(Vec<&str>, &[&str])> = vec![(vec![], &[]), (vec![], &f32), (OF_SOLIDS.to_vec(), &[])];
    cases.extend(OF_SOLIDS.map(|effect| (vec![effect], &[][..])));
    for (absent, overrides) in cases {
        let what = format!("without {absent:?}, {overrides:?}");
        let scene = solids_with(&absent, overrides);
        let (mut simulation, plan) = made(&scene);
        let planned = by_label(plan.buffers.iter().map(|plan| (&*plan.label, plan.bytes())));
        let before = allocated(&simulation);
        let there = by_label(before.iter().map(|(label, bytes)| (&**label, *bytes)));
        assert_eq!(planned, there, "{what}: buffers");
        let planned: BTreeSet<&str> = plan.stages.iter().flat_map(|stage| stage.kernels.iter().copied()).collect();
        assert_eq!(planned, kernels_of(&simulation), "{what}: kernels");
        for effect in OF_SOLIDS {
            let line = plan.effects.iter().find(|line| line.name == effect).unwrap();
            assert_eq!(line.active, !absent.contains(&effect), "{what}: {line:?}");
        }

        simulation.step().unwrap();
        simulation.gpu().unwrap().start_trace();
        let report = simulation.step().unwrap();
        let noted = simulation.gpu().unwrap().take_trace().dispatches;
        for (stage, kernel) in &noted {
            let stage = plan.stages.iter().find(|planned| planned.name == *stage);
            let stage = stage.unwrap_or_else(|| panic!("{what}: {kernel} in a stage that is not planned"));
            assert!(stage.kernels.contains(kernel), "{what}: {kernel} in {}", stage.name);
        }
        if simulation.adapter().unwrap().timestamps {
            let run: Vec<&str> = report.seconds.iter().map(|(stage, _)| *stage).collect();
            let every: Vec<&str> = plan
                .stages
                .iter()
                .filter(|stage| stage.every_step && stage.name != "probe")
                .map(|stage| stage.name)
                .collect();
            assert_eq!(run, every, "{what}: stages");
        }
        // Probes are read after every sub-step of a run.
        simulation.probes().unwrap();
        assert!(report.liquid.is_none() && report.solid.is_some(), "{what}");
        assert_eq!(allocated(&simulation), before, "{what}: a step allocates");

        // What liquid and solids share is the outer loop of the solver, and obstacles where there are any.
        for label in labels_of(&simulation).intersection(&labels_of(&liquid)) {
            assert!(label.starts_with("gpu.") || label.starts_with("obstacles."), "{what}: {label} is the liquid's");
        }
        for kernel in kernels_of(&simulation).intersection(&kernels_of(&liquid)) {
            assert!(
                kernel.starts_with("pcg_") || kernel.starts_with("refine_") || *kernel == "fold_partials",
                "{what}: {kernel} is the liquid's"
            );
        }
    }
    for label in labels_of(&liquid) {
        assert!(!label.starts_with("solid"), "{label} without solids");
    }
    for kernel in kernels_of(&liquid) {
        let of_solids = ["solid", "node", "element", "chebyshev", "move_solid", "diagnose_solid"];
        assert!(!of_solids.iter().any(|name| kernel.starts_with(name)), "{kernel} without solids");
    }
}

/// An absent effect brings neither buffer nor kernel.
#[test]
fn absent_effects_of_solids_take_nothing() {
    let Some(_) = gpu() else { return };
    let bytes = |simulation: &Simulation, label: &str| -> u64 {
        let all = allocated(simulation);
        all.iter().filter(|(made, _)| made == label).map(|(_, bytes)| bytes).sum()
    };
    let (all, _) = made(&solids_with(&[], &[]));
    for (effect, label, kernel) in [
        ("scripts", "solid.prescribed", None),
        ("obstacles", "obstacles.solid_distance", Some("obstacle_contacts")),
        ("probes", "solid.displacement (read-back)", None),
    ] {
        let (without, _) = made(&solids_with(&[effect], &[]));
        assert!(bytes(&all, label) > 64, "{label} with {effect}");
        assert!(bytes(&without, label) <= 32, "{label} without {effect}");
        if let Some(kernel) = kernel {
            let compiled = |simulation: &Simulation| simulation.gpu().unwrap().compiled().contains(kernel);
            assert!(compiled(&all) && !compiled(&without), "{kernel}");
        }
    }
    // What holds a body keeps it from turning as a whole, and linear ones do not turn.
    let held: &[&str] = &[];
    for (absent, turns) in
        [(held, false), (&["pins", "scripts", "loads"], true), (&["pins", "scripts", "loads", "corotation"], false)]
    {
        let (made, _) = made(&solids_with(absent, &[]));
        let of_two_bodies = if turns { 32 } else { 0 };
        assert_eq!(bytes(&made, "solid.turning"), of_two_bodies, "{absent:?}");
        let compiled = made.gpu().unwrap().compiled().contains("turn_solids");
        assert_eq!(compiled, turns, "{absent:?}");
    }
}

/// Of the hash of Fowler, Noll and Vo (FNV-1a, 64 bits).
const FNV_START: u64 = 0xcbf2_9ce4_8422_2325;
/// Likewise.
const FNV_PRIME: u64 = 0x0000_0100_0000_01b3;

/// What liquid alone takes, as `tests/data/liquid_alone.txt` has it: buffers with their bytes, then stages and kernels of the
/// second sub-step with the number of their dispatches, and a hash of the order of all dispatches.
#[test]
fn liquid_alone_takes_what_it_always_took() {
    if gpu().is_none_or(|gpu| !gpu.has_f64()) {
        return;
    }
    let mut taken = String::new();
    for (name, scale, surface) in [
        ("dam_break_liquid", 0.25, "markers"),
        ("sphere_half_full", 0.5, "markers"),
        ("hydrostatic_block", 0.5, "fixed"),
    ] {
        let (mut simulation, _) = made(&scene(name, scale, &[&format!("liquid.surface={surface}")]));
        writeln!(taken, "{name} {surface}").unwrap();
        let allocated = allocated(&simulation);
        for (label, bytes) in by_label(allocated.iter().map(|(label, bytes)| (&**label, *bytes))) {
            writeln!(taken, "  {label}: {bytes}").unwrap();
        }
        simulation.step().unwrap();
        simulation.gpu().unwrap().start_trace();
        simulation.step().unwrap();
        let dispatches = simulation.gpu().unwrap().take_trace().dispatches;
        let mut counts: Vec<(_, usize)> = Vec::new();
        let mut order = FNV_START;
        for dispatch in dispatches {
            let name = format!("{} {}", dispatch.0, dispatch.1);
            order = name.bytes().fold(order, |order, byte| (order ^ u64::from(byte)).wrapping_mul(FNV_PRIME));
            match counts.iter_mut().find(|(known, _)| *known == name) {
                Some((_, n)) => *n += 1,
                None => counts.push((name, 1)),
            }
        }
        for (name, n) in counts {
            writeln!(taken, "  {name} x {n}").unwrap();
        }
        writeln!(taken, "  order {order:016x}").unwrap();
    }
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/liquid_alone.txt");
    let expected = fs::read_to_string(&file).unwrap_or_default();
    if taken != expected {
        let now = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/liquid_alone.txt");
        fs::write(&now, &taken).unwrap();
        let differs = taken.lines().zip(expected.lines()).find(|(a, b)| a != b);
        panic!("{} is not {}: {differs:?}", now.display(), file.display());
    }
}

#[test]
fn absent_effects_take_nothing() {
    let Some(_) = gpu() else { return };
    // Which buffers and kernels each of two effects brings: those that disappear without it.
    let with = |obstacles: bool, markers: bool| {
        let surface = if markers { "markers" } else { "fixed" };
        let overrides = [format!("liquid.surface={surface}")];
        let name = if obstacles { "hydrostatic_block" } else { "dam_break_liquid" };
        let scale = if obstacles { 0.5 } else { 0.25 };
        made(&scene(name, scale, &[&overrides[0]]))
    };
    let labels = |simulation: &Simulation| -> BTreeSet<String> {
        allocated(simulation).into_iter().filter(|(_, bytes)| *bytes > 16).map(|(label, _)| label).collect()
    };
    let kernels = |simulation: &Simulation| simulation.gpu().unwrap().compiled();
    for markers in [true, false] {
        let (none, plan) = with(false, markers);
        assert!(!labels(&none).contains("obstacles.solid_distance"), "buffers without obstacles, markers {markers}");
        for kernel in [
            "push_out",
            "extend_into_solids",
            "finish_extension",
            "advect_slivers",
            "show_slivers",
            "advect_beside_slivers",
            "blend_slivers",
            "swap_slivers",
            "slip",
            "apply_slip",
        ] {
            assert!(!kernels(&none).contains(kernel), "{kernel} without obstacles");
        }
        let line = plan.effects.iter().find(|line| line.name == "obstacles");
        assert!(!line.unwrap().active, "obstacles, markers {markers}");
    }
    for obstacles in [true, false] {
        let (fixed, plan) = with(obstacles, false);
        for label in ["liquid.markers", "liquid.occupied", "liquid.classes"] {
            assert!(!allocated(&fixed).iter().any(|(made, _)| made == label), "{label} with a fixed surface");
        }
        for kernel in ["advect_markers", "occupy", "spread_markers", "union_of_spheres"] {
            assert!(!kernels(&fixed).contains(kernel), "{kernel} with a fixed surface");
        }
        assert!(!plan.stages.iter().any(|stage| stage.name == "advect_markers"), "advect_markers with a fixed surface");
    }
}

/// Liquid, a solid that swims in it and an obstacle: of what brings liquid in, takes it out or moves the obstacle each comes with kernels and buffers
/// of its own, and is gone without it; nothing else comes or goes with it. An open side has no kernel of its own.
#[test]
fn ways_in_and_out_and_motion_take_nothing_where_they_are_absent() {
    let Some(_) = gpu() else { return };
    let text = |more: &str, keyframes: &str| {
        format!(
            "surface = \"markers\"\n\
             [[liquid.region]]\nbox = {{ min = [0, 0, 0], max = [1, 0.5, 1] }}\n{more}\
             [[solid]]\nname = \"raft\"\nmesh = {{ box = {{ size = [0.2, 0.2, 0.2], cells = [2, 2, 2] }} }}\n\
             placement = {{ translate = [0.7, 0.5, 0.5] }}\ndensity = 500\nyoung = 1e5\npoisson = 0.3\n\
             [[obstacle]]\nbox = {{ min = [0.1, 0.2, 0.3], max = [0.4, 0.6, 0.7] }}\n{keyframes}"
        )
    };
    let of = |text: &str, open: bool| -> (BTreeSet<&'static str>, BTreeSet<String>) {
        let mut scene = written([16, 16, 16], text);
        if open {
            scene.domain.open = scene.domain.open.with(Axis::X, 1);
        }
        let (simulation, plan) = made(&scene);
        assert_buffers(text, &plan, &simulation);
        let labels = allocated(&simulation).into_iter().map(|(label, _)| label);
        (simulation.gpu().unwrap().compiled(), labels.collect())
    };
    let (kernels, labels) = of(&text("", ""), false);
    let source = "[[source]]\nbox = { min = [0.5, 0.8, 0.5], max = [0.7, 0.9, 0.7] }\nvelocity = [0, -1, 0]\n";
    let sink = "[[sink]]\nbox = { min = [0.9, 0, 0], max = [1, 0.1, 1] }\n";
    let keyframes = "keyframes = [{ t = 0 }, { t = 1, translate = [0.1, 0, 0] }]\n";
    let sourcing = ["carry_faces", "count_in_sources", "hold_faces", "plan_seeds", "seed_markers"];
    for (what, text, open, own_kernels, own_labels) in [
        ("open side", text("", ""), true, &[][..], &[][..]),
        ("source", text(source, ""), false, &sourcing, &["sources."]),
        ("sink", text(sink, ""), false, &["empty_sinks", "sink_markers"], &["sinks."]),
        (
            "motion",
            text("", keyframes),
            false,
            &["moving_contacts", "obstacle_flux", "take_up"],
            &["clip.fluxes", "liquid.obstacle_flux", "solid.obstacle_"],
        ),
    ] {
        let (with_kernels, with_labels) = of(&text, open);
        let own: Vec<&str> = with_kernels.difference(&kernels).copied().collect();
        assert_eq!(own, own_kernels, "{what}");
        assert_eq!(kernels.difference(&with_kernels).count(), 0, "{what}");
        let own: Vec<&String> = with_labels.difference(&labels).collect();
        assert_eq!(own.is_empty(), own_labels.is_empty(), "{what}: {own:?}");
        let of_its_own = |label: &String| own_labels.iter().any(|own| label.starts_with(own));
        assert!(own.iter().all(|label| of_its_own(label)), "{what}: {own:?}");
        assert!(!labels.iter().any(of_its_own), "{what}");
        assert_eq!(labels.difference(&with_labels).count(), 0, "{what}");
    }
}

#[test]
fn a_step_allocates_nothing() {
    let Some(_) = gpu() else { return };
    for name in ["drop_into_pool", "sphere_half_full"] {
        for overrides in [&[][..], &["solver.precision=f32", "solver.tolerance=1e-4"]] {
            let (mut simulation, _) = made(&scene(name, 0.5, overrides));
            let before = allocated(&simulation);
            while simulation.clock().frame < 2 {
                simulation.step().unwrap();
            }
            assert_eq!(allocated(&simulation), before, "{name} {overrides:?}");
        }
    }
}

/// An adapter as the largest data-centre GPUs have it.
fn large_adapter(f64: bool) -> AdapterReport {
    AdapterReport {
        name: "large".to_owned(),
        driver: String::new(),
        backend: "vulkan".to_owned(),
        kind: "discrete",
        f64,
        timestamps: true,
        storage_buffers: 8,
        storage_binding: u64::from(u32::MAX),
        buffer: 1 << 40,
        threads: 1024,
        workgroups: 65535,
    }
}

/// A level has more arrays of cells than markers have, and a fraction of the markers.
#[test]
fn memory_keeps_within_200_bytes_per_cell_and_64_per_marker() {
    let shape = ["domain.size=[1, 1, 1]", "domain.cells=[64, 64, 64]"];
    for (name, _) in SCENES {
        for (precision, f64) in [("f32", false), ("mixed", false), ("mixed", true), ("f64", true)] {
            let precision_is = format!("solver.precision={precision}");
            let tolerance = "solver.tolerance=1e-4";
            for surface in ["markers", "level"] {
                let surface_is = format!("liquid.surface={surface}");
                // Probes of the wider scenes lie outside the cube.
                let overrides = [shape[0], shape[1], &precision_is, tolerance, "probe=[]", &surface_is];
                let scene = scene(name, 1.0, &overrides);
                let plan = Plan::new(&scene, Some(&large_adapter(f64))).unwrap();
                let (cell, marker) = (plan.bytes_per_cell(), plan.bytes_per_marker());
                let what = format!("{name} {surface} {precision}, f64 {f64}: {cell} per cell, {marker} per marker");
                // Sources hold faces: they have their own copy of what is open of these, 12 bytes a cell and its share of spare cells.
                let of_sources = if Effects::of(&scene).sources { 12.1 } else { 0.0 };
                let of_level = if surface == "level" { 110.0 } else { 0.0 };
                assert!(cell <= 200.0 + of_sources + of_level && marker <= 64.0, "{what}");
                assert!(cell > 50.0, "{what}");
            }
        }
    }
}

#[test]
fn markers_are_estimated_within_two_percent() {
    for (name, _) in SCENES {
        for scale in [0.5, 2.0] {
            let scene = scene(name, scale, &["liquid.surface=markers"]);
            let grid = scene.grid();
            let solids = solids_of(&scene).unwrap();
            let mesh = solids.moved(&[]);
            let estimate = geometry::estimate_markers(&scene, &grid, &mesh).unwrap() as f64;
            let cut = geometry::cut_cells(&scene, &grid).unwrap();
            let exact = geometry::seed_markers(&scene, &grid, &cut).unwrap().len() as f64;
            let off = (estimate / exact - 1.0).abs();
            assert!(off <= 0.02, "{name} at {scale}: {estimate} for {exact}");
        }
    }
}

/// A block in the pool, as small as it starts: it takes a fifth of the liquid's room.
#[test]
fn markers_are_estimated_beside_the_solids() {
    let block = "[[solid]]\nname = \"block\"\ndensity = 1000\nyoung = 1e5\npoisson = 0.3\n\
        mesh = { box = { size = [0.8, 0.8, 0.8], cells = [2, 2, 2] } }\n\
        placement = { translate = [0.5, 0.3, 0.5] }\ninitial = { scale = 0.6 }\n";
    for cells in [16, 40] {
        let pool = pool(0.6).replace("fixed", "markers");
        let empty = written([cells; 3], &pool);
        let scene = written([cells; 3], &(pool + block));
        let planned = |scene: &Scene| Plan::new(scene, None).unwrap().n_markers as f64;
        let seeded = Simulation::new(&scene, &Backend::Cpu).unwrap();
        let exact = seeded.state().unwrap().markers.len() as f64;
        let estimate = planned(&scene);
        let off = (estimate / exact - 1.0).abs();
        assert!(off <= 0.02, "{cells}: {estimate} for {exact}");
        assert!(estimate < 0.9 * planned(&empty), "{cells}: {estimate}");
    }
}

#[test]
fn what_does_not_fit_is_named() {
    let scene = scene("dam_break_liquid", 1.0, &[]);
    let mut adapter = large_adapter(true);
    let plan = Plan::new(&scene, Some(&adapter)).unwrap();
    plan.check(&adapter).unwrap();
    let largest = plan.buffers.iter().max_by_key(|buffer| buffer.bytes()).unwrap();
    adapter.storage_binding = largest.bytes() - 1;
    let error = plan.check(&adapter).unwrap_err();
    assert_eq!(error.exit_code(), 3, "{error}");
    match &error {
        Error::Limit { what, needed, available, unit, .. } => {
            assert_eq!(*what, format!("buffer {}", largest.label));
            assert_eq!((*needed, *available), (largest.bytes(), largest.bytes() - 1));
            assert!(unit.contains("max_storage_buffer_binding_size"), "{unit}");
        }
        other => panic!("{other}"),
    }
    (adapter.storage_binding, adapter.buffer) = (u64::from(u32::MAX), largest.bytes() - 1);
    let message = plan.check(&adapter).unwrap_err().to_string();
    assert!(message.contains("max_buffer_size"), "{message}");
    assert!(message.contains("--scale"), "{message}");
    assert_eq!(scene.solver.precision, Precision::Mixed);
}

/// What an adapter must allow for a device to be opened at all, and the precision.
#[test]
fn what_every_kernel_needs_is_checked() {
    let of = |overrides: &[&str], adapter: &AdapterReport| {
        let scene = scene("dam_break_liquid", 0.25, overrides);
        Plan::new(&scene, Some(adapter)).unwrap().check(adapter)
    };
    let least = AdapterReport { threads: 256, storage_buffers: 8, workgroups: 32_768, ..large_adapter(true) };
    of(&[], &least).unwrap();
    let fewer = [
        ("max_compute_invocations_per_workgroup", 256, AdapterReport { threads: 255, ..least.clone() }),
        ("max_storage_buffers_per_shader_stage", 8, AdapterReport { storage_buffers: 7, ..least.clone() }),
        ("max_compute_workgroups_per_dimension", 32_768, AdapterReport { workgroups: 32_767, ..least }),
    ];
    for (limit, needed, adapter) in fewer {
        let error = of(&[], &adapter).unwrap_err();
        assert_eq!(error.exit_code(), 3, "{error}");
        let there = needed - 1;
        let told = format!("({limit}) needs {needed} units, the adapter allows {there}\n");
        assert!(error.to_string().contains(&told), "{error}");
    }
    let double = ["solver.precision=f64"];
    of(&double, &large_adapter(true)).unwrap();
    let error = of(&double, &large_adapter(false)).unwrap_err();
    assert_eq!(error.exit_code(), 3, "{error}");
    assert!(error.to_string().contains("SHADER_F64"), "{error}");
}

/// 22^3 nodes in a pool.
const LARGE_BLOCK: &str = r#"[domain]
size = [1, 1, 1]
cells = [8, 8, 8]
[time]
duration = 0.1
[[liquid.region]]
box = { min = [0, 0, 0], max = [1, 0.6, 1] }
[[solid]]
name = "block"
mesh = { box = { size = [0.4, 0.4, 0.4], cells = [21, 21, 21] } }
placement = { translate = [0.5, 0.3, 0.5] }
density = 1000
young = 1e5
poisson = 0.3
[solver]
formulation = "condensed"
"#;

/// By the plan after its tables, with and without an adapter, and by a run in the same words.
#[test]
fn a_form_that_does_not_serve_is_refused() {
    let folder = folder(LARGE_BLOCK);
    let checked = |overrides: &[&str], f64: bool| {
        let overrides: Vec<String> = overrides.iter().map(|&text| text.to_owned()).collect();
        let scene = Scene::load(&folder.path().join("dam.toml"), &overrides, 1.0).unwrap();
        let adapter = large_adapter(f64);
        Plan::new(&scene, Some(&adapter)).unwrap().check(&adapter)
    };
    let small = "solid[0].mesh.box.cells=[2,2,2]";
    checked(&[small], true).unwrap();
    checked(&[small], false).unwrap();
    let single = [small, "solver.precision=f32"];
    let error = checked(&single, true).unwrap_err();
    assert!(error.to_string().contains("outer loop in f64"), "{error}");
    // Other forms serve, and weak coupling has none.
    for other in ["solver.formulation=two_field", "solver.coupling=weak"] {
        checked(&[other], true).unwrap();
    }
    let error = checked(&[], true).unwrap_err();
    assert_eq!(error.exit_code(), 3, "{error}");
    let refusal = error.to_string();
    let told = "needs 31944 components of the nodes of solids, the adapter allows 30000\n";
    assert!(refusal.contains(told), "{refusal}");

    for drivers in [true, false] {
        let mut command = cutwater(&folder, "plan dam.toml");
        if !drivers {
            command.env("VK_DRIVER_FILES", "nowhere.json").env_remove("VK_ICD_FILENAMES");
        }
        let done = ends(command, 3);
        let (said, told) = (text(&done.stdout), text(&done.stderr));
        assert!(said.contains("coupling.") && !said.contains("the scene fits"), "{said}");
        assert!(told.contains(&refusal), "{told}");
    }
    if gpu().is_some() {
        let message = complains(&folder, "run dam.toml", 3);
        assert!(message.contains(&refusal), "{message}");
    }
}

/// More or fewer cells change nothing for solids.
#[test]
fn the_cure_for_large_solids_is_a_coarser_mesh() {
    let mut adapter = large_adapter(true);
    let [whole, scaled] = [1.0, 0.5].map(|scale| Plan::new(&scene("cantilever", scale, &[]), Some(&adapter)).unwrap());
    let largest = |plan: &Plan| plan.buffers.iter().map(|buffer| buffer.bytes()).max();
    assert_eq!(largest(&whole), largest(&scaled));
    adapter.storage_binding = largest(&whole).unwrap() - 1;
    let message = whole.check(&adapter).unwrap_err().to_string();
    assert!(message.contains("coarser meshes") && !message.contains("--scale"), "{message}");
}

#[test]
fn without_f64_the_host_turns() {
    for name in ["dam_break_liquid", "dam_break"] {
        let scene = scene(name, 0.25, &[]);
        let turns = |f64| {
            let adapter = large_adapter(f64);
            let plan = Plan::new(&scene, Some(&adapter)).unwrap();
            plan.check(&adapter).unwrap();
            let rhs = plan.buffers.iter().find(|buffer| buffer.label == "solver.rhs");
            (plan.host_turns, rhs.unwrap().element)
        };
        assert_eq!(turns(true), (false, 8), "{name}");
        assert_eq!(turns(false), (true, 4), "{name}");
    }
}

#[test]
fn effects_of_solids_say_why_they_are_there() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/scene.md");
    let page = fs::read_to_string(file).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let effects = |text: &str| -> Effects {
        let file = folder.path().join("solids.toml");
        fs::write(&file, text).unwrap();
        Effects::of(&Scene::load(&file, &[], 1.0).unwrap())
    };
    let cantilever = page
        .split("```toml\n")
        .skip(1)
        .filter_map(|block| block.split("```").next())
        .find(|block| block.contains("[[solid]]"))
        .unwrap();
    let whole = Effects {
        solids: true,
        corotation: true,
        damping: true,
        pins: true,
        loads: true,
        probes: true,
        ..Effects::default()
    };
    assert_eq!(effects(cantilever), whole);
    let linear = cantilever.replace("[[solid.pin]]", "model = \"linear\"\n[[solid.pin]]");
    let corotation = false;
    assert_eq!(effects(&linear), Effects { corotation, ..whole });
    let undamped = cantilever.replace("stiffness = 0.01", "stiffness = 0");
    let damping = false;
    assert_eq!(effects(&undamped), Effects { damping, ..whole });
    let scripted = cantilever
        .replace("[[solid.pin]]", "[[solid.script]]\nkeyframes = [{ t = 0 }]")
        .replace("[[solid.load]]", "[[solid.pin]]")
        .replace("force = [0, -1, 0]\n", "");
    assert_eq!(effects(&scripted), Effects { scripts: true, loads: false, ..whole });
}

/// Cells, nodes and elements of the thesis's scenes (table 6.1). Meshes of bricks are the thesis's; ball, shell and toy have as many nodes and elements
/// within a quarter.
#[test]
fn scenes_of_the_thesis_have_its_grids_and_meshes() {
    for (name, cells, printed) in [
        ("dam_break", 100, [725, 2688]),
        ("buoyancy_light", 100, [481, 2000]),
        ("compressibility", 100, [343, 1296]),
        ("sloped_panel", 100, [882, 2400]),
        ("platform", 64, [2450, 6936]),
        ("fluid_in_sphere", 100, [992, 2948]),
        ("light_dino", 100, [1424, 5920]),
    ] {
        let plan = Plan::new(&scene(name, 1.0, &[]), None).unwrap();
        assert_eq!(plan.grid.cells, [cells; 3], "{name}");
        let sizes = [plan.n_nodes, plan.n_elements];
        let unlike = match name {
            "buoyancy_light" | "fluid_in_sphere" | "light_dino" => 0.25,
            _ => 0.0,
        };
        let alike =
            sizes.iter().zip(printed).all(|(&size, printed)| (size as f64 / f64::from(printed) - 1.0).abs() <= unlike);
        assert!(alike, "{name}: {sizes:?} where {printed:?} are printed");
    }
}
