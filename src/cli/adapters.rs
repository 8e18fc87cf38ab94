//! `cutwater adapters`

use cutwater::Error;
use cutwater::gpu::Gpu;

/// List the GPU adapters
#[derive(Debug, clap::Args)]
pub(super) struct Adapters {}

impl Adapters {
    pub(super) fn run(&self) -> Result<(), Error> {
        let adapters = Gpu::adapters();
        if adapters.is_empty() {
            // Opening one gives the message with the cure.
            return Gpu::new(&Default::default()).map(|_| ());
        }
        for (index, adapter) in adapters.iter().enumerate() {
            say!(
                "{index}: {} ({}, {})",
                adapter.name,
                adapter.kind,
                adapter.backend
            );
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
        Ok(())
    }
}

fn yes(value: bool) -> &'static str {
    if value { "yes" } else { "no" }
}
