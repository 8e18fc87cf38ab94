//! `cutwater converge`

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use crate::Error;
use crate::measure::converge::{Study, refined};
use crate::measure::sweep::{Options, Shard, Sweep};
use crate::scene::{MAX_FRAMES, Scene};

use super::sweep::SweepCommand;
use super::{BackendArgs, Overrides};

/// Run a scene at several scales and estimate the order of convergence and the limit of each probe
#[derive(Debug, clap::Args)]
pub(super) struct Converge {
    /// Scene file (TOML)
    scene: PathBuf,
    /// Scales of the cells, at least three; the three finest give the order
    #[arg(long, value_name = "S1,S2,S3", default_value = "0.5,1,2", value_delimiter = ',')]
    scales: Vec<f64>,
    /// Also divide time.fixed_step and time.max_step by the scale
    #[arg(long)]
    steps: bool,
    /// Also refine the elements of the solids
    #[arg(long)]
    elements: bool,
    #[command(flatten)]
    overrides: Overrides,
    #[command(flatten)]
    backend: BackendArgs,
    /// Folder of the study; out/NAME_converge by default
    #[arg(long)]
    out: Option<PathBuf>,
    /// Frames of each run instead of the scene's duration, at most 999999
    #[arg(long, value_parser = clap::value_parser!(u64).range(..=MAX_FRAMES))]
    frames: Option<u64>,
    /// Continue runs in which a solid has collapsed, which otherwise count as failed
    #[arg(long)]
    keep_going: bool,
    /// Runs at a time
    #[arg(long, default_value = "1", value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    jobs: u16,
    /// Replace runs of another scene text, other options or another version, which are refused otherwise
    #[arg(long)]
    overwrite: bool,
}

impl Converge {
    pub(super) fn run(&self, program: Option<&[OsString]>) -> Result<(), Error> {
        let mut scales = self.scales.clone();
        scales.sort_by(f64::total_cmp);
        let sound = scales.iter().all(|scale| scale.is_finite() && *scale > 0.0);
        if !sound || scales.windows(2).any(|pair| pair[0] == pair[1]) || scales.len() < 3 {
            let text: Vec<String> = self.scales.iter().map(f64::to_string).collect();
            return Err(Error::input(
                format!("--scales {}", text.join(",")),
                "is no list of three or more different numbers above zero",
                "write --scales 0.5,1,2",
            ));
        }
        let overrides = self.overrides.all();
        let scene = Scene::load(&self.scene, &overrides, 1.0)?;
        if scene.probes.is_empty() {
            return Err(Error::input(
                self.scene.display().to_string(),
                "has no probe, and the study is one of probes",
                "add a [[probe]], such as name = \"front\" and front = { axis = \"x\" }",
            ));
        }
        let out = self.out.clone().unwrap_or_else(|| {
            let stem = self.scene.file_stem().unwrap_or_default();
            Path::new("out").join(format!("{}_converge", stem.to_string_lossy()))
        });
        let settings = refined(&scene, &overrides, self.steps, self.elements)?;
        let options = Options {
            scene: self.scene.clone(),
            without: Vec::new(),
            scale: 1.0,
            frames: self.frames,
            backend: self.backend.backend().name(),
            out: out.clone(),
        };
        let sweep = Sweep::of_scales(&scales, settings, options)?;
        let sweep_command = SweepCommand {
            scene: self.scene.clone(),
            settings: Vec::new(),
            without: Vec::new(),
            scale: 1.0,
            backend: self.backend.clone(),
            out: Some(out.clone()),
            frames: self.frames,
            preview: false,
            keep_going: self.keep_going,
            jobs: self.jobs,
            shard: Shard { index: 1, count: 1 },
            overwrite: self.overwrite,
            list: false,
        };
        sweep_command.complete(&sweep, &out, program)?;
        let study = Study::new(&sweep);
        print_study(&study);
        for file in study.write(&out)? {
            say!("{}", file.display());
        }
        Ok(())
    }
}

fn print_study(study: &Study) {
    let names = study.quantities.iter().map(|row| row.probe.len());
    let width = names.max().unwrap_or(0).max(5);
    let scales = study.scales.iter().map(|scale| format!("{:>12}", format!("x {scale}")));
    say!(
        "\n{:width$} {:8} {} {:>6} {:>12} {:>8}  verdict",
        "probe",
        "quantity",
        scales.collect::<String>(),
        "order",
        "estimate",
        "error %"
    );
    for row in &study.quantities {
        let values = row.values.iter().map(|value| format!("{value:>12.5e}"));
        let or_dash = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
        let convergence = row.convergence;
        say!(
            "{:width$} {:8} {} {:>6} {:>12} {:>8}  {}",
            row.probe,
            row.quantity,
            values.collect::<String>(),
            or_dash(convergence.order.map(|order| format!("{order:.2}"))),
            or_dash(convergence.estimate.map(|estimate| format!("{estimate:.5e}"))),
            or_dash(row.error.map(|error| format!("{:.2}", 100.0 * error))),
            convergence.verdict.name()
        );
    }
}
