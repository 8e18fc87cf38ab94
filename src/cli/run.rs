//! `cutwater run`

use std::io::IsTerminal;
use std::panic::resume_unwind;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock, mpsc};
use std::time::{Duration, Instant};

use cutwater::Error;
use cutwater::effects::Effects;
use cutwater::geometry;
use cutwater::output::checkpoint::Checkpoint;
use cutwater::output::frames::FrameKinds;
use cutwater::output::manifest::Tally;
use cutwater::output::preview::{Pictures, PreviewOptions};
use cutwater::scene::{MAX_FRAMES, Scene};
use cutwater::sim::{self, Options};
use indicatif::{ProgressBar, ProgressStyle};

use super::{BackendArgs, SceneArgs};

/// Schedulers signal a sweep and its runs at once, and the sweep passes it on: that is one signal.
const SAME_SIGNAL: Duration = Duration::from_millis(500);

/// Simulate a scene and write its frames and tables
#[derive(Debug, clap::Args)]
pub(super) struct Run {
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    backend: BackendArgs,
    /// Folder of the run; out/NAME by default
    #[arg(long)]
    out: Option<PathBuf>,
    /// Frames to compute instead of the scene's duration, at most 999999; 0 for the start alone
    #[arg(long, value_parser = clap::value_parser!(u64).range(..=MAX_FRAMES))]
    frames: Option<u64>,
    /// Replace an earlier run in the folder
    #[arg(long, conflicts_with = "resume")]
    overwrite: bool,
    /// Go on with the run in the folder where it ended; begin it where there is none
    #[arg(long)]
    resume: bool,
    /// Continue after a solid has collapsed, which otherwise ends the run with exit code 4
    #[arg(long)]
    keep_going: bool,
    /// Draw a picture of every frame as soon as it is written, and the animation at the end
    #[arg(long)]
    preview: bool,
}

