//! `cutwater bench effects`

use std::path::PathBuf;

use clap::Args;
use cutwater::Error;
use cutwater::measure::bench_effects::{ABSENT, Options, Row, Told, bench_effects};
use cutwater::measure::output_cost::OutputRow;
use cutwater::scene::Scene;

use super::tell_machine;
use crate::cli::AdapterArgs;

#[derive(Debug, Args)]
pub(super) struct Effects {
    /// Scene files (TOML)
    #[arg(required = true)]
    scenes: Vec<PathBuf>,
    /// Multiply domain.cells, rounded
    #[arg(long, default_value_t = 1.0)]
    scale: f64,
    /// Override a key of every scene; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    overrides: Vec<String>,
    /// Frames of each scene; a pair of sub-steps with and without each effect after each of them
    #[arg(long, default_value_t = 12, value_parser = clap::value_parser!(u64).range(1..))]
    frames: u64,
    /// Folder of the results
    #[arg(long, default_value = "out/bench_effects")]
    out: PathBuf,
    #[command(flatten)]
    adapter: AdapterArgs,
}

impl Effects {
    pub(super) fn run(&self) -> Result<(), Error> {
        let load = |path: &PathBuf| Scene::load(path, &self.overrides, self.scale);
        let options = Options {
            scenes: self.scenes.iter().map(load).collect::<Result<_, _>>()?,
            frames: self.frames,
            adapter: self.adapter.choice(),
        };
        let mut told = "";
        let tables = bench_effects(&options, &self.out, &mut |row| match row {
            Told::Effect(row) => {
                if told != "effects" {
                    say!(
                        "scene            effect            ms with, without  added (quartiles)        MiB     dispatches  seconds told                 kernels of its own"
                    );
                }
                told = "effects";
                say_effect(row);
            }
            Told::Output(row) => {
                if told != "outputs" {
                    say!(
                        "scene            output            ms a frame (quartiles)        KiB a frame"
                    );
                }
                told = "outputs";
                say_output(row);
            }
        })?;
        tell_machine(&tables.effects.machine);
        say!("tables and picture: {}", self.out.display());
        tables.verdict()
    }
}

fn say_effect(row: &Row) {
    // Their numbers are those of the row of all absent ones.
    if !row.present && row.effect != ABSENT {
        say!("{:16} {:16}  absent", row.scene, row.effect);
        return;
    }
    let Row {
        seconds_with: Some(with),
        seconds_without: Some(without),
        seconds_added: Some(added),
        seconds_added_low: Some(low),
        seconds_added_high: Some(high),
        bytes_added: Some(bytes),
        dispatches_added: Some(dispatches),
        ..
    } = *row
    else {
        say!("{:16} {:16}  all there is", row.scene, row.effect);
        return;
    };
    say!(
        "{:16} {:16}  {:7.2}, {:7.2}  {:7.2} ({:.2}, {:.2})  {:8.3}  {dispatches:9}  {:27}  {}",
        row.scene,
        row.effect,
        1e3 * with,
        1e3 * without,
        1e3 * added,
        1e3 * low,
        1e3 * high,
        bytes as f64 / (1u64 << 20) as f64,
        row.seconds_told,
        row.kernels,
    );
}

fn say_output(row: &OutputRow) {
    say!(
        "{:16} {:16}  {:7.2} ({:.2}, {:.2})  {:12.1}{}",
        row.scene,
        row.output,
        1e3 * row.seconds,
        1e3 * row.seconds_low,
        1e3 * row.seconds_high,
        row.bytes as f64 / 1024.0,
        if row.present {
            ""
        } else {
            "  off in the scene"
        },
    );
}
