//! Edits of a scene: those that a resumed run accepts or refuses, and parts that `--without` removes.

use std::fs;

use cutwater::output::manifest::Manifest;
use cutwater::scene::{Scene, without};
use tempfile::TempDir;

use crate::kills::{Run, contents};

/// A small dam break on a wall, and a block that lies dry.
const SCENE: &str = r#"[domain]
size = [0.8, 0.4, 0.2]
cells = [16, 8, 4]
open = ["+x", "+y"]
[time]
duration = 0.1
frames_per_second = 30
[[liquid.region]]
box = { min = [0, 0, 0], max = [0.2, 0.2, 0.2] }
[[sink]]
box = { min = [0.7, 0, 0], max = [0.8, 0.1, 0.2] }
[[obstacle]]
box = { min = [0.6, 0, 0], max = [0.7, 0.1, 0.2] }
[[solid]]
name = "wall"
mesh = { box = { size = [0.1, 0.2, 0.2], cells = [1, 2, 2] } }
placement = { at = [0.25, 0.1, 0.1] }
density = 1000
young = 1e6
poisson = 0.3
[[solid.pin]]
region = { box = { min = [0, -0.001, 0], max = [0.8, 0.001, 0.2] } }
[[solid]]
name = "dry.block"
mesh = { box = { size = [0.1, 0.1, 0.1], cells = [1, 1, 1] } }
placement = { at = [0.5, 0.05, 0.1] }
density = 1000
young = 1e6
poisson = 0.3
[[probe]]
name = "column"
height = { x = 0.05, z = 0.1 }
[[probe]]
name = "load"
force = { solid = "wall" }
[[probe]]
name = "block"
solid = { name = "dry.block" }
[solver]
formulation = "two_field"
[output]
every = 1
solids = true
[camera]
fov = 40
"#;

fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("wall.toml"), SCENE).unwrap();
    folder
}

fn on_cpu(folder: &TempDir) -> Run<'_> {
    Run { folder: folder.path(), arguments: "run wall.toml --backend cpu" }
}

/// Standard error of a run that must be refused.
fn refusal(run: &Run, more: &str) -> String {
    let output = run.command("out", more).output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(message.contains("cure: "), "{message}");
    message
}

#[test]
fn a_resumed_run_accepts_edits_that_leave_its_frames_alone() {
    let folder = folder();
    let run = on_cpu(&folder);
    let out = run.whole("out", "");
    let frames = |numbers: &[u64]| {
        let progress = Manifest::read(&out).unwrap().progress;
        assert_eq!(progress.frames_written, numbers);
    };
    frames(&[0, 1, 2, 3]);
    let skin = || {
        let mut command = crate::common::program();
        command.args(["skin", "out", "--obj"]).current_dir(folder.path());
        assert!(command.output().unwrap().status.success());
    };
    skin();
    // The longer run that nobody disturbed.
    let wanted = contents(&run.whole("whole", "--frames 6"));
    let edited = SCENE
        .replace("[domain]", "# Longer, seen from elsewhere, with fewer files.\n[domain]")
        .replace("duration = 0.1", "duration = 0.2")
        .replace("fov = 40", "fov = 50")
        .replace("every = 1", "every = 2\ncheckpoint_every = 1");
    fs::write(folder.path().join("wall.toml"), &edited).unwrap();
    let output = run.command("out", "--resume").output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{message}");
    assert!(message.contains("run `cutwater skin` again"), "{message}");
    // Written frames stay, and later ones are every second.
    frames(&[0, 1, 2, 3, 4, 6]);
    let found = contents(&out);
    for file in ["steps.csv", "probes.csv", "frames/wall_000003.vtu", "frames/wall_000006.vtu"] {
        assert!(found[file] == wanted[file], "{file} differs");
    }
    assert!(!found.contains_key("frames/wall_000005.vtu"));
    // Skins of frames that were not computed again stay, the animation of the shorter run is gone.
    for file in ["wall_wall_000003.ply", "wall_wall_000003.obj", "wall_000003.obj"] {
        assert!(found.contains_key(&format!("frames/{file}")), "{file}");
    }
    assert!(!found.contains_key("frames/wall_wall.glb"));
    assert_eq!(Manifest::read(&out).unwrap().camera.fov, 50.0);
    // A finished run has its new camera without another frame.
    fs::write(folder.path().join("wall.toml"), edited.replace("fov = 50", "fov = 60")).unwrap();
    skin();
    run.whole("out", "--resume");
    assert_eq!(Manifest::read(&out).unwrap().camera.fov, 60.0);
    assert!(contents(&out).contains_key("frames/wall_wall.glb"), "nothing was computed");
}

