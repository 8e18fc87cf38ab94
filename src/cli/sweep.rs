//! `cutwater sweep`

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus};
use std::sync::Arc;
use std::sync::atomic::{AtomicI32, AtomicUsize, Ordering};
use std::thread;
use std::time::Duration;

use crate::Error;
use crate::measure::sweep::{Axis, LOG, Options, Row, Run, Shard, Status, Sweep};
use crate::scene::{MAX_FRAMES, override_option, without};
use clap::{ArgAction, ValueEnum};

use super::BackendArgs;

/// Polling interval of runs.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Run a scene with every combination of some settings, in a folder each, and summarise the runs
#[derive(Debug, clap::Args)]
pub(super) struct SweepCommand {
    /// Scene file (TOML)
    pub(super) scene: PathBuf,
    /// A key of the scene and its values, such as solid[0].young=1e5,1e6; may be repeated, for the product of all
    #[arg(long = "set", value_name = "KEY=V1,V2", required = true, action = ArgAction::Append)]
    pub(super) settings: Vec<String>,
    /// Remove a key of the scene in all runs, and what refers to it, such as liquid, solid[0] or solid.NAME; may be repeated
    #[arg(long = "without", value_name = "KEY")]
    pub(super) without: Vec<String>,
    /// Multiply domain.cells, rounded
    #[arg(long, default_value_t = 1.0)]
    pub(super) scale: f64,
    #[command(flatten)]
    pub(super) backend: BackendArgs,
    /// Folder of the sweep; out/NAME_sweep by default
    #[arg(long)]
    pub(super) out: Option<PathBuf>,
    /// Frames of each run instead of the scene's duration, at most 999999
    #[arg(long, value_parser = clap::value_parser!(u64).range(..=MAX_FRAMES))]
    pub(super) frames: Option<u64>,
    /// Draw a picture of every frame of each run as soon as it is written, and the animation at its end
    #[arg(long)]
    pub(super) preview: bool,
    /// Continue runs in which a solid has collapsed, which otherwise count as failed
    #[arg(long)]
    pub(super) keep_going: bool,
    /// Runs at a time
    #[arg(long, default_value = "1", value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub(super) jobs: u16,
    /// Run only every N-th combination, from the I-th on, I from 1 to N: for job arrays
    #[arg(long, value_name = "I/N", default_value = "1/1", hide_default_value = true)]
    pub(super) shard: Shard,
    /// Replace runs of another scene text, other options or another version, which are refused otherwise
    #[arg(long)]
    pub(super) overwrite: bool,
    /// List the status of each run, update the summary, and run nothing
    #[arg(long)]
    pub(super) list: bool,
}

impl SweepCommand {
    /// `program`: the command that starts this command line in another process; `None` for the executable of this process.
    pub(super) fn run(&self, program: Option<&[OsString]>) -> Result<(), Error> {
        let axes = self.settings.iter().map(|setting| setting.parse::<Axis>());
        let out = self.out.clone().unwrap_or_else(|| {
            let stem = self.scene.file_stem().unwrap_or_default();
            Path::new("out").join(format!("{}_sweep", stem.to_string_lossy()))
        });
        let options = Options {
            scene: self.scene.clone(),
            without: self.without.iter().map(|key| without(key)).collect(),
            scale: self.scale,
            frames: self.frames,
            backend: self.backend.backend().name(),
            out: out.clone(),
        };
        let sweep = Sweep::new(axes.collect::<Result<_, _>>()?, options)?;
        self.complete(&sweep, &out, program)
    }

