//! The program as a user has it: arguments, files, messages and exit codes.

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use serde_json::Value;
use tempfile::TempDir;

use crate::common::{assert_has, gpu, json, program};

pub(crate) const DAM: &str = r#"# A small dam break.
[domain]
size = [1.5, 1.0, 0.5]
cells = [24, 16, 8]
[time]
duration = 0.25
[[liquid.region]]
box = { min = [0, 0, 0], max = [0.5, 0.75, 0.5] }
[[probe]]
name = "front"
front = { axis = "x" }
[camera]
size = [64, 36]
"#;

/// Files of the frames 0 to `last` of [`DAM`], and their series.
fn frame_files(last: usize) -> Vec<String> {
    let frames = (0..=last).flat_map(|frame| ["vti", "vtp"].map(|kind| format!("dam_{frame:06}.{kind}")));
    frames.chain(["fields", "markers"].map(|kind| format!("dam_{kind}.pvd"))).collect()
}

/// A new folder with a scene file `dam.toml`.
pub(crate) fn folder(scene: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("dam.toml"), scene).unwrap();
    folder
}

/// The program in a folder, ready to start; arguments are separated by spaces.
pub(crate) fn cutwater(folder: &TempDir, arguments: &str) -> Command {
    let mut command = program();
    command.args(arguments.split_whitespace()).current_dir(folder.path()).stdin(Stdio::null());
    command
}

pub(crate) fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// Runs a command to its end, which must have this exit code, and must not have come by a panic.
pub(crate) fn ends(mut command: Command, code: i32) -> Output {
    let output = command.output().unwrap();
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(output.status.code(), Some(code), "{command:?}\n{out}\n{err}");
    assert!(!err.contains("panicked"), "{command:?}\n{err}");
    output
}

/// As [`ends`]; gives what the program prints on standard output.
pub(crate) fn says(folder: &TempDir, arguments: &str) -> String {
    text(&ends(cutwater(folder, arguments), 0).stdout)
}

/// As [`ends`]; gives what the program complains about.
pub(crate) fn complains(folder: &TempDir, arguments: &str, code: i32) -> String {
    text(&ends(cutwater(folder, arguments), code).stderr)
}

pub(crate) fn manifest(run: &Path) -> Value {
    json(fs::read(run.join("manifest.json")).unwrap())
}

/// Names of the files in a folder, sorted.
pub(crate) fn list(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// The columns of a table by their names.
fn column(table: &Path, name: &str) -> Vec<f64> {
    let mut reader = csv::Reader::from_path(table).unwrap();
    let index = reader.headers().unwrap().iter().position(|head| head == name);
    let index = index.unwrap_or_else(|| panic!("{}: no column {name}", table.display()));
    reader.records().map(|row| row.unwrap()[index].parse().unwrap()).collect()
}

#[test]
fn help_lists_the_commands_of_the_readme() {
    let folder = folder(DAM);
    let help = says(&folder, "--help");
    let commands = help.split("Commands:").nth(1).unwrap().split("Options:").next().unwrap();
    let readme = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("README.md")).unwrap();
    let mut n = 0;
    for line in commands.lines().filter(|line| line.starts_with("  ") && !line.starts_with("   ")) {
        let command = line.split_whitespace().next().unwrap();
        if command != "help" {
            assert!(readme.contains(&format!("| [`cutwater {command}")), "README.md: no command {command}");
            assert!(says(&folder, &format!("{command} --help")).contains("Usage: cutwater"), "{command}");
            n += 1;
        }
    }
    assert!(n > 1, "{help}");
    let version = concat!("cutwater ", env!("CARGO_PKG_VERSION"));
    assert_eq!(says(&folder, "-V"), format!("{version}\n"));
    let sources = cutwater::measure::bench::SOURCES;
    assert_eq!(says(&folder, "--version"), format!("{version} ({sources})\n"));
    assert_eq!(sources.len(), 12, "{sources}");
}

#[test]
fn help_shows_lists_as_they_are_typed() {
    let folder = folder(DAM);
    for (bench, list) in
        [("solve", "20,40,60,80"), ("accuracy", "f32,mixed,f64"), ("accuracy", "1e-2,1e-4,1e-6,1e-8,1e-10,1e-12")]
    {
        let help = says(&folder, &format!("bench {bench} --help"));
        assert!(help.contains(&format!("{list}]")), "{list}: {help}");
    }
}

