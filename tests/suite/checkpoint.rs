//! Checkpoints, and runs that go on from them.

use std::fs::{self, File};
use std::io::Cursor;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use cutwater::output::FolderLock;
use cutwater::output::checkpoint::Checkpoint;
use cutwater::output::manifest::{Manifest, RunOptions};
use cutwater::scene::Scene;
use cutwater::sim::{self, Backend, Options, Progress, Simulation};
use cutwater::state::{Carried, State};
use tempfile::TempDir;
use zip::write::SimpleFileOptions;
use zip::{ZipArchive, ZipWriter};

use crate::common::{Random, adapter, assert_has, gpu, scene_from as scene};
use crate::kills::{Run, assert_same, contents};
use crate::output::python;

const POOL: &str = r#"# A pool with all that moves: a light ball that rises, a heavy one that spins onto a post, a plate that is carried.
[domain]
size = [1, 1, 1]
cells = [12, 12, 12]
[time]
duration = 1
frames_per_second = 30
[[liquid.region]]
box = { min = [0, 0, 0], max = [1, 0.55, 1] }
velocity = [0.5, 0, -0.3]
[[obstacle]]
box = { min = [0.57, 0.0, 0.35], max = [0.83, 0.26, 0.62] }
[[solid]]
name = "light"
mesh = { sphere = { radius = 0.15, cell_size = 0.1 } }
placement = { translate = [0.31, 0.34, 0.52] }
density = 300
young = 1e5
poisson = 0.35
damping = { mass = 0.2, stiffness = 0.01 }
[[solid]]
name = "heavy"
mesh = { sphere = { radius = 0.12, cell_size = 0.1 } }
placement = { translate = [0.7, 0.39, 0.47] }
initial = { spin = [3, 0, 5], velocity = [0, -1, 0] }
density = 3000
young = 1e5
poisson = 0.35
[[solid]]
name = "plate"
mesh = { box = { size = [0.3, 0.1, 0.2], cells = [3, 1, 2] } }
placement = { translate = [0.3, 0.12, 0.2] }
density = 2000
young = 1e6
poisson = 0.4
[[solid.script]]
region = { box = { min = [0, 0, 0], max = [0.2, 1, 1] } }
keyframes = [{ t = 0 }, { t = 0.11, translate = [0.013, 0.1, 0] }, { t = 1, rotate = { axis = [0, 0, 1], degrees = 40 } }]
[[probe]]
name = "push"
force = { solid = "light" }
[[probe]]
name = "tip"
node = { solid = "plate", rest_point = [0.45, 0.12, 0.2] }
[[probe]]
name = "level"
height = { x = 0.9, z = 0.5 }
"#;

const GROWS: &str = r#"# A cube that starts at a thirtieth of its volume, and needs more room in every sub-step.
[domain]
size = [1, 1, 1]
cells = [12, 12, 12]
[time]
duration = 1
frames_per_second = 100
fixed_step = 0.01
[[liquid.region]]
box = { min = [0, 0, 0], max = [1, 0.7, 1] }
[[solid]]
name = "cube"
mesh = { box = { size = [0.5, 0.5, 0.5], cells = [3, 3, 3] } }
placement = { translate = [0.5, 0.4, 0.5] }
initial = { scale = 0.3 }
density = 1000
young = 2e5
poisson = 0.3
damping = { stiffness = 0.01 }
"#;

const DROPS: &str = r#"# Solids alone: one falls, one is carried.
[domain]
size = [1, 1, 1]
cells = [8, 8, 8]
[time]
duration = 1
[[obstacle]]
sphere = { centre = [0.5, 0.1, 0.5], radius = 0.25 }
[[solid]]
name = "falls"
mesh = { box = { size = [0.2, 0.2, 0.2], cells = [2, 2, 2] } }
placement = { translate = [0.45, 0.5, 0.5], rotate = { axis = [1, 2, 0], degrees = 31 } }
initial = { velocity = [0, -2, 0], spin = [0, 9, 3] }
density = 1000
young = 1e5
poisson = 0.3
[[solid]]
name = "hangs"
mesh = { box = { size = [0.1, 0.1, 0.3], cells = [1, 1, 3] } }
placement = { translate = [0.2, 0.8, 0.5] }
density = 1000
young = 1e5
poisson = 0.3
[[solid.script]]
region = { box = { min = [0, 0, 0], max = [1, 1, 0.4] } }
keyframes = [{ t = 0.01 }, { t = 0.3, translate = [0.1, 0.07, 0] }]
[[probe]]
name = "ball"
solid = { name = "falls" }
"#;

