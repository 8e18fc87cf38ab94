//! `cutwater bench device`

use std::path::PathBuf;

use clap::Args;
use cutwater::Error;
use cutwater::gpu::Gpu;
use cutwater::measure::bench_device;

use super::at_least_once;
use crate::cli::AdapterArgs;

#[derive(Debug, Args)]
pub(super) struct Device {
    /// Timed runs per quantity
    #[arg(long, default_value_t = 5, value_parser = at_least_once())]
    repeats: usize,
    /// Folder of the results
    #[arg(long, default_value = "out/bench_device")]
    out: PathBuf,
    #[command(flatten)]
    adapter: AdapterArgs,
}

impl Device {
    pub(super) fn run(&self) -> Result<(), Error> {
        let gpu = Gpu::new(&self.adapter.choice())?;
        let table = bench_device::bench_device(&gpu, self.repeats, &self.out)?;
        say!(
            "adapter: {}, driver {}",
            table.machine.adapter,
            table.machine.driver
        );
        for row in &table.rows {
            say!(
                "{:16} {:.3e} {} ({:.3e}, {:.3e})",
                row.quantity,
                row.median,
                row.unit,
                row.min,
                row.max
            );
        }
        say!("tables: {}", self.out.display());
        Ok(())
    }
}