    /// Runs what is missing of a sweep, and summarises it. `program` as for [`SweepCommand::run`].
    pub(super) fn complete(&self, sweep: &Sweep, out: &Path, program: Option<&[OsString]>) -> Result<(), Error> {
        let program = match program {
            Some(program) => program.to_vec(),
            None => vec![this_program()?],
        };
        let shard = sweep.shard_runs(self.shard);
        if self.list {
            for &number in &shard {
                say!("{:10} {}", sweep.row(number).status.name(), sweep.runs[number].name);
            }
            return match out.exists() {
                true => sweep.write_summary(),
                false => Ok(()),
            };
        }
        let outdated = shard.iter().find(|&&number| sweep.row(number).status == Status::Outdated);
        if let (Some(&number), false) = (outdated, self.overwrite) {
            return Err(Error::input(
                sweep.runs[number].folder.display().to_string(),
                "the folder contains a run of another scene text, of other options (including --frames and the backend), or of another version of cutwater",
                "choose another folder with --out, or replace such runs with --overwrite",
            ));
        }
        let signals = Arc::new(Signals::default());
        let noted = Arc::clone(&signals);
        super::signals::on_end(move |signal| noted.note(signal))?;
        sweep.write_summary()?;
        self.run_all(sweep, &shard, (&program, &signals))?;
        print_table(sweep, &shard);
        say!("summary: {}", out.join("summary.csv").display());
        if signals.count() > 0 {
            return Err(Error::Interrupted);
        }
        ensure_finished(sweep, &shard)
    }

    /// Starts the missing runs of the shard, `jobs` at a time.
    fn run_all(
        &self,
        sweep: &Sweep,
        shard: &[usize],
        (program, signals): (&[OsString], &Signals),
    ) -> Result<(), Error> {
        let (next, ended) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let worker = || -> Result<(), Error> {
            while signals.count() == 0
                && let Some(&number) = shard.get(next.fetch_add(1, Ordering::Relaxed))
            {
                let before = sweep.row(number).status;
                let result = match before {
                    Status::Finished => describe(sweep, number) + ", from an earlier sweep",
                    Status::Refused => describe(sweep, number),
                    _ => {
                        let replaces = before == Status::Outdated;
                        match self.run_one(sweep, number, replaces, (program, signals)) {
                            Ok(()) => describe(sweep, number),
                            Err(error) => error.to_string(),
                        }
                    }
                };
                sweep.write_summary()?;
                let nth = ended.fetch_add(1, Ordering::Relaxed) + 1;
                say!("{nth} of {}: {}: {result}", shard.len(), sweep.runs[number].name);
            }
            Ok(())
        };
        thread::scope(|scope| {
            let jobs = usize::from(self.jobs).min(shard.len());
            let workers: Vec<_> = (0..jobs).map(|_| scope.spawn(worker)).collect();
            let ends = workers.into_iter().map(|worker| {
                worker.join().unwrap_or_else(|_| Err(Error::Check("a thread of the sweep ended early".to_owned())))
            });
            ends.fold(Ok(()), Result::and)
        })
    }

    /// Starts a run in a process of its own, so that its failure, such as a lost device, affects no other run. Skips a run that another
    /// process has locked.
    fn run_one(
        &self,
        sweep: &Sweep,
        number: usize,
        replaces: bool,
        (program, signals): (&[OsString], &Signals),
    ) -> Result<(), Error> {
        let Some(lock) = sweep.lock(number)? else {
            return Ok(());
        };
        let run = &sweep.runs[number];
        let path = run.folder.join(LOG);
        let failed = |problem: std::io::Error| Error::unwritten(&path, &problem);
        let mut log = File::options().create(true).append(true).open(&path).map_err(failed)?;
        let start = log.metadata().map_err(failed)?.len();
        let mut command = self.command(program, replaces, run);
        writeln!(log, "{command:?}").map_err(failed)?;
        let copy = log.try_clone().map_err(failed)?;
        let (exit_code, mut problem) = match command.stdin(lock).stdout(copy).stderr(log).spawn() {
            Ok(mut child) => {
                let status = wait_for(&mut child, signals).map_err(failed)?;
                (status.code(), signal_name(status))
            }
            Err(problem) => (None, Some(format!("cannot be started: {problem}"))),
        };
        drop(command);
        if exit_code != Some(0) {
            problem = last_error(&path, start).or(problem);
            sweep.record_end(number, exit_code, problem)?;
        }
        Ok(())
    }