/// A dam break that fills its ground, for the program.
const DAM: &str = r#"# A small dam break.
[domain]
size = [1.5, 1.0, 0.5]
cells = [24, 16, 8]
[time]
duration = 0.25
[[liquid.region]]
box = { min = [0, 0, 0], max = [0.5, 0.75, 0.5] }
[[obstacle]]
box = { min = [1.0, 0.0, 0.1], max = [1.2, 0.3, 0.3] }
[[probe]]
name = "front"
front = { axis = "x" }
[output]
checkpoint_every = 2
"#;

/// A source that stops between the checkpoint and the end, and a sink.
const FLOWS: &str = r#"[[source]]
box = { min = [0.6, 0.7, 0.1], max = [0.8, 0.9, 0.3] }
velocity = [0, -1, 0]
start = 0.05
end = 0.26
[[sink]]
box = { min = [0.0, 0.5, 0.0], max = [0.1, 1.0, 0.5] }
"#;

/// Speeds that change at the checkpoint, and before and after it.
const SPEEDS: &str = r#"[[source]]
box = { min = [0.6, 0.7, 0.1], max = [0.8, 0.9, 0.3] }
velocity_keyframes = [{ t = 0.05, velocity = [0, 0, 0] }, { t = 0.2, velocity = [0, -1, 0] }, { t = 0.3, velocity = [0, -0.2, 0] }]
"#;

/// What a run goes on from is all there is: steps and sub-steps are the same to the bit, with or without an end in between.
fn goes_on(name: &str, scene: &Scene, backend: &Backend, steps: [usize; 2]) {
    let folder = tempfile::tempdir().unwrap();
    let mut whole = Simulation::new(scene, backend).unwrap();
    for _ in 0..steps[0] {
        whole.step().unwrap();
    }
    let options = RunOptions { backend: backend.name().to_owned(), frames: 9, scale: 1.0, overrides: Vec::new() };
    let manifest = Manifest::new(scene, options, None);
    let mut written = Checkpoint {
        state: whole.state().unwrap(),
        carried: whole.carried().unwrap(),
        steps_bytes: 12,
        probes_bytes: 34,
        manifest: manifest.with_solids(scene, whole.solids()).unwrap(),
    };
    written.write(folder.path()).unwrap();
    let read = Checkpoint::read(folder.path()).unwrap().unwrap();
    assert!(read == written, "{name}");
    let mut again = Simulation::new(scene, backend).unwrap();
    again.resume(&read.state, &read.carried).unwrap();
    let moment = |of: &Simulation| (of.state().unwrap(), of.carried().unwrap());
    assert!(moment(&again) == moment(&whole), "{name}: as it was put in place");
    for step in 0..steps[1] {
        let [a, b] = [&mut whole, &mut again].map(|simulation| {
            let report = simulation.step().unwrap();
            let told = (report.dt, report.liquid, report.solid, report.coupling);
            (told, simulation.probes().unwrap())
        });
        assert_eq!(a, b, "{name}: sub-step {step} after it went on");
    }
    assert!(moment(&again) == moment(&whole), "{name}");
}

/// Scenes with every state that there is.
fn cases() -> Vec<(&'static str, Scene, [usize; 2])> {
    let weak = ["liquid.surface=fixed", "solver.coupling=weak", "solver.precision=f32", "solver.tolerance=1e-5"];
    vec![
        ("all that moves, pressures of the last step", scene(POOL, &["solver.pressure_on_patches=gradient"]), [5, 4]),
        ("weak, single precision", scene(POOL, &weak), [3, 3]),
        ("more room, two-field", scene(GROWS, &["solver.formulation=two_field"]), [6, 3]),
        ("solids alone", scene(DROPS, &[]), [7, 5]),
        ("liquid alone", scene(DAM, &[]), [7, 5]),
        ("level", scene(DAM, &["liquid.surface=level", "time.duration=0.6"]), [16, 6]),
        (
            "level with a source, a sink and an open side",
            scene(&format!("{DAM}{FLOWS}"), &["liquid.surface=level", "domain.open=[\"+x\"]", "time.duration=0.6"]),
            [20, 10],
        ),
        ("markers, a source over time", scene(&format!("{DAM}{SPEEDS}"), &["time.duration=0.6"]), [14, 8]),
        (
            "level, a source over time",
            scene(&format!("{DAM}{SPEEDS}"), &["liquid.surface=level", "time.duration=0.6"]),
            [14, 8],
        ),
    ]
}

