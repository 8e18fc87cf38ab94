//! `cutwater sweep`: settings, folders, the summary, and what a second invocation does.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use cutwater::measure::probe_statistics::statistics;
use cutwater::measure::sweep::{Axis, Options, Shard, Sweep};
use tempfile::TempDir;

use crate::cli::{DAM, complains, cutwater, ends, folder, list, manifest, says, text};
use crate::common::{assert_has, json};

/// Two frames of a small dam break, on the f64 path.
const SWEEP: &str = "sweep dam.toml --backend cpu --scale 0.5 --frames 1";

/// A column of the summary.
fn column(summary: &Path, name: &str) -> Vec<String> {
    let mut reader = csv::Reader::from_path(summary).unwrap();
    let at = reader.headers().unwrap().iter().position(|head| head == name);
    let at = at.unwrap_or_else(|| panic!("no column {name}"));
    reader.records().map(|row| row.unwrap()[at].to_owned()).collect()
}

#[test]
fn settings_are_read_with_their_brackets_and_quotes() {
    let values = |text: &str| text.parse::<Axis>().unwrap().values;
    assert_eq!(values("a.b=1,2"), ["1", "2"]);
    assert_eq!(values("a=[0,-9.81,0],[0,-1.62,0]"), ["[0,-9.81,0]", "[0,-1.62,0]"]);
    assert_eq!(values("a={ b = [1, 2], c = 3 }, 4"), ["{ b = [1, 2], c = 3 }", "4"]);
    assert_eq!(values(r#"a="x,y",'z,"w'"#), [r#""x,y""#, r#"'z,"w'"#]);
    assert_eq!(values(r#"a="x\",y""#), [r#""x\",y""#]);
    assert_eq!(" k.l =1".parse::<Axis>().unwrap().key, "k.l");
    for (setting, told) in [
        ("a", "no `=`"),
        ("a=", "empty value"),
        ("a=1,,2", "empty value"),
        ("a=1,2,", "empty value"),
        ("a=1,2,1", "the value 1 twice"),
        ("a=[1,2", "do not match"),
        ("a=1,2]", "do not match"),
        ("a=[1,2}", "do not match"),
        ("a=\"x", "do not match"),
    ] {
        let message = setting.parse::<Axis>().unwrap_err().to_string();
        assert_has(&message, &[told, "cure: "]);
    }
    assert_eq!("2/3".parse::<Shard>(), Ok(Shard { index: 2, count: 3 }));
    for shard in ["0/3", "4/3", "1", "1/0", "a/b", "-1/2", "1/2/3"] {
        assert!(shard.parse::<Shard>().is_err(), "{shard}");
    }
}

/// The names of the folders of a sweep of the small dam break.
fn names(settings: &[&str]) -> Vec<String> {
    let folder = folder(DAM);
    let options = Options {
        scene: folder.path().join("dam.toml"),
        without: Vec::new(),
        scale: 1.0,
        frames: None,
        backend: "cpu",
        out: folder.path().join("out"),
    };
    let axes = settings.iter().map(|setting| setting.parse().unwrap()).collect();
    let sweep = Sweep::new(axes, options).unwrap();
    assert!(!folder.path().join("out").exists(), "nothing is written by looking");
    sweep.runs.into_iter().map(|run| run.name).collect()
}

#[test]
fn folders_are_named_for_their_settings() {
    assert_eq!(names(&["liquid.density=800,1e3", "time.cfl=3"]), ["density=800_cfl=3", "density=1e3_cfl=3"]);
    let vectors = names(&["domain.gravity=[0,-9.81,0],[0, -1.62, 0]"]);
    assert_eq!(vectors, ["gravity=0,-9.81,0", "gravity=0,-1.62,0"]);
    // Keys that end alike keep as much as tells them apart.
    let alike = names(&["liquid.region[0].box.max=[0.5,0.5,0.5]", "liquid.region[0].box.min=[0,0,0]"]);
    assert_eq!(alike, ["max=0.5,0.5,0.5_min=0,0,0"]);
    let deep = names(&["probe[0].name=a", "camera.size=[64,64]", "liquid.region[0].velocity=[1,0,0]"]);
    assert_eq!(deep, ["name=a_size=64,64_velocity=1,0,0"]);
    // What the name cannot hold is told by a hash; values that differ by it alone stay apart.
    let lossy = names(&[
        "probe=[{ name = \"a b\", front = { axis = \"x\" } }],[{ name = \"a/b\", front = { axis = \"x\" } }],[]",
    ]);
    let hashed = lossy.iter().filter(|name| name.contains('~')).count();
    assert_eq!(hashed, 3, "{lossy:?}");
    assert!(lossy.iter().all(|name| !name.contains(['/', ' ', '"'])), "{lossy:?}");
    let case = names(&["liquid.surface=markers,MARKERS"]);
    assert_ne!(case[0].to_lowercase(), case[1].to_lowercase());
    let long = format!("probe[0].name={}", "x".repeat(300));
    let long = &names(&[&long])[0];
    assert!(long.len() < 170 && long.contains('~'), "{long}");
}

#[test]
fn a_sweep_goes_on_past_failures_and_makes_what_is_missing() {
    let folder = folder(DAM);
    let out = folder.path().join("out/dam_sweep");
    let summary = out.join("summary.csv");
    // The last height leaves no cell with liquid, which only the run finds; the last cfl is refused at once.
    let settings = "--set liquid.region[0].box.max=[0.5,0.75,0.5],[0.5,0.001,0.5] --set time.cfl=3,-1";
    let sweep = format!("{SWEEP} {settings} --jobs 2");
    let done = ends(cutwater(&folder, &sweep), 1);
    let (said, told) = (text(&done.stdout), text(&done.stderr));
    let names =
        ["max=0.5,0.75,0.5_cfl=3", "max=0.5,0.75,0.5_cfl=-1", "max=0.5,0.001,0.5_cfl=3", "max=0.5,0.001,0.5_cfl=-1"];
    for (name, end) in [
        (names[0], "finished, 1 frames in "),
        (names[1], "refused (exit code 2): dam.toml: --set time.cfl=-1: time.cfl: is -1; cure: "),
        (names[2], "failed (exit code 2): dam.toml:7: liquid.region: no cell"),
    ] {
        let line = said.lines().find(|line| line.contains(&format!("of 4: {name}: ")));
        let line = line.unwrap_or_else(|| panic!("{name}: {said}"));
        assert!(line.contains(end) || line.contains(&end.replace("dam.toml: --set", "--set")), "{line}");
    }
    for name in &names[1..] {
        assert!(told.contains(name), "{told}");
    }
    assert!(told.contains("3 of 4 runs did not finish"), "{told}");
    assert_eq!(column(&summary, "folder"), names);
    assert_eq!(column(&summary, "time.cfl"), ["3", "-1", "3", "-1"]);
    assert_eq!(column(&summary, "liquid.region[0].box.max")[2], "[0.5,0.001,0.5]");
    assert_eq!(column(&summary, "status"), ["finished", "refused", "failed", "refused"]);
    let record = json(fs::read(out.join(names[2]).join("sweep.json")).unwrap());
    assert_eq!(record["exit_code"], 2);
    assert_eq!(column(&summary, "exit_code"), ["0", "2", "2", "2"]);
    assert_eq!(column(&summary, "frames"), ["1", "", "", ""]);
    assert_eq!(column(&summary, "missed"), ["0", "", "", ""]);
    let number = |name: &str| column(&summary, name)[0].parse::<f64>().unwrap();
    assert!(number("sub_steps") >= 1.0 && number("seconds") > 0.0);
    assert!((1e-20..1e-8).contains(&number("worst_residual")));
    assert!((0.9..=1.0).contains(&number("volume_least")) && (1.0..1.1).contains(&number("volume_largest")));
    assert!(column(&summary, "problem")[2].contains("no cell"));
    let probes = out.join(names[0]).join("probes.csv");
    let fronts: Vec<f64> = column(&probes, "front").iter().map(|x| x.parse().unwrap()).collect();
    let (least, largest) =
        (fronts.iter().copied().fold(f64::MAX, f64::min), fronts.iter().copied().fold(0.0, f64::max));
    assert_eq!([number("front:least"), number("front:largest")], [least, largest]);
    assert_eq!(number("front:last"), *fronts.last().unwrap());
    assert!((least..=largest).contains(&number("front:mean")));
    let at = fronts.iter().position(|front| *front == largest).unwrap();
    assert_eq!(column(&summary, "front:largest_t")[0], column(&probes, "t")[at]);
    assert_eq!(column(&summary, "front:mean")[1..], ["", "", ""]);
    assert!(said.contains("summary: ") && said.lines().any(|line| line.starts_with("run  ")), "{said}");
    let run = out.join(names[0]);
    let log = fs::read_to_string(run.join("log.txt")).unwrap();
    assert_has(&log, &["\"run\"", "frame 1 of 1"]);
    assert_eq!(manifest(&run)["progress"]["status"], "finished");

    // Again: what is finished stays as it is, what is not is tried again.
    let before = fs::metadata(run.join("manifest.json")).unwrap().modified().unwrap();
    let said = text(&ends(cutwater(&folder, &sweep), 1).stdout);
    assert!(said.contains(", from an earlier sweep"), "{said}");
    assert_eq!(fs::metadata(run.join("manifest.json")).unwrap().modified().unwrap(), before);
    let log = fs::read_to_string(out.join(names[2]).join("log.txt")).unwrap();
    assert_eq!(log.matches("error: ").count(), 2, "{log}");

    // A folder that is gone is made anew, one whose run was killed is replaced.
    let good = format!("{SWEEP} --set liquid.region[0].box.max=[0.5,0.75,0.5] --set time.cfl=3,4");
    says(&folder, &good);
    let other = out.join("max=0.5,0.75,0.5_cfl=4");
    fs::remove_dir_all(&run).unwrap();
    let killed = fs::read_to_string(other.join("manifest.json")).unwrap();
    fs::write(other.join("manifest.json"), killed.replace("\"finished\"", "\"running\"")).unwrap();
    let status = says(&folder, &format!("{good} --list"));
    assert_has(&status, &["missing    max=0.5,0.75,0.5_cfl=3\nbroken_off max=0.5,0.75,0.5_cfl=4\n"]);
    assert_eq!(column(&summary, "status"), ["missing", "broken_off"]);
    says(&folder, &good);
    assert_eq!(column(&summary, "status"), ["finished", "finished"]);
    assert_eq!(manifest(&run)["progress"]["status"], "finished");
}

#[test]
fn runs_of_another_scene_are_kept_until_told() {
    let folder = folder(DAM);
    let sweep = format!("{SWEEP} --set time.cfl=3,4");
    says(&folder, &sweep);
    fs::write(folder.path().join("dam.toml"), DAM.replace("duration = 0.25", "duration = 0.5")).unwrap();
    let told = complains(&folder, &sweep, 2);
    let parts = ["cfl=3: the folder contains a run of another scene text", "--out", "--overwrite"];
    assert!(parts.iter().all(|part| told.contains(part)), "{told}");
    let summary = folder.path().join("out/dam_sweep/summary.csv");
    says(&folder, &format!("{sweep} --list"));
    assert_eq!(column(&summary, "status"), ["outdated", "outdated"]);
    says(&folder, &format!("{sweep} --overwrite"));
    assert_eq!(column(&summary, "status"), ["finished", "finished"]);
    // Other options make other runs, too.
    assert!(complains(&folder, &sweep.replace("--frames 1", "--frames 2"), 2).contains("other options"));
}

#[test]
fn shards_share_the_runs_and_the_summary() {
    let folder = folder(DAM);
    let sweep = format!("{SWEEP} --set time.cfl=2,3,4 --out shards");
    let summary = folder.path().join("shards/summary.csv");
    says(&folder, &format!("{sweep} --shard 2/2"));
    assert_eq!(column(&summary, "status"), ["missing", "finished", "missing"]);
    let said = says(&folder, &format!("{sweep} --shard 1/2"));
    assert!(said.contains("2 of 2: cfl=4: finished") && !said.contains("cfl=3"), "{said}");
    assert_eq!(column(&summary, "status"), ["finished"; 3]);
    // More jobs than runs: nothing to do is no failure.
    says(&folder, &format!("{sweep} --shard 4/4"));
    let told = complains(&folder, &format!("{sweep} --shard 0/2"), 2);
    assert!(told.contains("I from 1 to N"), "{told}");
}

#[test]
fn a_sweep_that_cannot_be_is_refused_before_anything_is_written() {
    let folder = folder(DAM);
    for (settings, told) in [
        ("--set time.clf=3,4", "unknown key"),
        ("--set time.cfl=0,-1", "time.cfl"),
        ("--set time.cfl=3 --set time.cfl=4", "in one --set"),
        ("--set time.cfl=3,3", "twice"),
        ("", "--set <KEY=V1,V2>"),
        ("--set time.cfl=3 --jobs 0", "--jobs"),
        ("--set time.cfl=3 --shard 1", "I from 1 to N"),
    ] {
        let message = complains(&folder, &format!("{SWEEP} {settings}"), 2);
        assert!(message.contains(told), "{settings}: {message}");
    }
    let mut many = String::new();
    for key in ["liquid.density", "liquid.seed", "time.cfl", "probe[0].name", "camera.fov", "output.every"] {
        many += &format!(" --set {key}=1,2,3,4,5,6,7");
    }
    assert!(complains(&folder, &format!("{SWEEP}{many}"), 2).contains("more than 100000 runs"));
    assert_eq!(list(folder.path()), ["dam.toml"]);
}

/// A run that another process holds is left to it.
#[test]
fn two_sweeps_at_once_do_not_meet() {
    let folder = folder(DAM);
    let run = folder.path().join("out/dam_sweep/cfl=3");
    fs::create_dir_all(&run).unwrap();
    let lock = File::create(run.join(".sweep.lock")).unwrap();
    lock.lock().unwrap();
    let done = ends(cutwater(&folder, &format!("{SWEEP} --set time.cfl=3,4")), 1);
    let (said, told) = (text(&done.stdout), text(&done.stderr));
    assert_has(&said, &["cfl=3: running in another process", "cfl=4: finished"]);
    assert_has(&told, &["1 of 2 runs did not finish: cfl=3 (running)"]);
    drop(lock);
    says(&folder, &format!("{SWEEP} --set time.cfl=3,4"));
}

fn wait_for(what: &str, limit: Duration, mut there: impl FnMut() -> bool) {
    let clock = Instant::now();
    while !there() {
        assert!(clock.elapsed() < limit, "{what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[cfg(unix)]
fn signal(id: u32, name: &str) {
    use nix::sys::signal::{Signal, kill};
    use nix::unistd::Pid;

    kill(Pid::from_raw(id as i32), name.parse::<Signal>().unwrap()).unwrap();
}

#[cfg(unix)]
fn start(folder: &TempDir) -> Child {
    let sweep = "sweep dam.toml --backend cpu --scale 0.5 --set time.duration=1000,1001 --jobs 2";
    let child = cutwater(folder, sweep).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    for name in ["duration=1000", "duration=1001"] {
        let frame = folder.path().join("out/dam_sweep").join(name).join("frames/dam_000001.vtp");
        wait_for("the runs begin", Duration::from_secs(60), || frame.exists());
    }
    child
}

/// What works in a test's folder, but for its sweep.
#[cfg(target_os = "linux")]
fn runs_in(folder: &TempDir) -> Vec<u32> {
    let here = folder.path().canonicalize().unwrap();
    let processes = fs::read_dir("/proc").unwrap().map(|entry| entry.unwrap().path());
    let of_run = |process: &PathBuf| {
        let command = fs::read_to_string(process.join("cmdline")).unwrap_or_default();
        command.split('\0').nth(1) == Some("run")
    };
    processes
        .filter(|process| fs::read_link(process.join("cwd")).is_ok_and(|cwd| cwd == here))
        .filter(of_run)
        .filter_map(|process| process.file_name()?.to_str()?.parse().ok())
        .collect()
}

#[cfg(unix)]
#[test]
fn an_interrupted_sweep_ends_its_runs_where_their_files_are_whole() {
    let folder = folder(DAM);
    let mut sweep = start(&folder);
    // Schedulers signal all processes of a job: with what the sweep passes on, a run gets it twice.
    #[cfg(target_os = "linux")]
    runs_in(&folder).into_iter().for_each(|id| signal(id, "SIGTERM"));
    signal(sweep.id(), "SIGTERM");
    wait_for("the sweep ends", Duration::from_secs(60), || sweep.try_wait().unwrap().is_some());
    assert_eq!(sweep.wait().unwrap().code(), Some(130));
    let out = folder.path().join("out/dam_sweep");
    assert_eq!(column(&out.join("summary.csv"), "status"), ["interrupted", "interrupted"]);
    assert_eq!(column(&out.join("summary.csv"), "exit_code"), ["130", "130"]);
    assert_eq!(manifest(&out.join("duration=1000"))["progress"]["status"], "interrupted");
}

/// Runs whose sweep was killed go on; a second sweep does not run beside them in the same folders.
#[cfg(target_os = "linux")]
#[test]
fn a_killed_sweep_leaves_its_runs_to_nobody_else() {
    let folder = folder(DAM);
    let mut sweep = start(&folder);
    signal(sweep.id(), "SIGKILL");
    sweep.wait().unwrap();
    let again = "sweep dam.toml --backend cpu --scale 0.5 --set time.duration=1000,1001 --list";
    let status = says(&folder, again);
    assert_eq!(status, "running    duration=1000\nrunning    duration=1001\n");
    let runs = runs_in(&folder);
    assert_eq!(runs.len(), 2);
    runs.into_iter().for_each(|id| signal(id, "SIGINT"));
    wait_for("the runs end", Duration::from_secs(60), || !says(&folder, again).contains("running"));
}

#[test]
fn means_weigh_sub_steps_and_extremes_have_their_times() {
    let times = [1.0, 1.5, 3.5, 4.0];
    let values = [Some(2.0), Some(-4.0), None, Some(6.0)];
    let found = statistics(&times, &values).unwrap();
    // (1 s of 2, 0.5 s of -4, 0.5 s of 6) over 2 s.
    assert_eq!(found, [-4.0, 1.5, 6.0, 4.0, 1.5, 6.0]);
    assert_eq!(statistics(&times, &[None; 4]), None);
    // The first of equal extremes.
    let found = statistics(&times, &[Some(1.0); 4]).unwrap();
    assert_eq!(found, [1.0, 1.0, 1.0, 1.0, 1.0, 1.0]);
}
