//! `cutwater adapters`

use crate::Error;
use crate::gpu::{Gpu, Surroundings};

/// List the GPU adapters
#[derive(Debug, clap::Args)]
pub(super) struct Adapters {
    /// Also list the Vulkan loader, drivers and devices
    #[arg(long)]
    explain: bool,
}

impl Adapters {
    pub(super) fn run(&self) -> Result<(), Error> {
        let adapters = Gpu::adapters();
        for (index, adapter) in adapters.iter().enumerate() {
            say!("{index}: {} ({}, {})", adapter.name, adapter.kind, adapter.backend);
            say!("   driver {}", adapter.driver);
            say!(
                "   f64 {}, timestamps {}, {} storage buffers per kernel, {} MiB per binding, {} MiB per buffer",
                yes(adapter.f64),
                yes(adapter.timestamps),
                adapter.storage_buffers,
                adapter.storage_binding >> 20,
                adapter.buffer >> 20,
            );
        }
        // Other systems include drivers.
        if cfg!(target_os = "linux") {
            let surroundings = Surroundings::of_system();
            if self.explain || adapters.is_empty() {
                surroundings.facts().iter().for_each(|fact| say!("{fact}"));
            }
            let hardware = adapters.iter().any(|adapter| adapter.kind != "software");
            if !adapters.is_empty() {
                let cures = surroundings.cures(hardware);
                cures.iter().for_each(|cure| say!("hint: {cure}"));
            }
        }
        match adapters.is_empty() {
            // The error has the cure.
            true => Gpu::new(&Default::default()).map(|_| ()),
            false => Ok(()),
        }
    }
}

fn yes(value: bool) -> &'static str {
    if value { "yes" } else { "no" }
}