#[test]
fn the_f64_path_goes_on_to_the_bit() {
    for (name, scene, steps) in cases() {
        goes_on(name, &scene, &Backend::Cpu, steps);
    }
}

#[test]
fn the_gpu_path_goes_on_to_the_bit() {
    let Some(_) = gpu() else { return };
    for (name, scene, steps) in cases() {
        goes_on(name, &scene, &Backend::Gpu(adapter()), steps);
    }
}

/// A checkpoint of a few cells, in a folder.
fn small() -> (TempDir, Checkpoint) {
    let scene = scene(DAM, &["domain.cells=[6, 4, 2]"]);
    let mut simulation = Simulation::new(&scene, &Backend::Cpu).unwrap();
    simulation.step().unwrap();
    let options = RunOptions { backend: "cpu".to_owned(), frames: 6, scale: 1.0, overrides: Vec::new() };
    let mut checkpoint = Checkpoint {
        state: simulation.state().unwrap(),
        carried: Carried::default(),
        steps_bytes: 1,
        probes_bytes: 2,
        manifest: Manifest::new(&scene, options, None),
    };
    let folder = tempfile::tempdir().unwrap();
    checkpoint.write(folder.path()).unwrap();
    (folder, checkpoint)
}

/// Whatever bit is wrong, and wherever the file ends: it is refused by its name, or what is wrong does not count.
#[test]
fn damaged_checkpoints_are_refused() {
    let (folder, written) = small();
    let path = Checkpoint::path(folder.path());
    let whole = fs::read(&path).unwrap();
    let mut refused = 0;
    let mut read = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        match Checkpoint::read(folder.path()) {
            Ok(found) => assert!(found == Some(written.clone()), "another state was read"),
            Err(error) => {
                let message = error.to_string();
                assert!(message.contains("checkpoint.npz: "), "{message}");
                assert!(message.contains("--overwrite"), "{message}");
                assert_eq!(error.exit_code(), 2);
                refused += 1;
            }
        }
    };
    let mut random = Random(6);
    for _ in 0..600 {
        let mut bytes = whole.clone();
        let at = random.bits() as usize % bytes.len();
        bytes[at] ^= 1 << (random.bits() % 8);
        read(&bytes);
    }
    // The directory is at the end.
    for at in whole.len() - 400..whole.len() {
        let mut bytes = whole.clone();
        bytes[at] ^= 1 << (at % 8);
        read(&bytes);
    }
    for share in 0..100 {
        read(&whole[..whole.len() * share / 100]);
    }
    read(&whole[..whole.len() - 1]);
    assert!(refused > 700, "{refused} refused");
}

#[test]
fn checkpoints_of_other_numbers_are_refused() {
    let (folder, checkpoint) = small();
    let refused = |change: &dyn Fn(&mut Checkpoint), expected: &[&str]| {
        let mut broken = checkpoint.clone();
        change(&mut broken);
        broken.write(folder.path()).unwrap();
        let message = Checkpoint::read(folder.path()).unwrap_err().to_string();
        for part in expected {
            assert!(message.contains(part), "{message}");
        }
    };
    refused(&|checkpoint| checkpoint.state.velocity[1][3] = f64::NAN, &["velocity_y", "number 3 is NaN"]);
    refused(&|checkpoint| checkpoint.state.dt_last = f64::INFINITY, &["dt_last", "inf"]);
    // And what the file cannot know is refused where the state is put in place.
    let scene = scene(DAM, &["domain.cells=[6, 4, 2]"]);
    let mut simulation = Simulation::new(&scene, &Backend::Cpu).unwrap();
    let mut refused = |state: State| {
        let error = simulation.resume(&state, &Carried::default()).unwrap_err();
        assert!(error.to_string().contains("does not fit this scene"), "{error}");
    };
    let good = || checkpoint.state.clone();
    refused(State { active: Vec::new(), ..good() });
    refused(State { node_velocity: vec![[0.0; 3]; 2], ..good() });
    refused(State { time: 7.0, ..good() });
    refused(State { frame: 3, ..good() });
}

