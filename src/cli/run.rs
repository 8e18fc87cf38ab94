//! `cutwater run`

use std::io::IsTerminal;
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock, mpsc};
use std::time::{Duration, Instant};

use crate::Error;
use crate::effects::Effects;
use crate::output::checkpoint::Checkpoint;
use crate::output::frames::FrameKinds;
use crate::output::manifest::Tally;
use crate::output::preview::{Pictures, PreviewOptions};
use crate::scene::{MAX_FRAMES, Scene, Surface};
use crate::sim::{self, Options, Summary};
use indicatif::ProgressBar;

use super::bar::progress_bar;
use super::{BackendArgs, SceneArgs};

/// Schedulers signal a sweep and its runs at once, and the sweep forwards the signal: within this time they are one.
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
    /// Resume the run in the folder where it ended, or start it if there is none
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
        let out = self.out.clone().unwrap_or_else(|| PathBuf::from("out").join(&scene.name));
        let interrupt = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&interrupt);
        let first = OnceLock::new();
        super::signals::on_end(move |_| {
            // The first signal ends the run between frames, the second at once.
            flag.store(true, Ordering::Relaxed);
            if first.get_or_init(Instant::now).elapsed() > SAME_SIGNAL {
                std::process::exit(Error::Interrupted.exit_code().into());
            }
        })?;
        if self.preview {
            ensure_pictures(&scene)?;
        }
        warn_before_run(&scene)?;
        let options = Options {
            backend: self.backend.backend(),
            out: out.clone(),
            frames: self.frames,
            overwrite: self.overwrite,
            resume: self.resume,
            keep_going: self.keep_going,
        };
        let (outcome, pictures) = self.simulate(&scene, &options, &interrupt);
        let summary = outcome.inspect_err(|error| print_partial_results(error, &out))?;
        print_summary(&scene, &summary);
        for warning in warnings(&scene, &summary) {
            warn!("warning: {warning}");
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

    /// Runs the simulation, and with `--preview` a thread that draws each frame. Returns the results of both.
    fn simulate(
        &self,
        scene: &Scene,
        options: &Options,
        interrupt: &AtomicBool,
    ) -> (Result<Summary, Error>, Option<DrawnPictures>) {
        let bar = progress_bar("{bar:30} frame {pos}/{len} [{elapsed}, {eta} left] {msg}");
        let terminal = std::io::stderr().is_terminal();
        let stop = AtomicBool::new(false);
        std::thread::scope(|scope| {
            let (sender, frames) = mpsc::channel();
            let (out, stop) = (&options.out, &stop);
            let painter = self.preview.then(|| scope.spawn(move || super::preview::follow(out, &frames, stop)));
            let (mut last_frame, mut last_sent) = (0, None);
            let mut show = |progress: &sim::Progress| {
                let line = show_progress(&bar, progress);
                if !terminal && progress.frame > last_frame {
                    say!("frame {} of {}: {line}", progress.frame, progress.n_frames);
                    last_frame = progress.frame;
                }
                // The files of a frame are complete before its progress is reported.
                if last_sent < Some(progress.frame) {
                    last_sent = Some(progress.frame);
                    // A painter that failed receives nothing and reports its error at the end.
                    let _ = sender.send(());
                }
            };
            let outcome = sim::run(scene, options, &mut show, interrupt);
            stop.store(true, Ordering::Relaxed);
            drop(sender);
            bar.finish_and_clear();
            let joined = painter.map(|painter| painter.join());
            let pictures = joined.map(|joined| joined.unwrap_or_else(|panic| resume_unwind(panic)));
            (outcome, pictures)
        })
    }
}

/// Result of the thread that draws; `None` without a frame.
type DrawnPictures = Result<Option<Pictures>, Error>;

/// Updates the progress bar and prints notices. Returns the line of the sub-step.
fn show_progress(bar: &ProgressBar, progress: &sim::Progress) -> String {
    bar.set_length(progress.n_frames);
    bar.set_position(progress.frame);
    for notice in progress.notices {
        bar.suspend(|| warn!("warning: {notice}"));
    }
    let report = progress.report;
    let mut line = format!("t = {:.3} s, dt = {:.2e} s", progress.time, report.dt);
    for solve in report.solves() {
        line +=
            &format!(", {} unknowns, {} iterations, residual {:.0e}", solve.unknowns, solve.iterations, solve.residual);
    }
    bar.set_message(line.clone());
    line
}

/// After a failed run, prints where its files are. A refused run has not written the files in the folder.
fn print_partial_results(error: &Error, out: &Path) {
    let stopped = matches!(error.exit_code(), 4 | 130) || matches!(error, Error::Output { .. });
    if stopped && Checkpoint::path(out).exists() {
        let out = out.display();
        warn!("partial results are in {out}; the same command with --resume continues the run");
    } else if stopped && out.join("frames").exists() {
        warn!("partial results are in {}", out.display());
    }
}

fn print_summary(scene: &Scene, summary: &Summary) {
    match &summary.resumed {
        Some(resumed) if resumed.frames == summary.frames => {
            say!("the run was already finished");
        }
        Some(resumed) => say!("resumed from frame {}", resumed.frames),
        None => {}
    }
    let Tally { worst_residual, volume_ratio, min_det, .. } = summary.tally;
    let volume = volume_ratio.map_or(String::new(), |[least, largest]| {
        let [least, largest] = [100.0 * least, 100.0 * largest];
        let target = match Effects::of(scene).exchange() {
            true => "the target",
            false => "the start",
        };
        format!("; volume {least:.1} % to {largest:.1} % of {target}")
    });
    let det = min_det.map_or(String::new(), |det| format!("; least det F {det:.3}"));
    say!(
        "{} frames in {} sub-steps, {:.1} s; worst residual {worst_residual:.1e}{volume}{det}",
        summary.frames,
        summary.steps,
        summary.seconds,
    );
}