impl Run {
    pub(super) fn run(&self) -> Result<(), Error> {
        let scene = self.scene.load()?;
        let out = self
            .out
            .clone()
            .unwrap_or_else(|| PathBuf::from("out").join(&scene.name));
        let interrupt = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&interrupt);
        let first = OnceLock::new();
        super::signals::on_end(move |_| {
            // The first signal ends the run where its files are whole, the second at once.
            flag.store(true, Ordering::Relaxed);
            if first.get_or_init(Instant::now).elapsed() > SAME_SIGNAL {
                std::process::exit(Error::Interrupted.exit_code().into());
            }
        })?;
        if self.preview {
            ensure_pictures(&scene)?;
        }
        warn_of_blind_spots(&scene)?;
        let options = Options {
            backend: self.backend.backend(),
            out: out.clone(),
            frames: self.frames,
            overwrite: self.overwrite,
            resume: self.resume,
            keep_going: self.keep_going,
        };
        let terminal = std::io::stderr().is_terminal();
        let bar = if terminal {
            progress_bar()
        } else {
            ProgressBar::hidden()
        };
        let mut last_frame = 0;
        let mut listen = |progress: &sim::Progress| {
            bar.set_length(progress.n_frames);
            bar.set_position(progress.frame);
            for notice in progress.notices {
                bar.suspend(|| warn!("warning: {notice}"));
            }
            let report = progress.report;
            let mut line = format!("t = {:.3} s, dt = {:.2e} s", progress.time, report.dt);
            for solve in report.solves() {
                line += &format!(
                    ", {} unknowns, {} iterations, residual {:.0e}",
                    solve.unknowns, solve.iterations, solve.residual
                );
            }
            if !terminal && progress.frame > last_frame {
                say!("frame {} of {}: {line}", progress.frame, progress.n_frames);
                last_frame = progress.frame;
            }
            bar.set_message(line);
        };
        let stop = AtomicBool::new(false);
        let (outcome, pictures) = std::thread::scope(|scope| {
            let (told, frames) = mpsc::channel();
            let (out, stop) = (&out, &stop);
            let painter = self
                .preview
                .then(|| scope.spawn(move || super::preview::follow(out, &frames, stop)));
            let mut seen = None;
            let mut listen = |progress: &sim::Progress| {
                listen(progress);
                // The files of a frame are whole before its sub-step is told of.
                if seen < Some(progress.frame) {
                    seen = Some(progress.frame);
                    // Where nobody hears it, the painter failed, and says so at the end.
                    let _ = told.send(());
                }
            };
            let outcome = sim::run(&scene, &options, &mut listen, &interrupt);
            stop.store(true, Ordering::Relaxed);
            drop(told);
            bar.finish_and_clear();
            let joined = painter.map(|painter| painter.join());
            let pictures = joined.map(|joined| joined.unwrap_or_else(|panic| resume_unwind(panic)));
            (outcome, pictures)
        });
        let summary = outcome.inspect_err(|error| {
            // Not where the run was refused: what is in the folder then is another's.
            let stopped = matches!(error.exit_code(), 4 | 130) || matches!(error, Error::Output { .. });
            if stopped && Checkpoint::path(&out).exists() {
                let out = out.display();
                warn!("what was written so far is in {out}; the same command with --resume goes on from there");
            } else if stopped && out.join("frames").exists() {
                warn!("what was written so far is in {}", out.display());
            }
        })?;
        match &summary.resumed {
            Some(resumed) if resumed.frames == summary.frames => {
                say!("the run was finished");
            }
            Some(resumed) => say!("went on from frame {}", resumed.frames),
            None => {}
        }
        let Tally {
            missed,
            squeezed,
            worst_residual,
            volume_ratio,
            floored,
            dropped,
            volume_off,
            fast,
            min_det,
            inverted,
            overlap,
            ..
        } = summary.tally;
        let volume = volume_ratio.map_or(String::new(), |[least, largest]| {
            let [least, largest] = [100.0 * least, 100.0 * largest];
            let held = match Effects::of(&scene).exchange() {
                true => "what it should be",
                false => "the start",
            };
            format!("; volume {least:.1} % to {largest:.1} % of {held}")
        });
        let det = min_det.map_or(String::new(), |det| format!("; least det F {det:.3}"));
        say!(
            "{} frames in {} sub-steps, {:.1} s; worst residual {worst_residual:.1e}{volume}{det}",
            summary.frames,
            summary.steps,
            summary.seconds,
        );
        if missed > 0 {
            warn!(
                "warning: {missed} of {} sub-steps missed the tolerance of {:.0e}; steps.csv says which",
                summary.steps, scene.solver.tolerance
            );
        }
        if squeezed > 0 {
            warn!(
                "warning: in {squeezed} of {} sub-steps liquid without a free surface had nowhere to go: what moves into it, or a source, would have to compress it, and its volume is not kept; leave it room (domain.open, a sink, air); steps.csv says in which (incompatible)",
                summary.steps
            );
        }
        if dropped > 0 {
            warn!(
                "warning: {dropped} markers, {:.2} % of all, were lost in obstacles or solids: walls thinner than two cells and fast solids swallow them; use more cells (--scale) or shorter sub-steps (time.cfl); steps.csv says when",
                100.0 * summary.tally.lost_share()
            );
        }
        if volume_off > 0 {
            warn!(
                "warning: after {volume_off} of {} sub-steps the volume of the liquid was more than 20 % off; steps.csv says after which (volume_ratio)",
                summary.steps
            );
        }
        if fast > 0 {
            warn!(
                "warning: in {fast} of {} sub-steps liquid moved at more than 20 times the speed that gravity, inflow and moving bodies explain; steps.csv says in which (max_speed)",
                summary.steps
            );
        }
        for (name, step) in &summary.failed_solids {
            warn!(
                "warning: solid \"{name}\" collapsed in sub-step {step}; what follows it is not the scene's physics"
            );
        }
        if overlap > scene.grid().dx {
            let when = match scene.liquid {
                Some(_) => "steps.csv says when (overlap_depth)",
                None => "the frames show when",
            };
            warn!(
                "warning: solids lay up to {overlap:.3} m deep in each other or in obstacles; they do not touch each other, nor obstacles that move: place them apart; {when}"
            );
        }
        if inverted > 0 {
            warn!(
                "warning: {inverted} elements of solids are flat or inside out at the end; shorter sub-steps (time.fixed_step) or a coarser mesh may help"
            );
        }
        if let Some(earlier) = summary.resumed.and_then(|resumed| resumed.other_adapter) {
            warn!(
                "warning: the run began on {earlier}: what follows differs by rounding from what it would have been there; manifest.json says from where on"
            );
        }
        for region in summary.empty_regions {
            warn!(
                "warning: liquid.region[{region}] is too small for the cells, or covered: it has no liquid"
            );
        }
        if floored > 0 {
            let cause = match scene.time.fixed_step {
                Some(_) => "time.fixed_step is too long for these velocities",
                None => "a frame has at most 256",
            };
            warn!(
                "warning: in {floored} of {} sub-steps something crossed more than {} cells: {cause}; steps.csv says in which",
                summary.steps, scene.time.cfl
            );
        }
        say!("frames: {}", out.join("frames").display());
        if let Some(pictures) = pictures {
            let pictures = match pictures? {
                Some(pictures) => pictures,
                None => Pictures::new(&out, &PreviewOptions::default())?,
            };
            super::preview::draw(pictures, &out, &interrupt)?;
        }
        Ok(())
    }
}