/// Copies a .npz with one array in place of another, or without it.
fn exchange(path: &Path, array: &str, by: Option<&str>) {
    let mut from = ZipArchive::new(File::open(path).unwrap()).unwrap();
    let mut to = ZipWriter::new(Cursor::new(Vec::new()));
    let names: Vec<String> = from.file_names().map(|name| name.unwrap().into_owned()).collect();
    for name in names {
        let mut source = name.clone();
        if name == format!("{array}.npy") {
            let Some(by) = by else { continue };
            source = format!("{by}.npy");
        }
        to.start_file(name, SimpleFileOptions::default()).unwrap();
        std::io::copy(&mut from.by_name(&source).unwrap(), &mut to).unwrap();
    }
    let bytes = to.finish().unwrap().into_inner();
    fs::write(path, bytes).unwrap();
}

/// Files that are whole, and not what they should be.
#[test]
fn checkpoints_of_other_arrays_are_refused() {
    for (array, by, expected) in [
        ("dt_last", None, "array \"dt_last\": is missing"),
        ("format", None, "array \"format\": is missing"),
        (
            "velocity_x",
            Some("pressure"),
            "\"velocity_x\": is '<f8' of shape [2, 4, 6] instead of numbers (<f4 or <f8) of shape [2, 4, 7]",
        ),
        ("markers", Some("pressure"), "shape [any, 3]"),
        ("active", Some("pressure"), "marks (|b1) of shape [2, 4, 6]"),
        ("step", Some("time"), "a count (<u8, shape [])"),
        ("time", Some("markers"), "numbers (<f4 or <f8) of shape []"),
        ("manifest", Some("format"), "array \"manifest\": "),
        ("cutwater", Some("active"), "instead of bytes"),
        ("cutwater", Some("format"), "was written by cutwater 6 (format 6), and this is"),
    ] {
        let (folder, _) = small();
        exchange(&Checkpoint::path(folder.path()), array, by);
        let message = Checkpoint::read(folder.path()).unwrap_err().to_string();
        assert!(message.contains(expected), "{array}: {message}");
        assert!(message.contains("cure: "), "{message}");
    }
}

/// The arrays as numpy finds them.
#[test]
fn numpy_opens_checkpoints() {
    let Some(python) = python() else { return };
    let (folder, checkpoint) = small();
    let script = "import json, sys, numpy
z = numpy.load(sys.argv[1])
m = json.loads(bytes(z['manifest']))
nx, ny, nz = m['cells']
assert z['velocity_x'].shape == (nz, ny, nx + 1) and z['velocity_z'].shape == (nz + 1, ny, nx)
assert z['active'].dtype == bool and z['markers'].shape[1] == 3 and z['velocity_x'].dtype == 'f8'
print(bytes(z['cutwater']).decode(), int(z['step']), repr(float(z['time'])), len(z['markers']), int(z['active'].sum()))
print(repr(float(z['velocity_y'][1, 2, 3])), float(z['pressure'].max() > 0))
";
    let output = Command::new(python).args(["-c", script]).arg(Checkpoint::path(folder.path())).output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{told}");
    let state = &checkpoint.state;
    let active = state.active.iter().filter(|active| **active).count();
    let (nx, ny) = (6, 5);
    let expected = format!(
        "{} {} {:?} {} {active}\n{:?} 1.0\n",
        env!("CARGO_PKG_VERSION"),
        state.step,
        state.time,
        state.markers.len(),
        state.velocity[1][3 + nx * (2 + ny)],
    );
    assert_eq!(String::from_utf8(output.stdout).unwrap(), expected);
}

/// A folder with `dam.toml`.
fn dam() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("dam.toml"), DAM).unwrap();
    folder
}

const ON_CPU: &str = "run dam.toml --backend cpu --scale 0.5";

fn on_cpu(folder: &TempDir) -> Run<'_> {
    Run { folder: folder.path(), arguments: ON_CPU }
}

/// Runs a command to its end, which must have this exit code: what it complains about.
fn complains(mut command: Command, code: i32) -> String {
    let output: Output = command.output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{command:?}: {told}");
    assert!(!told.contains("panicked"), "{told}");
    told
}