#[test]
fn wrong_arguments_are_bad_input() {
    let folder = folder(DAM);
    assert!(complains(&folder, "run dam.toml --ouut x", 2).contains("--out"));
    assert!(complains(&folder, "walk dam.toml", 2).contains("walk"));
    assert!(complains(&folder, "run dam.toml --backend tpu", 2).contains("cpu"));
    for (arguments, expected) in [
        ("compare dam.toml --frames 0", "--frames"),
        ("bench solve --grids 1", "2 to 1024 cells"),
        ("bench solve --grids 8,1025", "2 to 1024 cells"),
        ("bench solve --tolerance nan", "above 0 and below 1"),
        ("bench solve --tolerance=-1", "above 0 and below 1"),
        ("bench solve --tolerance -1", "above 0 and below 1"),
        ("bench solve --against amg", "multigrid"),
        ("bench step dam.toml --scale most", "give numbers, or max"),
        ("bench step dam.toml --solids-scale 0", "--solids-scale 0"),
        ("bench device --repeats 0", "invalid value '0'"),
        ("bench stability --steps 0", "invalid value '0'"),
        ("bench solve --repeats -1", "invalid value '-1'"),
        ("export dam.toml --step -1 --out x", "invalid value '-1'"),
    ] {
        let message = complains(&folder, arguments, 2);
        assert!(message.contains(expected), "{arguments}: {message}");
    }
    for bench in ["accuracy dam.toml", "solve", "device", "step dam.toml"] {
        let message = complains(&folder, &format!("bench {bench} --repeats 0"), 2);
        let told = "invalid value '0' for '--repeats";
        assert!(message.contains(told), "{bench}: {message}");
    }
}

#[test]
fn mesh_names_all_kinds_of_files_that_it_takes() {
    let folder = folder(DAM);
    for arguments in ["mesh dam.xyz", "mesh dam.xyz --cell-size 0.1"] {
        let message = complains(&folder, arguments, 2);
        let mut parts = vec!["dam.xyz: unknown kind of mesh file"];
        parts.extend([".msh", ".vtu", ".obj", ".stl", ".ply", ".glb"]);
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
    }
}

#[test]
fn a_missing_scene_is_bad_input() {
    let message = complains(&folder(DAM), "run pool.toml", 2);
    assert!(message.starts_with("error: ") && message.contains("pool.toml") && message.contains("cure: "), "{message}");
}

#[test]
fn a_broken_scene_is_bad_input_with_file_line_key_and_cure() {
    for (good, broken, line, key, cure) in [
        ("cells = [24, 16, 8]", "celss = [24, 16, 8]", 4, "domain.celss", "cells"),
        ("duration = 0.25", "duration = -1", 6, "time.duration", "above zero"),
        ("axis = \"x\"", "axis = \"w\"", 11, "probe[0].front.axis", "\"x\""),
        ("[camera]", "[camera", 12, "", "]"),
    ] {
        let folder = folder(&DAM.replace(good, broken));
        let message = complains(&folder, "run dam.toml", 2);
        assert!(message.starts_with(&format!("error: dam.toml:{line}: {key}")), "{message}");
        assert_has(&message, &["cure: ", cure]);
        assert!(!folder.path().join("out").exists(), "a run was begun");
    }
    let message = complains(&folder(DAM), "run dam.toml --set liquid.densty=1", 2);
    assert_has(&message, &["liquid.densty", "density"]);
}

#[test]
fn a_run_writes_what_the_page_says() {
    let folder = folder(DAM);
    let said = says(&folder, "run dam.toml --backend cpu --frames 2 --preview");
    let run = folder.path().join("out/dam");
    for part in ["frame 1 of 2: ", "frame 2 of 2: ", "frames: ", "3 pictures: ", "animation: "] {
        assert!(said.contains(part), "{said}");
    }
    assert_eq!(list(&run), ["checkpoint.npz", "frames", "manifest.json", "preview", "probes.csv", "steps.csv"]);
    assert_eq!(list(&run.join("frames")), frame_files(2));
    assert_eq!(list(&run.join("preview")), ["dam.png", "dam_000000.png", "dam_000001.png", "dam_000002.png"]);
    let manifest = manifest(&run);
    assert_eq!(manifest["progress"]["status"], "finished");
    assert_eq!(manifest["progress"]["frames_written"], serde_json::json!([0, 1, 2]));
    assert_eq!(manifest["options"]["backend"], "cpu");
    assert_eq!(manifest["adapter"], Value::Null);
    let times = column(&run.join("steps.csv"), "t");
    assert_eq!(times.last(), Some(&(2.0 / 24.0)));
    assert!(times.is_sorted() && times.len() >= 2, "{times:?}");
    assert_eq!(column(&run.join("probes.csv"), "t"), times);
    let numbers = column(&run.join("steps.csv"), "step");
    assert_eq!(column(&run.join("probes.csv"), "step"), numbers);
    let fronts = column(&run.join("probes.csv"), "front");
    assert!(fronts.iter().all(|front| (0.45..0.75).contains(front)), "{fronts:?}");
}

