//! A run that has failed says so: solids that collapse, and liquid that is too fast, lost or of the wrong volume.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use cutwater::Error;
use cutwater::output::manifest::{Manifest, RunStatus};
use cutwater::scene::Scene;
use cutwater::sim::{self, Backend, Options, Summary};
use tempfile::TempDir;

use crate::cli::{cutwater, ends, text};

/// A cube as heavy as water under 6 to 18 cm of it, of E = 3 kPa: below 2 rho g h. It turns inside out within 0.3 s.
const SOFT: &str = "[domain]\nsize = [0.6, 0.4, 0.6]\ncells = [15, 10, 15]\n[time]\nduration = 1.2\nframes_per_second = 30\n[liquid]\nsurface = \"markers\"\n\
    [[liquid.region]]\nbox = { min = [0, 0, 0], max = [0.6, 0.24, 0.6] }\n\
    [[solid]]\nname = \"jelly\"\nmesh = { box = { size = [0.12, 0.12, 0.12], cells = [4, 4, 4] } }\n\
    placement = { translate = [0.3, 0.12, 0.3] }\ndensity = 1000\nyoung = 3e3\npoisson = 0.45\n";

struct Run {
    folder: TempDir,
    notices: Vec<String>,
    ended: Result<Summary, Error>,
}

impl Run {
    fn manifest(&self) -> Manifest {
        Manifest::read(&self.folder.path().join("out")).unwrap()
    }
}

fn run(scene: &Scene, frames: u64, keep_going: bool) -> Run {
    let folder = tempfile::tempdir().unwrap();
    let options = Options {
        backend: Backend::Cpu,
        out: folder.path().join("out"),
        frames: Some(frames),
        overwrite: false,
        resume: false,
        keep_going,
    };
    let mut notices = Vec::new();
    let mut listen = |progress: &sim::Progress| notices.extend_from_slice(progress.notices);
    let ended = sim::run(scene, &options, &mut listen, &AtomicBool::new(false));
    Run { folder, notices, ended }
}

fn soft(overrides: &[&str]) -> Scene {
    let overrides: Vec<String> = overrides.iter().map(|&of| of.to_owned()).collect();
    Scene::parse(Path::new("soft.toml"), SOFT, &overrides, 1.0).unwrap()
}

#[test]
fn a_solid_that_collapses_ends_the_run() {
    let scene = soft(&[]);
    let failed = run(&scene, 36, false);
    let error = failed.ended.as_ref().unwrap_err();
    let message = error.to_string();
    assert_eq!(error.exit_code(), 4, "{message}");
    for part in [
        "solid \"jelly\" has collapsed",
        "the worst is element ",
        "det F = -",
        "raise solid[0].young above 4",
        "--keep-going",
    ] {
        assert!(message.contains(part), "{part}: {message}");
    }
    let manifest = failed.manifest();
    let progress = &manifest.progress;
    assert_eq!(progress.status, RunStatus::Failed);
    assert_eq!(progress.error.as_ref(), Some(&message));
    // The sub-step that found it has its row.
    assert_eq!(progress.solids[0].failed_at, Some(progress.steps - 1));
    let rows = std::fs::read_to_string(failed.folder.path().join("out/steps.csv")).unwrap();
    assert_eq!(rows.lines().count() as u64, progress.steps + 1);

    // It goes on if it is told to, and says what it lost; liquid goes into a body that is inside out.
    let kept = run(&scene, 32, true);
    let summary = kept.ended.as_ref().unwrap();
    assert_eq!(summary.failed_solids, [("jelly".to_owned(), progress.steps - 1)]);
    let says = |what: &str| kept.notices.iter().filter(|of| of.contains(what)).count();
    assert_eq!(says("has collapsed"), 1, "{:?}", kept.notices);
    assert_eq!(says("markers are lost"), 1, "{:?}", kept.notices);
    assert!(says("of its expected volume") <= 1);
    assert_eq!(summary.tally.volume_off > 0, says("of its expected volume") == 1);
    assert!(summary.tally.lost_share() > 0.01);
}

/// What starts flat or squeezed was never sound; what is stiff enough stays sound.
#[test]
fn a_solid_that_recovers_does_not_fail() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for (scene, scale, frames) in [("squashed_cube", 1.0, 48), ("compressibility", 0.12, 24)] {
        let path = root.join(format!("scenes/{scene}.toml"));
        let scene = Scene::load(&path, &[], scale).unwrap();
        let run = run(&scene, frames, false);
        let summary = run.ended.as_ref().unwrap();
        assert_eq!(summary.failed_solids, []);
        let solids = run.manifest().progress.solids;
        assert_eq!(solids.len(), scene.solids.len());
        for health in solids {
            assert!(health.sound_steps > 0 && health.inverted_steps == 0, "{health:?}");
        }
    }
    let stiff = run(&soft(&["solid[0].young=2e4"]), 32, false);
    let summary = stiff.ended.as_ref().unwrap();
    assert_eq!(summary.failed_solids, []);
    assert_eq!(stiff.notices, [""; 0]);
}