fn progress(run: &Path) -> cutwater::output::manifest::Progress {
    Manifest::read(run).unwrap().progress
}

#[test]
fn killed_runs_go_on_to_the_bit() {
    let folder = dam();
    let run = Run { folder: folder.path(), arguments: "run dam.toml --backend cpu" };
    let killed = run.killed(3, &mut Random(60));
    assert_eq!(killed.kills, 3);
    assert!(killed.runs >= 1, "{killed:?}");
}

/// In the middle of a frame, by either signal; and on the GPU, where there is one.
#[cfg(unix)]
#[test]
fn interrupted_runs_go_on_to_the_bit() {
    let folder = dam();
    let backends: &[&str] = match gpu() {
        Some(_) => &["cpu", "gpu"],
        None => &["cpu"],
    };
    for backend in backends {
        let arguments = format!("run dam.toml --backend {backend} --set time.cfl=0.5");
        let run = Run { folder: folder.path(), arguments: &arguments };
        let wanted = contents(&run.whole(&format!("whole_{backend}"), ""));
        for signal in ["INT", "TERM"] {
            let out = format!("{backend}_{signal}");
            let path = folder.path().join(&out);
            let mut child = run.command(&out, "").stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
            while !path.join("frames/dam_000001.vtp").exists() {
                std::thread::sleep(Duration::from_millis(2));
            }
            let sent = format!("kill -{signal} {}", child.id());
            assert!(Command::new("sh").args(["-c", &sent]).status().unwrap().success());
            assert_eq!(child.wait().unwrap().code(), Some(130));
            let interrupted = progress(&path);
            assert!(interrupted.frames_written.len() < 7, "{interrupted:?}");
            let state = Checkpoint::read(&path).unwrap().unwrap().state;
            assert!(state.frame >= 1, "{}", state.frame);
            run.whole(&out, "--resume");
            assert_same(&contents(&path), &wanted);
        }
    }
}

/// In the middle of a frame: the manifest has the sub-steps of the table, and the time of the last.
#[test]
fn an_interrupted_run_tells_all_its_sub_steps() {
    let scene = scene(DAM, &["domain.cells=[6, 4, 2]", "time.frames_per_second=20", "time.fixed_step=0.0125"]);
    let folder = tempfile::tempdir().unwrap();
    let options = Options {
        backend: Backend::Cpu,
        out: folder.path().join("out"),
        frames: None,
        overwrite: false,
        keep_going: false,
        resume: false,
    };
    let interrupt = AtomicBool::new(false);
    let mut told = Vec::new();
    let mut listen = |of: &Progress| {
        told.push((of.frame, of.time));
        interrupt.store(told.len() == 7, Ordering::Relaxed);
    };
    let error = sim::run(&scene, &options, &mut listen, &interrupt).unwrap_err();
    assert_eq!(error.exit_code(), 130);
    assert_eq!(told.len(), 7);
    let [(before, _), (frame, time)] = told[5..] else { panic!("{told:?}") };
    assert_eq!(before, frame, "no frame ends there: {told:?}");
    let progress = progress(&options.out);
    assert_eq!((progress.steps, progress.time), (7, time));
    let table = fs::read_to_string(options.out.join("steps.csv")).unwrap();
    assert_eq!(table.lines().count(), 1 + 7);
    let checkpoint = Checkpoint::read(&options.out).unwrap().unwrap();
    assert_eq!(checkpoint.manifest.progress.steps, checkpoint.state.step);
}

#[test]
fn a_run_is_extended() {
    let folder = dam();
    let run = on_cpu(&folder);
    let every = "--set output.every=4";
    let wanted = contents(&run.whole("whole", &format!("--frames 10 {every}")));
    let part = run.whole("part", &format!("--frames 5 {every}"));
    assert_eq!(progress(&part).frames_written, [0, 4, 5]);
    // Nothing is left to do.
    let before = contents(&part);
    let output = run.command("part", &format!("--frames 5 {every} --resume")).output().unwrap();
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success() && said.contains("already finished"), "{said}");
    assert_same(&contents(&part), &before);
    // The picture of a frame goes with it, that of another and the animation stay.
    let pictures = part.join("preview");
    fs::create_dir(&pictures).unwrap();
    let names = ["dam.png", "dam_000004.png", "dam_000005.png"];
    for name in names {
        fs::write(pictures.join(name), "").unwrap();
    }
    run.whole("part", &format!("--frames 10 {every} --resume"));
    let left = names.map(|name| pictures.join(name).exists());
    assert_eq!(left, [true, true, false]);
    fs::remove_dir_all(&pictures).unwrap();
    assert_same(&contents(&part), &wanted);
    assert_eq!(progress(&part).frames_written, [0, 4, 8, 10]);
    let told = complains(run.command("part", &format!("--frames 7 {every} --resume")), 2);
    assert_has(&told, &["10 frames", "--frames"]);
}