#[test]
fn a_scene_is_changed_from_the_command_line() {
    let folder = folder(DAM);
    says(
        &folder,
        "run dam.toml --backend cpu --frames 1 --scale 0.5 --set output.fields=true --set liquid.seed=7 --out a",
    );
    let manifest = manifest(&folder.path().join("a"));
    assert_eq!(manifest["cells"], serde_json::json!([12, 8, 4]));
    assert_eq!(manifest["options"]["scale"], 0.5);
    assert_eq!(manifest["options"]["overrides"], serde_json::json!(["output.fields=true", "liquid.seed=7"]));
    assert!(folder.path().join("a/frames/dam_000001.vti").exists());
}

#[test]
fn an_earlier_run_is_replaced_only_when_asked() {
    let folder = folder(DAM);
    let run = folder.path().join("out/dam");
    says(&folder, "run dam.toml --backend cpu --frames 2 --scale 0.5");
    let before = fs::read(run.join("steps.csv")).unwrap();
    let message = complains(&folder, "run dam.toml --backend cpu --frames 1 --scale 0.5", 2);
    assert_has(&message, &["--overwrite", "--out"]);
    assert!(!message.contains("partial results"), "{message}");
    assert_eq!(fs::read(run.join("steps.csv")).unwrap(), before);
    says(&folder, "run dam.toml --backend cpu --frames 1 --scale 0.5 --overwrite");
    assert_eq!(list(&run.join("frames")), frame_files(1));
    assert_eq!(manifest(&run)["progress"]["frames_written"], serde_json::json!([0, 1]));
}

/// Files of the names that a run has, in a folder that is of no run, are somebody's.
#[test]
fn files_of_no_run_are_left_alone() {
    for name in ["steps.csv", "probes.csv", "frames", "preview"] {
        let folder = folder(DAM);
        let out = folder.path().join("out/dam");
        fs::create_dir_all(&out).unwrap();
        fs::write(out.join(name), "mine").unwrap();
        for how in ["", "--overwrite", "--resume"] {
            let message = complains(&folder, &format!("run dam.toml --backend cpu --frames 1 {how}"), 2);
            assert_has(&message, &[name, "--out"]);
        }
        assert_eq!(fs::read_to_string(out.join(name)).unwrap(), "mine");
    }
}

#[test]
fn numbers_that_cannot_be_are_answered_with_the_cure() {
    let folder = folder(DAM);
    for (arguments, told) in [
        ("run dam.toml --frames 1000000", "1000000 is not in 0..=999999"),
        ("run dam.toml --frames -1", "invalid value '-1'"),
        ("plan dam.toml --scale -1", "use a number above zero"),
    ] {
        let message = complains(&folder, arguments, 2);
        assert!(message.contains(told), "{arguments}: {message}");
    }
    assert!(!folder.path().join("out").exists());
}

/// What is found only when the scene is built has its line too, or the `--set`.
#[test]
fn what_has_no_cell_is_refused_in_its_line() {
    let tap = "[[sink]]\nbox = { min = [0.1, 0.1, 0.1], max = [0.101, 0.101, 0.101] }\n";
    let folder = folder(&format!("{DAM}{tap}"));
    let message = complains(&folder, "plan dam.toml", 2);
    assert_has(&message, &["dam.toml:14: sink[0]: no cell of"]);
    let moved = "plan dam.toml --set sink[0]={box={min=[0,0,0],max=[1e-3,1e-3,1e-3]}}";
    let message = complains(&folder, moved, 2);
    assert_has(&message, &["--set sink[0]=", ": sink[0]: no cell of"]);
}

#[test]
fn runs_and_plans_warn_of_what_they_cannot_do() {
    let piston = "[[obstacle]]\nbox = { min = [0.5, 0.5, 0.1], max = [0.7, 2.0, 0.4] }\n\
                  keyframes = [{ t = 0 }, { t = 1, translate = [0, -0.4, 0] }]\n\
                  [[probe]]\nname = \"blind\"\npressure = { point = [0.6, 0.7, 0.25] }\n";
    let folder = folder(&format!("{}{piston}", DAM.replace("max = [0.5, 0.75, 0.5]", "max = [1.5, 1.0, 0.5]")));
    let output = ends(cutwater(&folder, "run dam.toml --backend cpu --frames 1"), 0);
    let told = text(&output.stderr);
    for words in ["probe \"blind\" lies in an obstacle", "would have compressed enclosed liquid"] {
        assert!(told.contains(words), "{told}");
    }
    assert!(!told.contains("missed the tolerance"), "{told}");
    let told = text(&ends(cutwater(&folder, "plan dam.toml"), 0).stderr);
    assert_has(&told, &["probe \"blind\" lies in an obstacle"]);
}