    fn command(&self, program: &[OsString], replaces: bool, run: &Run) -> Command {
        let mut command = Command::new(&program[0]);
        command.args(&program[1..]);
        command.arg("run").arg(&self.scene);
        command.arg("--out").arg(&run.folder);
        for setting in &run.overrides {
            command.args(override_option(setting));
        }
        command.args(["--scale", &run.scale.to_string()]);
        if let Some(name) = self.backend.backend.to_possible_value() {
            command.args(["--backend", name.get_name()]);
        }
        if let Some(adapter) = &self.backend.adapter.adapter {
            command.args(["--adapter", adapter]);
        }
        if let Some(frames) = self.frames {
            command.args(["--frames", &frames.to_string()]);
        }
        // Resumes a partial run.
        command.arg(if replaces { "--overwrite" } else { "--resume" });
        if self.preview {
            command.arg("--preview");
        }
        if self.keep_going {
            command.arg("--keep-going");
        }
        const THREADS: &str = "RAYON_NUM_THREADS";
        if self.jobs > 1 && std::env::var_os(THREADS).is_none() {
            let threads = thread::available_parallelism().map_or(1, usize::from);
            command.env(THREADS, (threads / usize::from(self.jobs)).max(1).to_string());
        }
        // Ctrl-C on a terminal signals the whole process group: a run in it would receive two signals and end at once.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        command
    }
}

/// The executable of this process.
fn this_program() -> Result<OsString, Error> {
    let path = std::env::current_exe().map_err(|problem| {
        Error::input("the path of cutwater itself", problem.to_string(), "start it by its full path")
    })?;
    Ok(path.into_os_string())
}

/// Received signals.
#[derive(Debug, Default)]
struct Signals {
    count: AtomicUsize,
    last: AtomicI32,
}

impl Signals {
    fn note(&self, signal: i32) {
        self.last.store(signal, Ordering::Relaxed);
        // Released after the signal, so that readers of the count see it.
        self.count.fetch_add(1, Ordering::Release);
    }

    fn count(&self) -> usize {
        self.count.load(Ordering::Acquire)
    }
}

/// Waits for a child and forwards each signal of the sweep to it.
fn wait_for(child: &mut Child, signals: &Signals) -> std::io::Result<ExitStatus> {
    let mut forwarded = 0;
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        if signals.count() > forwarded {
            forwarded += 1;
            forward(child, signals.last.load(Ordering::Relaxed))?;
        }
        thread::sleep(POLL_INTERVAL);
    }
}

/// Sends the received signal to a child; it may ignore any other.
#[cfg(unix)]
fn forward(child: &mut Child, signal: i32) -> std::io::Result<()> {
    use nix::sys::signal::{Signal, kill};
    use nix::unistd::Pid;

    let id = i32::try_from(child.id()).map_err(std::io::Error::other)?;
    // The id is still valid: the child has not been waited for.
    Ok(kill(Pid::from_raw(id), Signal::try_from(signal)?)?)
}

#[cfg(not(unix))]
fn forward(child: &mut Child, _: i32) -> std::io::Result<()> {
    child.kill()
}

#[cfg(unix)]
fn signal_name(status: ExitStatus) -> Option<String> {
    use std::os::unix::process::ExitStatusExt;

    let signal = nix::sys::signal::Signal::try_from(status.signal()?);
    Some(format!("ended by {}", signal.map_or("a signal", |signal| signal.as_str())))
}

#[cfg(not(unix))]
fn signal_name(_: ExitStatus) -> Option<String> {
    None
}