/// A run that was killed before its first checkpoint begins again, as does one that is not there.
#[test]
fn a_run_without_a_checkpoint_begins_again() {
    let folder = dam();
    let run = on_cpu(&folder);
    let wanted = contents(&run.whole("whole", ""));
    let again = run.whole("again", "--resume");
    assert_same(&contents(&again), &wanted);
    fs::remove_file(Checkpoint::path(&again)).unwrap();
    let manifest = again.join("manifest.json");
    let text = fs::read_to_string(&manifest).unwrap();
    fs::write(&manifest, text.replace("\"finished\"", "\"running\"")).unwrap();
    fs::write(again.join("frames/.dam_000003.vtp.partial"), "half").unwrap();
    fs::write(again.join(".checkpoint.npz.partial"), "half").unwrap();
    run.whole("again", "--resume");
    assert_same(&contents(&again), &wanted);
    // Off: none is written, and a run that has ended has nothing to go on from.
    let off = "--set output.checkpoint_every=0";
    let none = run.whole("off", off);
    assert!(!Checkpoint::path(&none).exists());
    let told = complains(run.command("off", &format!("{off} --resume --frames 9")), 2);
    assert!(told.contains("no checkpoint.npz"), "{told}");
}

#[test]
fn what_is_not_the_run_is_not_gone_on_with() {
    let folder = dam();
    let run = on_cpu(&folder);
    let path = run.whole("out", "--frames 3");
    let before = contents(&path);
    let refused = |run: &Run, more: &str, expected: &[&str]| {
        let told = complains(run.command("out", more), 2);
        for part in expected.iter().chain(&["cure: "]) {
            assert!(told.contains(part), "{more}: {told}");
        }
    };
    refused(&run, "", &["earlier run", "--resume", "--overwrite"]);
    let told = complains(run.command("out", "--resume --overwrite"), 2);
    assert!(told.contains("cannot be used with"), "{told}");
    refused(&run, "--resume --set liquid.density=900", &["liquid.density is new: 900", "--set"]);
    for (arguments, expected) in [
        ("run dam.toml --scale 0.5 --adapter software", "--backend cpu"),
        ("run dam.toml --backend cpu", "--scale 0.5"),
    ] {
        let other = Run { folder: folder.path(), arguments };
        refused(&other, "--resume", &["checkpoint.npz: the run is", expected]);
    }
    let file = folder.path().join("dam.toml");
    fs::write(&file, DAM.replace("0.75", "0.7")).unwrap();
    refused(&run, "--resume", &["checkpoint.npz", "of another scene"]);
    fs::write(&file, DAM).unwrap();
    // Another run's manifest beside the checkpoint.
    let manifest = path.join("manifest.json");
    let text = fs::read_to_string(&manifest).unwrap();
    fs::write(&manifest, text.replace("\"0.1.0\"", "\"0.0.9\"")).unwrap();
    refused(&run, "--resume", &["manifest.json", "0.0.9"]);
    fs::write(&manifest, text).unwrap();
    let checkpoint = Checkpoint::path(&path);
    let whole = fs::read(&checkpoint).unwrap();
    fs::write(&checkpoint, &whole[..whole.len() / 2]).unwrap();
    refused(&run, "--resume --frames 4", &["checkpoint.npz: is no intact .npz"]);
    fs::write(&checkpoint, &whole).unwrap();
    for (table, expected) in [("steps.csv", "shorter"), ("probes.csv", "shorter")] {
        let table = path.join(table);
        let text = fs::read(&table).unwrap();
        fs::write(&table, &text[..text.len() - 1]).unwrap();
        refused(&run, "--resume --frames 4", &[expected]);
        fs::write(&table, &text).unwrap();
    }
    let names = |run: &Path| contents(run).into_keys().collect::<Vec<_>>();
    assert_eq!(names(&path), before.keys().cloned().collect::<Vec<_>>());
    // Whatever was refused has left the run as it was: it still goes on.
    run.whole("out", "--resume");
    assert_same(&contents(&path), &contents(&run.whole("whole", "")));
}