/// Refuses a scene of which `--preview` would find no frames, before it runs; warns of what pictures will not show.
fn ensure_pictures(scene: &Scene) -> Result<(), Error> {
    let FrameKinds {
        markers,
        fields,
        solids,
        surface,
        ..
    } = FrameKinds::of(scene);
    let of_liquid = (
        "liquid",
        "output.particles, output.fields or output.surface",
        scene.liquid.is_some(),
        markers || fields || surface.is_some(),
    );
    let of_solids = ("solids", "output.solids", !scene.solids.is_empty(), solids);
    let missing = [of_liquid, of_solids]
        .into_iter()
        .filter(|(_, _, present, drawn)| *present && !drawn);
    for (what, keys, _, _) in missing {
        if !(of_liquid.3 || solids) {
            return Err(Error::input(
                "--preview",
                "the scene writes no frames to draw",
                format!("turn {keys} on, or run without --preview"),
            ));
        }
        warn!("warning: the pictures will not show the {what}: {keys} would have to be on");
    }
    Ok(())
}

/// Warns of obstacles and, in liquid, of solids that are so thin that the cells do not see them, of obstacles that solids do not see, and of
/// probes that see no liquid.
pub(super) fn warn_of_blind_spots(scene: &Scene) -> Result<(), Error> {
    let grid = scene.grid();
    let (liquid, solids) = (scene.liquid.is_some(), !scene.solids.is_empty());
    if solids && scene.obstacles_move() {
        warn!(
            "warning: obstacles that move and solids pass through each other; a [[solid.script]] moves nodes of a solid"
        );
    }
    let passes = match (liquid, solids) {
        (true, true) => "liquid leaks and solids pass through it",
        (true, false) => "liquid leaks through it",
        (false, _) => "solids pass through it",
    };
    let cure = "use more cells or a thickness of at least one";
    for (number, thickness) in geometry::thin_obstacles(scene, &grid)? {
        warn!("warning: obstacle[{number}] is {thickness:.2} cells thick: {passes}; {cure}");
    }
    for number in geometry::covered_probes(scene, &grid)? {
        let name = &scene.probes[number].name;
        warn!(
            "warning: probe \"{name}\" lies in an obstacle: what it measures is none of the liquid's"
        );
    }
    if liquid && solids {
        let solids = sim::solids_of(scene)?;
        let (displacement, _) = solids.initial_state(scene);
        for (number, thickness) in geometry::thin_solids(&solids.moved(&displacement), &grid) {
            let name = &scene.solids[number].name;
            warn!(
                "warning: solid \"{name}\" is {thickness:.2} cells thick: liquid leaks through it; {cure}"
            );
        }
    }
    Ok(())
}

fn progress_bar() -> ProgressBar {
    let style =
        ProgressStyle::with_template("{bar:30} frame {pos}/{len} [{elapsed}, {eta} left] {msg}")
            .expect("the template is valid");
    let style = match is_utf8_locale(|name| std::env::var(name).ok()) {
        true => style,
        false => style.progress_chars("#>-"),
    };
    ProgressBar::new(1).with_style(style)
}

/// Whether the terminal shows UTF-8: the first of these variables that is set and not empty decides (POSIX, XBD 8.2).
fn is_utf8_locale(variable: impl Fn(&str) -> Option<String>) -> bool {
    let mut names = ["LC_ALL", "LC_CTYPE", "LANG"].into_iter();
    let locale = names.find_map(|name| variable(name).filter(|value| !value.is_empty()));
    let locale = locale.unwrap_or_default().to_lowercase();
    // Windows has no such variables, and terminals that show UTF-8.
    cfg!(windows) || locale.contains("utf-8") || locale.contains("utf8")
}

#[cfg(all(test, not(windows)))]
mod tests {
    use super::is_utf8_locale;

    #[test]
    fn the_first_variable_that_is_set_decides() {
        let locale = |pairs: &[(&str, &str)]| {
            is_utf8_locale(|name| {
                let found = pairs.iter().find(|(key, _)| *key == name);
                found.map(|(_, value)| (*value).to_owned())
            })
        };
        assert!(locale(&[("LANG", "de_DE.UTF-8")]));
        assert!(locale(&[
            ("LC_ALL", ""),
            ("LC_CTYPE", "C.utf8"),
            ("LANG", "C")
        ]));
        assert!(!locale(&[("LC_ALL", "C"), ("LANG", "en_US.UTF-8")]));
        assert!(!locale(&[]));
    }
}
