//! Arguments to one function per command; errors to exit codes.

mod adapters;
mod bench;
mod preview;

use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};
use cutwater::gpu::AdapterChoice;

/// Two-way coupling between inviscid free-surface liquids and elastic solids, on the GPU, without a window.
#[derive(Debug, Parser)]
#[command(version, about)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// List the GPU adapters
    Adapters(adapters::Adapters),
    /// Measure the solve or the whole step
    Bench(bench::Bench),
    /// Draw the frames of a run as pictures and an animation
    Preview(preview::Preview),
}

/// Which adapter.
#[derive(Debug, Args)]
struct AdapterArgs {
    /// Adapter by index, kind (discrete, integrated, virtual, software) or part of its name; the best by default
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,
}

impl AdapterArgs {
    fn choice(&self) -> AdapterChoice {
        self.adapter.as_deref().map_or(AdapterChoice::Best, |name| {
            name.parse()
                .unwrap_or_else(|never: std::convert::Infallible| match never {})
        })
    }
}

/// Parses the arguments, runs the command, prints its error.
pub(crate) fn main() -> ExitCode {
    let cli = Cli::parse();
    let done = match &cli.command {
        Command::Adapters(command) => command.run(),
        Command::Bench(command) => command.run(),
        Command::Preview(command) => command.run(),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}