/// A checkpoint says by itself what run it is of; one without its manifest is still somebody's.
#[test]
fn a_lost_manifest_does_not_lose_the_run() {
    let folder = dam();
    let run = on_cpu(&folder);
    let wanted = contents(&run.whole("whole", ""));
    let path = run.whole("out", "--frames 3");
    for broken in [None, Some("{\"my\": 1}")] {
        let manifest = path.join("manifest.json");
        match broken {
            None => fs::remove_file(&manifest).unwrap(),
            Some(text) => fs::write(&manifest, text).unwrap(),
        }
        for how in ["", "--overwrite"] {
            let told = complains(run.command("out", how), 2);
            assert_has(&told, &["earlier run", "manifest.json"]);
            // No cure that is refused, too.
            let (_, cure) = told.split_once("cure: ").unwrap();
            assert!(cure.contains("--resume") && !cure.contains("--overwrite"), "{told}");
        }
    }
    run.whole("out", "--resume");
    assert_same(&contents(&path), &wanted);
}

/// Clearing a folder for another run is as likely to be killed as anything.
#[test]
fn a_folder_that_was_half_cleared_is_none_of_a_whole_run() {
    let folder = dam();
    let run = on_cpu(&folder);
    let wanted = contents(&run.whole("whole", ""));
    let path = run.whole("out", "");
    // The last of what is removed cannot be.
    fs::create_dir_all(path.join("preview/dam_1.png/held")).unwrap();
    let told = complains(run.command("out", "--overwrite"), 2);
    assert_has(&told, &["cannot write", "dam_1.png"]);
    assert!(!path.join("frames").exists() && !Checkpoint::path(&path).exists());
    assert!(progress(&path).frames_written.is_empty());
    fs::remove_dir_all(path.join("preview")).unwrap();
    run.whole("out", "--resume");
    assert_same(&contents(&path), &wanted);
}

#[test]
fn two_processes_do_not_write_into_one_folder() {
    let folder = dam();
    let run = on_cpu(&folder);
    let path = run.whole("out", "--frames 2");
    let held = FolderLock::take(&path).unwrap();
    for more in ["", "--overwrite", "--resume"] {
        let told = complains(run.command("out", more), 2);
        assert!(told.contains("another process writes"), "{told}");
    }
    drop(held);
    assert!(!path.join(".lock").exists());
    // What a killed process leaves of it holds nobody up.
    fs::write(path.join(".lock"), "").unwrap();
    run.whole("out", "--resume");
    assert!(!path.join(".lock").exists());
}

/// A simulation that fails leaves its last whole frame, and goes on from there to the same end.
#[test]
fn a_run_that_fails_keeps_its_last_good_state() {
    let away = "keyframes = [{ t = 0.26 }, { t = 0.3, translate = [0.1, 1e39, 0] }]";
    let text = DROPS.replace("keyframes = [{ t = 0.01 }, { t = 0.3, translate = [0.1, 0.07, 0] }]", away);
    assert!(text.contains(away));
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("dam.toml"), text).unwrap();
    let run = Run { folder: folder.path(), arguments: "run dam.toml --backend cpu" };
    let told = complains(run.command("out", ""), 4);
    assert!(told.contains("--resume"), "{told}");
    let path = folder.path().join("out");
    let failed = progress(&path);
    let last = *failed.frames_written.last().unwrap();
    let state = Checkpoint::read(&path).unwrap().unwrap().state;
    assert!(state.frame == last && last >= 5, "{} {last}", state.frame);
    assert!(failed.error.is_some_and(|error| error.contains("step ")));
    let before = contents(&path);
    complains(run.command("out", "--resume"), 4);
    assert_same(&contents(&path), &before);
}

