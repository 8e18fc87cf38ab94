//! The command line of cutwater: see `cutwater --help` and the README.

fn main() -> std::process::ExitCode {
    cutwater::cli::main(std::env::args_os(), None).into()
}