/// Cubes that start inside out or stretched pass through sound moments while they unfold, and come back: in short sub-steps ten of them are no
/// time. (The 20 passages of an elastic wave are 0.4 s with E = 1e5 Pa.)
#[test]
fn a_solid_that_unfolds_does_not_fail() {
    for (stretch, young, step) in
        [("[1, -1, 1]", "1e5", "1/1200"), ("[-1, -1, -1]", "1e4", "1/240"), ("2", "1e5", "1/1200")]
    {
        let (one, many) = step.split_once('/').unwrap();
        let step = one.parse::<f64>().unwrap() / many.parse::<f64>().unwrap();
        let text = format!(
            "[domain]\nsize = [1, 1, 1]\ncells = [10, 10, 10]\n[time]\nduration = 0.5\nframes_per_second = 60\nfixed_step = {step:?}\n\
             [[solid]]\nname = \"cube\"\nmesh = {{ box = {{ size = [0.2, 0.2, 0.2], cells = [4, 4, 4] }} }}\n\
             placement = {{ translate = [0.5, 0.4, 0.5] }}\ninitial = {{ scale = {stretch} }}\ndensity = 1000\nyoung = {young}\npoisson = 0.3\n"
        );
        let scene = Scene::parse(Path::new("unfolds.toml"), &text, &[], 1.0).unwrap();
        let run = run(&scene, 30, false);
        let summary = run.ended.as_ref().unwrap();
        assert_eq!(summary.failed_solids, [], "{stretch}, {young} Pa");
    }
}

/// A jet of three cells across measures twice too large: told once, and counted.
#[test]
fn liquid_of_the_wrong_volume_is_told_once() {
    let text = "[domain]\nsize = [0.4, 0.6, 0.4]\ncells = [20, 30, 20]\n[time]\nduration = 0.2\n[liquid]\n\
                [[source]]\ncylinder = { base = [0.2, 0.5, 0.2], axis = [0, -1, 0], radius = 0.03, height = 0.05 }\nvelocity = [0, -1.5, 0]\n";
    let scene = Scene::parse(Path::new("tap.toml"), text, &[], 1.0).unwrap();
    let run = run(&scene, 4, false);
    let summary = run.ended.as_ref().unwrap();
    let [least, largest] = summary.tally.volume_ratio.unwrap();
    let off = least < 0.8 || largest > 1.2;
    println!("volume {least} to {largest}: {:?}", run.notices);
    let told = run.notices.iter().filter(|of| of.contains("% of its expected volume"));
    assert_eq!(told.count(), usize::from(off));
    assert_eq!(summary.tally.volume_off > 0, off);
}

/// Liquid of 1e5 kg/m^3 that hangs half a metre above a pool in an inverted cup is under more tension than real liquid bears. It boils, so
/// to speak, with separation everywhere.
#[test]
fn tension_beyond_an_atmosphere_is_reported_once() {
    let wall = |x: [f64; 2], y: [f64; 2]| {
        format!("[[obstacle]]\nbox = {{ min = [{:?}, {:?}, -1], max = [{:?}, {:?}, 1] }}\n", x[0], y[0], x[1], y[1])
    };
    let cup =
        wall([0.25, 0.375], [0.125, 0.875]) + &wall([0.625, 0.75], [0.125, 0.875]) + &wall([0.25, 0.75], [0.75, 0.875]);
    for (separation, tension) in [("from_air", true), ("walls", false)] {
        let text = format!(
            "[domain]\nsize = [1, 1, 0.25]\ncells = [16, 16, 4]\n[time]\nduration = 1\nframes_per_second = 24\n[liquid]\ndensity = 1e5\n\
             separation = \"{separation}\"\n[[liquid.region]]\nbox = {{ min = [0, 0, 0], max = [1, 0.25, 0.25] }}\n\
             [[liquid.region]]\nbox = {{ min = [0.375, 0, 0], max = [0.625, 0.75, 0.25] }}\n{cup}"
        );
        let scene = Scene::parse(Path::new("cup.toml"), &text, &[], 1.0).unwrap();
        let run = run(&scene, 2, false);
        let summary = run.ended.as_ref().unwrap();
        let notices = run.notices.iter().filter(|notice| notice.contains("boils"));
        assert_eq!(notices.count(), usize::from(tension), "{separation}: {:?}", run.notices);
        assert_eq!(summary.tally.tension > 0, tension, "{separation}");
    }
}

#[test]
fn a_sweep_counts_a_collapsed_solid_as_failed() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("soft.toml"), SOFT).unwrap();
    let sweep = "sweep soft.toml --set solid[0].young=3e3,2e4 --frames 28 --backend cpu";
    let done = ends(cutwater(&folder, sweep), 1);
    let said = text(&done.stdout);
    let summary = std::fs::read_to_string(folder.path().join("out/soft_sweep/summary.csv"));
    let summary = summary.unwrap();
    let row = |young: &str| {
        let rows = summary.lines().filter(|line| line.starts_with(young));
        rows.map(str::to_owned).next().unwrap_or_default()
    };
    let (soft, stiff) = (row("3e3"), row("2e4"));
    assert!(soft.contains("failed") && soft.contains("has collapsed"), "{summary}\n{said}");
    assert!(stiff.contains("finished"), "{summary}\n{said}");
}