/// Files may not grow beyond some length: the table of the sub-steps gets there while frames are still written. What is there is whole, and
/// the run goes on when there is room.
#[cfg(unix)]
#[test]
fn a_full_disk_loses_nothing() {
    let folder = dam();
    let run = Run {
        folder: folder.path(),
        arguments: "run dam.toml --backend cpu --scale 0.5 --set output.checkpoint_every=1 --set time.duration=0.24 --set time.frames_per_second=25 --set time.fixed_step=0.00125",
    };
    let whole = run.whole("whole", "");
    let wanted = contents(&whole);
    let length = |name: &str| fs::metadata(whole.join(name)).unwrap().len();
    let frame = length("frames/dam_000006.vtp").max(length("checkpoint.npz"));
    // Checkpoints of earlier frames compress a little less.
    let blocks = frame.div_ceil(1024) + 4;
    assert!(length("steps.csv") > 1024 * blocks, "nothing fills up: {blocks} kB");
    let limited = |blocks: u64, more: &str| {
        let limited = format!(
            "trap '' XFSZ; ulimit -f {blocks}; exec {} {} {more}",
            env!("CARGO_BIN_EXE_cutwater"),
            run.arguments
        );
        let mut command = Command::new("bash");
        command.args(["-c", &limited]).current_dir(folder.path());
        complains(command, 2)
    };
    let told = limited(blocks, "--out out");
    for part in ["cannot write out/steps.csv", "cure: raise the limit", "--resume"] {
        assert!(told.contains(part), "{told}");
    }
    let path = folder.path().join("out");
    let before = progress(&path);
    let state = Checkpoint::read(&path).unwrap().unwrap().state;
    assert!(state.frame >= 1 && before.frames_written.contains(&state.frame), "{before:?}");
    run.whole("out", "--resume");
    assert_same(&contents(&path), &wanted);
    // Only the checkpoint is too large: nothing is left of it.
    let told = limited(24, "--out none --set output.particles=false");
    let lines = told.lines().count();
    assert!(told.contains("cannot write none/checkpoint.npz") && lines == 3, "{told}");
    let none = contents(&folder.path().join("none"));
    assert!(none.keys().all(|name| !name.contains("checkpoint")), "{none:?}");
}

/// Rounding differs between adapters: the run goes on, and both the user and the manifest are told.
#[test]
fn a_run_may_go_on_on_another_adapter() {
    let Some(_) = gpu() else { return };
    let folder = dam();
    let run = Run { folder: folder.path(), arguments: "run dam.toml --scale 0.5" };
    let path = run.whole("out", "--frames 2");
    let mut checkpoint = Checkpoint::read(&path).unwrap().unwrap();
    let adapter = checkpoint.manifest.adapter.as_mut().unwrap();
    let name = std::mem::replace(&mut adapter.name, "Another".to_owned());
    checkpoint.write(&path).unwrap();
    let told = complains(run.command("out", "--frames 4 --resume"), 0);
    assert!(told.contains("warning: the run began on Another ("), "{told}");
    for frames in ["4", "5"] {
        complains(run.command("out", &format!("--frames {frames} --resume")), 0);
        let manifest = Manifest::read(&path).unwrap();
        assert_eq!(manifest.adapter.unwrap().name, name);
        let [earlier] = &manifest.earlier_adapters[..] else {
            panic!("{:?}", manifest.earlier_adapters);
        };
        assert_eq!(earlier.adapter.as_ref().unwrap().name, "Another");
        assert_eq!(earlier.steps, checkpoint.state.step);
    }
}

#[test]
fn folders_that_cannot_be_written_are_told_before_anything_is_lost() {
    let folder = dam();
    let run = on_cpu(&folder);
    let mut places = vec!["dam.toml/out"];
    if cfg!(target_os = "linux") {
        places.push("/proc/cutwater");
    }
    for more in ["", "--resume"] {
        for place in &places {
            let told = complains(run.command(place, more), 2);
            let said = format!("cannot write {place}");
            assert_has(&told, &[&said, "cure: choose"]);
        }
    }
    // A folder in the way of a file: the checkpoint before stays.
    let path = run.whole("out", "--frames 2");
    let before = contents(&path);
    fs::create_dir(path.join(".checkpoint.npz.partial")).unwrap();
    let told = complains(run.command("out", "--resume --frames 4"), 2);
    assert!(told.contains("cannot write"), "{told}");
    fs::remove_dir(path.join(".checkpoint.npz.partial")).unwrap();
    assert!(contents(&path)["checkpoint.npz"] == before["checkpoint.npz"]);
    run.whole("out", "--resume");
    assert_same(&contents(&path), &contents(&run.whole("whole", "")));
}