#[test]
fn a_resumed_run_refuses_edits_by_their_keys() {
    let folder = folder();
    let run = on_cpu(&folder);
    let before = contents(&run.whole("out", "--frames 2"));
    for (more, expected) in [
        ("--set solid.wall.young=2e6", "solid[0].young was 1000000 and is 2000000"),
        ("--set time.cfl=2", "time.cfl is new: 2"),
        ("--without obstacle", "obstacle[0].box.max was [0.7, 0.1, 0.2] and is gone"),
        ("--set output.solids=false", "frames 0 to 2 were written with output.solids"),
        ("--set output.surface=true", "frames 0 to 2 were written without output.surface"),
        ("--set time.duration=0.04 --frames 1", "2 frames"),
    ] {
        let message = refusal(
            &run,
            &format!("--frames 4 --resume {more}")
                .replace("--frames 4 --resume --set time.duration=0.04", "--resume --set time.duration=0.04"),
        );
        assert!(message.contains(expected), "{more}: {message}");
    }
    // More changes than a message has room for.
    let message = refusal(&run, "--resume --without obstacle --without solid.wall --without sink");
    assert!(message.contains(" more"), "{message}");
    assert_eq!(contents(&folder.path().join("out")), before);
}

/// The scene without some keys.
fn scene(keys: &[&str]) -> Result<Scene, cutwater::Error> {
    let overrides: Vec<String> = keys.iter().map(|key| without(key)).collect();
    Scene::parse("wall.toml".as_ref(), SCENE, &overrides, 1.0)
}

#[test]
fn removed_parts_take_along_what_refers_to_them() {
    let names = |scene: &Scene| -> Vec<String> { scene.solids.iter().map(|solid| solid.name.clone()).collect() };
    let probes = |scene: &Scene| -> Vec<String> { scene.probes.iter().map(|probe| probe.name.clone()).collect() };
    let dry = scene(&["liquid"]).unwrap();
    assert!(dry.liquid.is_none() && dry.sinks.is_empty() && !dry.domain.open.any());
    assert_eq!(names(&dry), ["wall", "dry.block"]);
    assert_eq!(probes(&dry), ["block"]);
    assert_eq!(dry.removed, ["sink", "domain.open", "solver.formulation", "probe \"column\"", "probe \"load\""]);
    // The same by index and by name, also by one with a point.
    for keys in [vec!["solid[0]"], vec!["solid.wall"], vec!["solid[0]", "solid.wall"]] {
        let one = scene(&keys).unwrap();
        assert_eq!(names(&one), ["dry.block"], "{keys:?}");
        assert_eq!(probes(&one), ["column", "block"]);
        assert_eq!(one.removed, ["probe \"load\""]);
    }
    let one = scene(&["solid.dry.block"]).unwrap();
    assert_eq!((names(&one), probes(&one)), (vec!["wall".to_owned()], vec!["column".into(), "load".into()]));
    // Both indices are those of the file.
    for keys in [vec!["solid[0]", "solid[1]"], vec!["solid"], vec!["solid.wall", "solid.dry.block"]] {
        let wet = scene(&keys).unwrap();
        assert!(wet.solids.is_empty() && wet.liquid.is_some(), "{keys:?}");
        assert_eq!(probes(&wet), ["column"]);
        assert_eq!(wet.removed, ["output.solids", "solver.formulation", "probe \"load\"", "probe \"block\""]);
    }
    let bare = scene(&["obstacle[0]", "domain.open.+x", "probe.column", "solid.wall.pin"]).unwrap();
    assert!(bare.obstacles.is_empty() && bare.solids[0].pins.is_empty() && bare.removed.is_empty());
    assert_eq!(probes(&bare), ["load", "block"]);
    assert_eq!(bare.values["domain.open"], "[\"+y\"]");
    // In a list of overrides the indices are those at its place.
    let mixed = ["solid[1].young=3e5".to_owned(), without("solid[0]"), "solid[0].poisson=0.2".to_owned()];
    let mixed = Scene::parse("wall.toml".as_ref(), SCENE, &mixed, 1.0).unwrap();
    assert_eq!((names(&mixed), mixed.solids[0].young, mixed.solids[0].poisson), (vec!["dry.block".into()], 3e5, 0.2));
    let twice = [without("solid[0]"), format!("then {}", without("probe[0]")), without("probe[1]")];
    let twice = Scene::parse("wall.toml".as_ref(), SCENE, &twice, 1.0).unwrap();
    assert_eq!((names(&twice), twice.probes.len()), (vec!["dry.block".to_owned()], 0));
    // A name with a point is a step of --set too.
    let set = ["solid.dry.block.young=2e5".to_owned()];
    let set = Scene::parse("wall.toml".as_ref(), SCENE, &set, 1.0).unwrap();
    assert_eq!([set.solids[0].young, set.solids[1].young], [1e6, 2e5]);
}

