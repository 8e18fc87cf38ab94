//! Volumes that a level exchanges through sources, sinks and open sides (see the twin, `reference/level_exchange.rs`).
//!
//! Sums are integers of 64 bits, so that they do not depend on the order of the threads.

use crate::Error;
use crate::fields::{ExchangeBuffers, LevelBuffers, LevelExchange, LiquidBuffers, Sources};
use crate::gpu::{Arrays, Bound, Dispatch, Dispatches, Gpu, Kernel, Real, Source};
use crate::step::Stage;
use crate::wgsl;

/// A kernel with its arrays.
fn bound(gpu: &Gpu, source: Source, tables: &[&dyn Arrays]) -> Result<Bound, Error> {
    Kernel::new(gpu, &source, Real::F32)?.bind(gpu, &[], tables)
}

/// The part of `advect_level` after the transport: sources fill their cells, sinks empty theirs. Volumes that leave are
/// subtracted from the targets of their components.
pub fn exchange_level(
    gpu: &Gpu,
    liquid: &LiquidBuffers,
    level: &LevelBuffers,
    taps: ExchangeBuffers,
) -> Result<Option<Dispatches>, Error> {
    let gpu = &gpu.at(Stage::AdvectLevel.name());
    let Some(exchange) = taps.level else {
        return Ok(None);
    };
    let mut list = Vec::new();
    if let Some(sources) = taps.sources {
        let fill = bound(gpu, wgsl!("fill_sources"), &[liquid, level, exchange, sources])?;
        list.push(fill.threads(exchange.n_fills()));
    }
    let mut settle = Vec::new();
    if let Some(cells) = &exchange.outlet_cells {
        let outflow = bound(gpu, wgsl!("outflow"), &[liquid, level, exchange])?;
        list.push(outflow.threads(exchange.n_outlets()));
        settle.push(cells);
    }
    if let Some(sinks) = taps.sinks {
        let sink = bound(gpu, wgsl!("sink_volumes"), &[liquid, level, exchange, sinks])?;
        list.push(sink.threads(sinks.cells.len()));
        settle.push(&sinks.cells);
    }
    for cells in settle {
        let kernel = Kernel::new(gpu, &wgsl!("settle_removed"), Real::F32)?;
        let bound = kernel.bind(gpu, &[("cells", cells.into())], &[level, exchange])?;
        list.push(bound.threads(cells.len()));
    }
    let stage = Dispatches::new(Stage::AdvectLevel.name(), list);
    Ok(Some(stage.clearing(&exchange.exchange_totals)))
}

/// The parts of `liquid_components`: volumes of sources, before the sums over all components; the exchange of the whole liquid,
/// before the targets; their limits and the report, after them.
pub(super) fn share_exchange(
    gpu: &Gpu,
    liquid: &LiquidBuffers,
    level: &LevelBuffers,
    taps: ExchangeBuffers,
) -> Result<[Vec<Dispatch>; 3], Error> {
    let Some(exchange) = taps.level else {
        return Ok(Default::default());
    };
    let sources = match taps.sources {
        Some(sources) => add_sources(gpu, (liquid, level), exchange, sources)?,
        None => Vec::new(),
    };
    let add = bound(gpu, wgsl!("add_exchange"), &[level, exchange])?;
    let mut last = Vec::new();
    if liquid.plan.effects.open_sides {
        let limit = bound(gpu, wgsl!("limit_targets"), &[liquid, level, exchange])?;
        last.push(limit.indirect(&liquid.band_args, 0));
    }
    let report = bound(gpu, wgsl!("report_exchange"), &[liquid, level, exchange])?;
    last.push(report.threads(1));
    Ok([sources, vec![add.threads(1)], last])
}

fn add_sources(
    gpu: &Gpu,
    (liquid, level): (&LiquidBuffers, &LevelBuffers),
    exchange: &LevelExchange,
    sources: &Sources,
) -> Result<Vec<Dispatch>, Error> {
    let count = bound(gpu, wgsl!("count_labelled"), &[sources, liquid, level, exchange])?;
    let kernel = Kernel::new(gpu, &wgsl!("add_sources"), Real::F32)?;
    let sums = [("sums", (&level.density_next).into())];
    let add = kernel.bind(gpu, &sums, &[sources, liquid, level, exchange])?;
    let n_cells = sources.n_cells();
    Ok(vec![count.threads(n_cells), add.threads(n_cells)])
}