#[test]
fn solids_in_each_other_are_told() {
    let solid = |name: &str, x: f64| {
        format!(
            "[[solid]]\nname = \"{name}\"\nmesh = {{ box = {{ size = [0.25, 0.25, 0.25], cells = [2, 2, 2] }} }}\n\
             placement = {{ translate = [{x}, 0.3, 0.25] }}\ndensity = 1000.0\nyoung = 1e5\npoisson = 0.3\n"
        )
    };
    let domain = DAM.split("[[liquid.region]]").next().unwrap();
    for (scene, x, told) in [(DAM, 0.55, true), (DAM, 1.0, false), (domain, 0.55, true), (domain, 1.0, false)] {
        let folder = folder(&format!("{scene}{}{}", solid("one", 0.45), solid("other", x)));
        let output = ends(cutwater(&folder, "run dam.toml --backend cpu --frames 1"), 0);
        let warned = text(&output.stderr).contains("with each other or with obstacles");
        assert_eq!(warned, told, "{output:?}");
    }
}

#[test]
fn a_frame_whose_files_are_gone_is_missed() {
    let folder = folder(DAM);
    says(&folder, "run dam.toml --backend cpu --frames 2 --scale 0.5");
    for kind in ["vti", "vtp"] {
        fs::remove_file(folder.path().join(format!("out/dam/frames/dam_000001.{kind}"))).unwrap();
    }
    let output = ends(cutwater(&folder, "preview out/dam"), 0);
    assert!(text(&output.stdout).contains("2 pictures"));
    let told = text(&output.stderr);
    assert_has(&told, &["1 frames have no picture, frame 1 first"]);
    // A manifest that asks for more than a picture can be is refused, not tried.
    let path = folder.path().join("out/dam/manifest.json");
    let manifest = fs::read_to_string(&path).unwrap();
    let mut manifest: Value = serde_json::from_str(&manifest).unwrap();
    manifest["camera"]["size"] = serde_json::json!([1_000_000, 1_000_000]);
    fs::write(&path, manifest.to_string()).unwrap();
    let message = complains(&folder, "preview out/dam", 2);
    assert_has(&message, &["manifest.json", "16 to 8192"]);
}

#[test]
fn a_run_on_the_gpu_names_its_adapter() {
    let Some(gpu) = gpu() else { return };
    let folder = folder(DAM);
    let adapters = says(&folder, "adapters");
    assert!(adapters.contains(&gpu.report().name), "{adapters}");
    says(&folder, "run dam.toml --frames 1");
    let run = folder.path().join("out/dam");
    assert_eq!(manifest(&run)["adapter"]["name"], gpu.report().name);
    assert_eq!(column(&run.join("steps.csv"), "t").last(), Some(&(1.0 / 24.0)));
    for (wanted, told) in [("nonesuch", "none matches the name \"nonesuch\""), ("97", "none matches index 97")] {
        let arguments = format!("run dam.toml --adapter {wanted} --out other");
        let message = complains(&folder, &arguments, 3);
        assert_has(&message, &[told, &gpu.report().name]);
    }
    // Before the fields of the block are made, 50 GB of them.
    let message = complains(&folder, "bench solve --grids 8,1024", 3);
    assert!(message.contains("buffer bench.open"), "{message}");
}

/// A bench without `--backend` does not propose it.
#[test]
fn cures_are_options_of_the_command() {
    let Some(_) = gpu() else { return };
    let folder = folder(DAM);
    // Face velocities take 0.3 GB, more than software drivers bind.
    let message = complains(&folder, "bench step dam.toml --scale 20", 3);
    let cure = "cure: use fewer cells (--scale) or coarser meshes of the solids, or another adapter (--adapter)";
    assert_has(&message, &["buffer", cure]);
}

