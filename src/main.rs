//! The command line of cutwater: see `cutwater --help` and the README.

mod cli;

fn main() -> std::process::ExitCode {
    cli::main()
}
