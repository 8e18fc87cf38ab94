//! `cutwater bench sort`

use std::path::PathBuf;

use clap::Args;
use cutwater::Error;
use cutwater::gpu::Gpu;
use cutwater::measure::bench_sort;

use super::{at_least_once, tell_machine};
use crate::cli::AdapterArgs;

#[derive(Debug, Args)]
pub(super) struct Sort {
    /// Entries of the lists
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "N,N,..",
        default_value = "10000,100000,1000000",
        value_parser = clap::value_parser!(u32).range(1..)
    )]
    entries: Vec<u32>,
    /// Bits of the keys
    #[arg(long, default_value_t = 32, value_parser = clap::value_parser!(u32).range(1..=32))]
    bits: u32,
    /// Timed runs per row
    #[arg(long, default_value_t = 5, value_parser = at_least_once())]
    repeats: usize,
    /// Folder of the results
    #[arg(long, default_value = "out/bench_sort")]
    out: PathBuf,
    #[command(flatten)]
    adapter: AdapterArgs,
}

impl Sort {
    pub(super) fn run(&self) -> Result<(), Error> {
        let gpu = Gpu::new(&self.adapter.choice())?;
        let options = bench_sort::Options {
            entries: self.entries.iter().map(|&n| n as usize).collect(),
            bits: self.bits,
            repeats: self.repeats,
        };
        say!("  entries  bits  ms (least, largest)  of copy bandwidth");
        let table = bench_sort::bench_sort(&gpu, &options, &self.out, &mut |row| {
            say!(
                "{:9}  {:4}  {:.2} ({:.2}, {:.2})  {:.0} %",
                row.entries,
                row.bits,
                1e3 * row.seconds_median,
                1e3 * row.seconds_min,
                1e3 * row.seconds_max,
                100.0 * row.share_of_copy_bandwidth,
            );
        })?;
        tell_machine(&table.machine);
        say!("tables: {}", self.out.display());
        Ok(())
    }
}