/// Before anything of the grid's size is allocated.
#[test]
fn what_no_machine_has_room_for_is_refused_at_once() {
    let folder = folder(DAM);
    // 4096 cells along an axis are nothing special, their cube is.
    let cube = "--set domain.size=[1,1,1] --set domain.cells=[4096,4096,4096]";
    for command in ["run", "plan", "run --backend cpu"] {
        let message = complains(&folder, &format!("{command} dam.toml {cube}"), 2);
        assert_has(&message, &["domain.cells", "use fewer cells"]);
    }
    if gpu().is_some() {
        let done = ends(cutwater(&folder, "plan dam.toml --scale 64"), 3);
        let (said, told) = (text(&done.stdout), text(&done.stderr));
        assert!(said.contains("TOO SMALL") && !said.contains("the scene fits"), "{said}");
        assert!(told.contains("bytes (max_") && told.contains("cure: use fewer cells (--scale)"), "{told}");
    }
    let memory = fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let kibibytes = |line: &str| line.strip_prefix("MemTotal:")?.trim().trim_end_matches(" kB").parse::<u64>().ok();
    let total = memory.lines().find_map(kibibytes);
    if total.is_none_or(|total| total >= 80 << 20) {
        eprintln!("skipped: this machine may have room for 805,306,368 cells");
        return;
    }
    for command in ["run", "plan"] {
        let message = complains(&folder, &format!("{command} dam.toml --scale 64 --backend cpu"), 3);
        let parts = ["at least", "GiB of the machine's memory", "cure: use fewer cells (--scale)"];
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
    }
    assert!(!folder.path().join("out").exists());
}

/// Vulkan's loader finds no driver; other systems bring theirs.
#[cfg(target_os = "linux")]
#[test]
fn without_an_adapter_the_cure_is_named() {
    let folder = folder(DAM);
    says(&folder, "run dam.toml --backend cpu --frames 1 --scale 0.5");
    let run = folder.path().join("out/dam");
    let frames = list(&run.join("frames"));
    for arguments in ["adapters", "run dam.toml --out new", "run dam.toml --overwrite", "bench solve --grids 8"] {
        let mut command = cutwater(&folder, arguments);
        command.env("VK_DRIVER_FILES", "nowhere.json").env_remove("VK_ICD_FILENAMES");
        let message = text(&ends(command, 3).stderr);
        assert_has(&message, &["mesa-vulkan-drivers", "--backend cpu"]);
    }
    assert!(!folder.path().join("new/manifest.json").exists(), "a run was begun");
    assert_eq!(list(&run.join("frames")), frames, "the earlier run");
}

/// What no run has written stays, and a folder that is no run's is not touched.
#[test]
fn overwriting_removes_a_run_and_nothing_else() {
    let folder = folder(DAM);
    let run = folder.path().join("out/dam");
    fs::create_dir_all(run.join("frames")).unwrap();
    fs::write(run.join("manifest.json"), "{\"my\": 1}").unwrap();
    fs::write(run.join("frames/mine.txt"), "mine").unwrap();
    let again = "run dam.toml --backend cpu --overwrite --frames 1";
    let message = complains(&folder, again, 2);
    assert_has(&message, &["manifest.json", "--out"]);
    assert!(run.join("frames/mine.txt").exists());
    fs::remove_dir_all(&run).unwrap();
    says(&folder, "run dam.toml --backend cpu --frames 3");
    fs::write(run.join("frames/mine.txt"), "mine").unwrap();
    says(&folder, again);
    let mine = ["mine.txt".to_owned()];
    assert_eq!(list(&run.join("frames")), [&frame_files(1)[..], &mine].concat());
}

#[test]
fn a_scene_without_any_liquid_is_refused_and_little_is_told() {
    let region =
        |number: usize, max: &str| format!("[[liquid.region]]\nbox = {{ min = [0.{number}, 0, 0], max = {max} }}\n");
    let head = DAM.split("[[liquid.region]]").next().unwrap();
    let none = folder(&(head.to_string() + &region(0, "[1.5, 0.03, 0.5]")));
    for surface in ["markers", "fixed"] {
        let arguments = format!("run dam.toml --backend cpu --set liquid.surface={surface}");
        let message = complains(&none, &arguments, 2);
        let parts = ["dam.toml:7: liquid.region", "no cell", "use more cells"];
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
    }
    let plate = "[[obstacle]]\nbox = { min = [1.2, 0, 0], max = [1.22, 1, 0.5] }\n";
    let text = head.to_string() + &region(0, "[0.5, 0.75, 0.5]") + &region(9, "[1.0, 0.03, 0.5]");
    let little = folder(&(text + plate));
    let done = ends(cutwater(&little, "run dam.toml --backend cpu --frames 1"), 0);
    let told = String::from_utf8(done.stderr).unwrap();
    assert!(told.contains("liquid.region[1] has no liquid"), "{told}");
    assert!(!told.contains("liquid.region[0]"), "{told}");
    assert!(told.contains("obstacle[0] is 0.32 cells thick"), "{told}");
    // Before the first sub-step, and without any.
    for (arguments, code) in [("run dam.toml --out other --adapter nonesuch", 3), ("plan dam.toml --backend cpu", 0)] {
        let told = complains(&little, arguments, code);
        assert!(told.contains("obstacle[0] is 0.32 cells thick"), "{told}");
    }
}