/// Warnings after a run, each with its cause, cure and place in the files.
fn warnings(scene: &Scene, summary: &Summary) -> Vec<String> {
    let steps = summary.steps;
    let tally = &summary.tally;
    let mut warnings = Vec::new();
    let mut warn_if = |present: bool, warning: &dyn Fn() -> String| {
        if present {
            warnings.push(warning());
        }
    };
    warn_if(tally.missed > 0, &|| {
        format!(
            "{} of {steps} sub-steps missed the tolerance of {:.0e}; steps.csv lists them",
            tally.missed, scene.solver.tolerance
        )
    });
    warn_if(tally.squeezed > 0, &|| {
        format!(
            "in {} of {steps} sub-steps prescribed motion or a source would have compressed enclosed liquid, so its volume was not preserved; give it an outlet (domain.open, a sink, air); steps.csv lists the sub-steps (incompatible)",
            tally.squeezed
        )
    });
    // Beside a level, markers that bodies push out are replaced.
    let surface_of_markers = scene.liquid.as_ref().is_some_and(|liquid| liquid.surface == Surface::Markers);
    warn_if(surface_of_markers && tally.dropped > 0, &|| {
        format!(
            "{} markers, {:.2} % of all, were lost in obstacles or solids: walls are thinner than two cells, or solids too fast; use more cells (--scale) or shorter sub-steps (time.cfl); steps.csv lists the sub-steps",
            tally.dropped,
            100.0 * tally.lost_share()
        )
    });
    warn_if(tally.volume_off > 0, &|| {
        format!(
            "after {} of {steps} sub-steps the volume of the liquid was more than 20 % off; steps.csv lists them (volume_ratio)",
            tally.volume_off
        )
    });
    warn_if(tally.fast > 0, &|| {
        format!(
            "in {} of {steps} sub-steps liquid exceeded 20 times the speed that gravity, inflow and moving bodies explain; steps.csv lists them (max_speed)",
            tally.fast
        )
    });
    warn_if(tally.tension > 0, &|| {
        format!(
            "in {} of {steps} sub-steps the pressure was more than an atmosphere below that of the air, where a real liquid boils; steps.csv lists them (least_pressure)",
            tally.tension
        )
    });
    for (name, step) in &summary.failed_solids {
        warn_if(true, &|| {
            format!("solid \"{name}\" collapsed in sub-step {step}; later results are not the scene's physics")
        });
    }
    warn_if(tally.overlap > scene.grid().dx, &|| {
        let place = match scene.liquid {
            Some(_) => "steps.csv lists the sub-steps (overlap_depth)",
            None => "the frames show it",
        };
        format!(
            "solids overlapped by up to {:.3} m with each other or with obstacles: contact between solids is not simulated; move them apart; {place}",
            tally.overlap
        )
    });
    warn_if(tally.inverted > 0, &|| {
        format!(
            "{} elements of solids are flat or inverted at the end; shorter sub-steps (time.fixed_step) or a coarser mesh may help",
            tally.inverted
        )
    });
    let other_adapter = summary.resumed.as_ref();
    if let Some(earlier) = other_adapter.and_then(|resumed| resumed.other_adapter.as_ref()) {
        warn_if(true, &|| {
            format!(
                "the run began on {earlier}: results differ by rounding from a run on one adapter; manifest.json has the first sub-step on this one"
            )
        });
    }
    let stale = summary.resumed.as_ref().is_some_and(|resumed| resumed.skins_removed);
    warn_if(stale, &|| {
        "skins of an earlier part of the run were removed, since they lack the later frames; run `cutwater skin` again"
            .to_owned()
    });
    for region in &summary.empty_regions {
        warn_if(true, &|| format!("liquid.region[{region}] has no liquid: it is too small for the cells, or covered"));
    }
    warn_if(tally.floored > 0, &|| {
        let cause = match scene.time.fixed_step {
            Some(_) => "time.fixed_step is too long for these velocities",
            None => "no sub-step is shorter than 1e-7 of the duration",
        };
        format!(
            "in {} of {steps} sub-steps the fastest point crossed more than {} cells: {cause}; steps.csv lists them",
            tally.floored, scene.time.cfl
        )
    });
    warnings
}

/// Refuses a scene without frames for `--preview` before it runs; warns of bodies that pictures will lack.
fn ensure_pictures(scene: &Scene) -> Result<(), Error> {
    let FrameKinds { markers, fields, solids, surface, .. } = FrameKinds::of(scene);
    let liquid = (
        "liquid",
        "output.particles, output.fields or output.surface",
        scene.liquid.is_some(),
        markers || fields || surface.is_some(),
    );
    let bodies = ("solids", "output.solids", !scene.solids.is_empty(), solids);
    let missing = [liquid, bodies].into_iter().filter(|(_, _, present, drawn)| *present && !drawn);
    for (what, keys, _, _) in missing {
        if !(liquid.3 || solids) {
            return Err(Error::input(
                "--preview",
                "the scene writes no frames to draw",
                format!("turn {keys} on, or run without --preview"),
            ));
        }
        warn!("warning: the pictures lack the {what}: turn {keys} on");
    }
    Ok(())
}

pub(super) fn warn_before_run(scene: &Scene) -> Result<(), Error> {
    for warning in sim::warnings(scene)? {
        warn!("warning: {warning}");
    }
    Ok(())
}