#[test]
fn what_cannot_be_removed_is_refused() {
    for (keys, expected) in [
        (
            vec!["solid[2]"],
            "--without solid[2]: there is no `[2]` in solid\n  cure: choose one of solid[0] (wall), solid[1] (dry.block)",
        ),
        (vec!["solid.dry"], "there is no `dry` in solid"),
        (vec!["liquids"], "there is no `liquids` in the scene\n  cure: choose one of camera, domain, liquid"),
        (vec!["liquid.density"], "there is no `density` in liquid"),
        (vec!["solid."], "`solid.` is not a key"),
        (vec![""], "there is no `` in the scene"),
        (vec!["liquid", "solid"], "leaves neither liquid nor solids"),
        (vec!["domain.size"], "domain.size: is missing"),
        (vec!["liquid.region"], "liquid.region: is missing"),
    ] {
        let message = scene(&keys).unwrap_err().to_string();
        assert!(message.contains(expected), "{keys:?}: {message}");
    }
}

#[test]
fn every_command_with_a_scene_removes_parts() {
    let folder = folder();
    let command = |arguments: &str, code: i32| {
        let mut command = crate::common::program();
        command.args(arguments.split_whitespace()).current_dir(folder.path());
        let output = command.output().unwrap();
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{arguments}: {message}");
        (String::from_utf8_lossy(&output.stdout).into_owned(), message)
    };
    let (_, message) = command("run wall.toml --backend cpu --frames 1 --without liquid --without solid.wall", 0);
    assert!(message.contains("--without also removes what refers to it: sink, domain.open,"), "{message}");
    let manifest = Manifest::read(&folder.path().join("out/wall")).unwrap();
    assert_eq!(manifest.options.overrides, ["without liquid", "without solid.wall"]);
    assert_eq!(manifest.solids.len(), 1);
    command("plan wall.toml --backend cpu --without solid", 0);
    command(
        "sweep wall.toml --backend cpu --frames 1 --without liquid --without solid.wall --set solid[1].young=1e5,1e6",
        0,
    );
    // An index is that of the file, also where a solid before it is removed.
    let swept = Manifest::read(&folder.path().join("out/wall_sweep/young=1e5")).unwrap();
    assert_eq!(swept.scene.values["solid[0].young"], "100000");
    command(
        "converge wall.toml --backend cpu --frames 1 --scales 0.5,1,2 --elements --without liquid --without solid.wall",
        0,
    );
    let finest = Manifest::read(&folder.path().join("out/wall_converge/scale=2")).unwrap();
    assert_eq!(finest.scene.values["solid[0].mesh.box.cells"], "[2, 2, 2]");
}