const BEAM: &str = r#"# A beam that falls onto a plate.
[domain]
size = [1.5, 1.0, 0.5]
cells = [24, 16, 8]
[time]
duration = 0.1
[[solid]]
name = "beam"
mesh = { box = { size = [0.5, 0.025, 0.25], cells = [4, 1, 2] } }
placement = { translate = [0.75, 0.25, 0.25] }
density = 1000
young = 1e5
poisson = 0.3
[[obstacle]]
box = { min = [0.5, 0.1, 0.1], max = [1.0, 0.12, 0.4] }
"#;

#[test]
fn a_folder_that_cannot_be_written_is_told() {
    let folder = folder(DAM);
    let told = complains(&folder, "run dam.toml --backend cpu --out dam.toml", 2);
    let parts = ["cannot write dam.toml", "cure: choose a writable folder"];
    assert!(parts.iter().all(|part| told.contains(part)), "{told}");
    assert_eq!(fs::read_to_string(folder.path().join("dam.toml")).unwrap(), DAM);
}

#[test]
fn what_is_too_thin_for_the_cells_is_told_in_the_words_of_the_scene() {
    let told = |scene: &str| complains(&folder(scene), "plan dam.toml --backend cpu", 0);
    let solids = told(BEAM);
    assert!(solids.contains("obstacle[0] is 0.32 cells thick: solids pass"));
    assert!(!solids.contains("liquid") && !solids.contains("beam"), "{solids}");
    let region = "[[liquid.region]]\nbox = { min = [0, 0, 0], max = [1.5, 0.5, 0.5] }\n";
    let both = told(&(BEAM.to_owned() + region));
    assert_has(&both, &["0.32 cells thick: liquid leaks and solids pass"]);
    assert_has(&both, &["solid \"beam\" is 0.40 cells thick: liquid leaks"]);
}

#[test]
fn pictures_without_frames_are_refused_before_the_run() {
    let without = |folder: &TempDir, arguments: &str, key: &str| {
        let told = complains(folder, &format!("run dam.toml --preview {arguments}"), 2);
        let parts = ["--preview", "no frames to draw", key, "without --preview"];
        assert!(parts.iter().all(|part| told.contains(part)), "{told}");
        assert!(!folder.path().join("out").exists());
    };
    let beam = folder(BEAM);
    without(&beam, "--set output.solids=false", "output.solids");
    let dam = folder(DAM);
    without(&dam, "--set liquid.surface=markers --set output.particles=false", "output.particles, output.fields or");
    let region = "[[liquid.region]]\nbox = { min = [0, 0, 0], max = [1.5, 0.5, 0.5] }\n";
    let both = folder(&(BEAM.to_owned() + region));
    for (off, missing) in [("solids", "solids"), ("particles", "liquid")] {
        // An adapter that is not there ends the run before it begins.
        let arguments =
            format!("run dam.toml --preview --adapter nonesuch --set liquid.surface=markers --set output.{off}=false");
        let told = text(&cutwater(&both, &arguments).output().unwrap().stderr);
        let expected = format!("the pictures lack the {missing}: turn output.{off}");
        assert!(told.contains(&expected), "{told}");
    }
}

#[test]
fn a_fixed_step_too_long_is_told() {
    let folder = folder(DAM);
    let fast = "run dam.toml --backend cpu --frames 1 --set liquid.region[0].velocity=[12,0,0] --set time.fixed_step=0.041666666666666664";
    let told = String::from_utf8(ends(cutwater(&folder, fast), 0).stderr).unwrap();
    assert_has(&told, &["in 1 of 1 sub-steps the fastest point crossed more than 3 cells"]);
    assert_eq!(column(&folder.path().join("out/dam/steps.csv"), "dt_floored"), [1.0]);
}

/// As before a `head -1`: who reads has enough after a line, the run goes on.
#[test]
fn a_reader_that_leaves_does_not_end_a_run() {
    use std::io::{BufRead, BufReader};

    let folder = folder(DAM);
    let mut child =
        cutwater(&folder, "run dam.toml --backend cpu").stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let mut line = String::new();
    let mut reader = BufReader::new(child.stdout.take().unwrap());
    reader.read_line(&mut line).unwrap();
    drop(reader);
    assert!(line.starts_with("frame 1 of 6"), "{line}");
    assert_eq!(child.wait().unwrap().code(), Some(0));
    let manifest = manifest(&folder.path().join("out/dam"));
    assert_eq!(manifest["progress"]["status"], "finished");
}