/// The last error in the log from byte `start` on, in one line.
fn last_error(log: &Path, start: u64) -> Option<String> {
    let bytes = fs::read(log).ok()?;
    let text = String::from_utf8_lossy(bytes.get(usize::try_from(start).ok()?..)?).into_owned();
    let error = text.rsplit_once("error: ").map(|(_, error)| error);
    let panic = || text.rsplit_once(" panicked at ").map(|(_, panic)| panic);
    let lines: Vec<&str> = error.or_else(panic)?.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    Some(lines.join("; "))
}

/// Result or status of a run.
fn describe(sweep: &Sweep, number: usize) -> String {
    let row = sweep.row(number);
    match row.status {
        Status::Finished => {
            let tally = row.tally.unwrap_or_default();
            let volume = tally.volume_ratio.map_or(String::new(), |[least, largest]| {
                format!(", volume {:.1} % to {:.1} %", 100.0 * least, 100.0 * largest)
            });
            let missed = match tally.missed {
                0 => String::new(),
                missed => format!(", {missed} missed the tolerance"),
            };
            let squeezed = match tally.squeezed {
                0 => String::new(),
                squeezed => format!(", {squeezed} were incompatible"),
            };
            format!(
                "finished, {} frames in {} sub-steps, {:.1} s, worst residual {:.1e}{volume}{missed}{squeezed}",
                row.frames.unwrap_or_default(),
                row.sub_steps.unwrap_or_default(),
                row.seconds.unwrap_or_default(),
                tally.worst_residual
            )
        }
        Status::Running => "running in another process".to_owned(),
        status => {
            let code = row.exit_code.map_or(String::new(), |code| format!(" (exit code {code})"));
            let problem = row.problem.map_or(String::new(), |problem| format!(": {problem}"));
            format!("{}{code}{problem}", status.name())
        }
    }
}

/// Prints the table of the shard's runs.
fn print_table(sweep: &Sweep, shard: &[usize]) {
    let width = shard.iter().map(|&number| sweep.runs[number].name.len()).max().unwrap_or(0);
    say!(
        "\n{:width$}  {:11} {:>4} {:>6} {:>9} {:>9} {:>9} {:>15} {:>6}",
        "run",
        "status",
        "exit",
        "frames",
        "sub-steps",
        "seconds",
        "residual",
        "volume %",
        "missed"
    );
    fn or_dash<T>(value: Option<T>, text: impl Fn(T) -> String) -> String {
        value.map_or("-".to_owned(), text)
    }
    for &number in shard {
        let Row { status, exit_code, frames, sub_steps, seconds, tally, .. } = sweep.row(number);
        let volume = tally.and_then(|tally| tally.volume_ratio);
        say!(
            "{:width$}  {:11} {:>4} {:>6} {:>9} {:>9} {:>9} {:>15} {:>6}",
            sweep.runs[number].name,
            status.name(),
            or_dash(exit_code, |code| code.to_string()),
            or_dash(frames, |frames| frames.to_string()),
            or_dash(sub_steps, |steps| steps.to_string()),
            or_dash(seconds, |seconds| format!("{seconds:.1}")),
            or_dash(tally, |tally| format!("{:.1e}", tally.worst_residual)),
            or_dash(volume, |[least, largest]| format!("{:.1} to {:.1}", 100.0 * least, 100.0 * largest)),
            or_dash(tally, |tally| tally.missed.to_string()),
        );
    }
}

/// An error that lists unfinished runs.
fn ensure_finished(sweep: &Sweep, shard: &[usize]) -> Result<(), Error> {
    let unfinished: Vec<String> = shard
        .iter()
        .filter_map(|&number| {
            let row = sweep.row(number);
            let name = || format!("{} ({})", sweep.runs[number].name, row.status.name());
            (row.status != Status::Finished).then(name)
        })
        .collect();
    match unfinished[..] {
        [] => Ok(()),
        _ => Err(Error::Check(format!(
            "{} of {} runs did not finish: {}",
            unfinished.len(),
            shard.len(),
            unfinished.join(", ")
        ))),
    }
}