/// A disk without room ends no work either; that lines are missing is told.
#[cfg(target_os = "linux")]
#[test]
fn lines_without_room_are_told_at_the_end() {
    let folder = folder(DAM);
    for arguments in ["schema", "plan dam.toml --backend cpu", "run dam.toml --backend cpu --frames 2 --scale 0.5"] {
        let full = fs::File::options().write(true).open("/dev/full").unwrap();
        let mut command = cutwater(&folder, arguments);
        command.stdout(full);
        let message = text(&ends(command, 2).stderr);
        assert_has(&message, &["error: cannot write standard output: ", "cure: "]);
    }
    let manifest = manifest(&folder.path().join("out/dam"));
    assert_eq!(manifest["progress"]["status"], "finished");
}

#[cfg(unix)]
#[test]
fn an_interrupted_run_keeps_what_it_has() {
    use std::time::{Duration, Instant};

    let folder = folder(DAM);
    let mut child = cutwater(&folder, "run dam.toml --backend cpu --set time.duration=1000")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let run = folder.path().join("out/dam");
    let clock = Instant::now();
    let limit = Duration::from_secs(60);
    while !run.join("frames/dam_000001.vtp").exists() && clock.elapsed() < limit {
        std::thread::sleep(Duration::from_millis(20));
    }
    let signal = Command::new("sh").args(["-c", &format!("kill -INT {}", child.id())]).status().unwrap();
    assert!(signal.success(), "the run has ended by itself");
    let ended = loop {
        match child.try_wait().unwrap() {
            Some(status) => break status,
            None if clock.elapsed() > 2 * limit => {
                child.kill().unwrap();
                panic!("the run goes on");
            }
            None => std::thread::sleep(Duration::from_millis(20)),
        }
    };
    assert_eq!(ended.code(), Some(130));
    let manifest = manifest(&run);
    assert_eq!(manifest["progress"]["status"], "interrupted");
    let written = manifest["progress"]["frames_written"].as_array().unwrap().len();
    assert!(written >= 2, "{manifest}");
    // Two frame files and the series; every sub-step that was done has its row.
    assert_eq!(list(&run.join("frames")).len(), 2 * written + 2);
    let rows = column(&run.join("steps.csv"), "step").len();
    assert!(rows >= written - 1, "{rows} rows");
    // The program that failed says where to look, and the pictures of what is there can be drawn.
    says(&folder, "preview out/dam");
}

/// nohup, `trap '' HUP` and the background jobs of scripts start programs with signals ignored, and mean it.
#[cfg(target_os = "linux")]
#[test]
fn signals_ignored_at_the_start_stay_ignored() {
    use std::time::{Duration, Instant};

    use nix::sys::signal::{Signal, kill};
    use nix::unistd::Pid;

    const LONG: &str = "dam.toml --backend cpu --set time.duration=1000";
    let run = (format!("run {LONG}"), "out/dam");
    let sweep = (format!("sweep {LONG} --set time.cfl=1"), "out/dam_sweep/duration=1000_cfl=1");
    for (ignored, (arguments, run)) in
        [(Signal::SIGHUP, &run), (Signal::SIGINT, &run), (Signal::SIGHUP, &sweep), (Signal::SIGINT, &sweep)]
    {
        let case = format!("{ignored}, {arguments}");
        let folder = folder(DAM);
        let mut child = Command::new("sh")
            .args(["-c", "trap '' \"$1\"; shift; exec \"$@\"", "sh"])
            .arg(&ignored.as_str()[3..])
            .arg(env!("CARGO_BIN_EXE_cutwater"))
            .args(arguments.split_whitespace())
            .current_dir(folder.path())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let id = Pid::from_raw(child.id() as i32);
        let run = folder.path().join(run);
        let clock = Instant::now();
        let wait_for = |frame: usize| {
            while !run.join(format!("frames/dam_{frame:06}.vtp")).exists() {
                assert!(clock.elapsed().as_secs() < 60, "{case}: no frame {frame}");
                std::thread::sleep(Duration::from_millis(20));
            }
        };
        wait_for(1);
        let written = list(&run.join("frames")).len();
        kill(id, ignored).unwrap();
        // One of the files is the series.
        wait_for(written + 1);
        assert_eq!(child.try_wait().unwrap(), None, "{case}");
        // Other signals end it, and with it the runs of a sweep, which ignore what the sweep ignores.
        kill(id, Signal::SIGTERM).unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(130), "{case}");
        assert_eq!(manifest(&run)["progress"]["status"], "interrupted");
    }
}

/// A limit for file sizes is an error with its cure, not a signal that ends the program.
#[cfg(target_os = "linux")]
#[test]
fn a_file_size_limit_is_told() {
    let folder = folder(DAM);
    let mut command = Command::new("sh");
    command
        .args(["-c", "ulimit -f 8; exec \"$@\"", "sh"])
        .arg(env!("CARGO_BIN_EXE_cutwater"))
        .args(["run", "dam.toml", "--backend", "cpu"])
        .current_dir(folder.path());
    let message = text(&ends(command, 2).stderr);
    assert_has(&message, &["error: cannot write out/dam/", "ulimit -f unlimited"]);
}

/// Names with any character and of any length: either all files are well-formed and the series names what is there, or the name is
/// refused before anything is written.
#[test]
fn names_of_scenes_make_whole_files_or_are_refused() {
    // One below the limit fits with all that is added to it.
    let moving = DAM.to_owned()
        + "[[obstacle]]\nbox = { min = [0.8, 0.2, 0.1], max = [1, 0.6, 0.4] }\nkeyframes = [{ t = 0 }, { t = 1, translate = [0.1, 0, 0] }]\n";
    let longest = "x".repeat(225);
    for name in [
        "a & b",
        "x<y>",
        "it's \"it\"",
        "100%",
        "sloshing.v2",
        "Überlauf",
        "tank #3",
        "run;rm",
        "-dash",
        "日本語",
        "a%06d",
        ".hidden",
        &longest,
    ] {
        let folder = tempfile::tempdir().unwrap();
        let file = format!("./{name}.toml");
        fs::write(folder.path().join(&file), &moving).unwrap();
        let mut command = cutwater(&folder, "run --backend cpu --scale 0.5 --frames 1 --preview");
        command.arg(&file);
        ends(command, 0);
        let frames = folder.path().join("out").join(name).join("frames");
        for kind in ["markers", "obstacles"] {
            let series = fs::read_to_string(frames.join(format!("{name}_{kind}.pvd"))).unwrap();
            let series = roxmltree::Document::parse(&series).unwrap();
            let named: Vec<&str> = series.descendants().filter_map(|node| node.attribute("file")).collect();
            assert_eq!(named.len(), 2, "{name}");
            assert!(named.iter().all(|file| frames.join(file).is_file()), "{named:?}");
        }
    }
    for (name, cure) in [
        ("new\nline", "control characters"),
        ("a\tb", "control characters"),
        ("bell\u{7}", "control characters"),
        (&*"x".repeat(226), "at most 225 bytes"),
        (&*"ü".repeat(113), "at most 225 bytes"),
        (".", "rename the file"),
        ("..", "rename the file"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let file = format!("./{name}.toml");
        fs::write(folder.path().join(&file), DAM).unwrap();
        let mut command = cutwater(&folder, "run --backend cpu --frames 0");
        command.arg(&file);
        let message = text(&ends(command, 2).stderr);
        assert!(message.contains(cure), "{name:?}: {message}");
        assert!(message.lines().count() == 2, "{name:?}: {message}");
        assert_eq!(list(folder.path()).len(), 1, "{name:?}: {message}");
    }
    // A folder of the user's.
    let folder = folder(DAM);
    let message = complains(&folder, &format!("run dam.toml --backend cpu --frames 0 --out {}", "y".repeat(256)), 2);
    assert!(message.contains("too long"), "{message}");
}

/// A level with a source, a sink and an open side: planned and run on the device.
#[test]
fn a_level_that_exchanges_liquid_runs_on_the_gpu() {
    let Some(_) = gpu() else { return };
    let flows = "[[source]]\nbox = { min = [0.6, 0.6, 0.1], max = [0.8, 0.8, 0.3] }\nvelocity = [0, -1, 0]\n\
                 [[sink]]\nbox = { min = [0.0, 0.3, 0.0], max = [0.2, 0.7, 0.5] }\n";
    let folder = folder(&format!("{DAM}{flows}"));
    let level = "--set liquid.surface=level --set domain.open=[\"+x\"]";
    let plan = says(&folder, &format!("plan dam.toml {level}"));
    for kernel in ["fill_sources", "sink_volumes", "limit_targets"] {
        assert!(plan.contains(kernel), "{plan}");
    }
    says(&folder, &format!("run dam.toml {level} --frames 2"));
    let table = folder.path().join("out/dam/steps.csv");
    for name in ["volume_emitted", "volume_sunk", "markers_emitted"] {
        let sum: f64 = column(&table, name).iter().sum();
        assert!(sum > 0.0, "{name}");
    }
}
