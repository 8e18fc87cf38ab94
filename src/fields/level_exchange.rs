//! Arrays for the volumes that enter and leave a level through sources, sinks and open sides.

use crate::Error;
use crate::arrays;
use crate::geometry::{Fill, Running, SourcesAndSinks};
use crate::gpu::Gpu;
use crate::grid::{Axis, Sides};

use super::{LiquidBuffers, Sinks, Sources};

/// Words of the totals (`common/exchange_totals.wgsl`).
const EXCHANGE_TOTALS: usize = 8;
/// Bit of an outlet face on a plus side. Also in `shaders/outflow.wgsl`.
const PLUS_SIDE: u32 = 1 << 31;
/// Mark of a fill at the side of a source. Also in `fill_sources.wgsl`.
const SIDE: u32 = u32::MAX;

arrays! {
    /// Volumes that a level exchanges. Sums are integers of 64 bits (`common/component_sums.wgsl`).
    pub struct LevelExchange in "exchange" {
        fields {
            n_outlets: usize,
        }
        sizes {
            n_cells: usize,
            n_fills: usize,
            n_source_cells: usize,
            n_sources: usize,
        }
        arrays {
            /// Volumes of the sub-step: left, sunk, of first fillings, added by the limits of the targets.
            pub array exchange_totals: u32 [EXCHANGE_TOTALS],
            /// Volumes that leave the components, at their labels before the sub-step. Zero outside the stage `advect_level`.
            array component_removed: [u32; 2] [n_cells] if n_cells > 0,
            /// Cells at open sides, one per face, padded indices.
            pub(crate) array outlet_cells: u32 [n_outlets] if n_outlets > 0,
            /// Faces of open sides, among the faces of all axes, with a bit on plus sides.
            array outlet_faces: u32 [n_outlets] if n_outlets > 0,
            /// Cells that sources fill, ascending: padded index, source, level (f32), index among the source cells from 1 or 0.
            array fills: [u32; 4] [n_fills] if n_sources > 0,
            /// Volumes that a starting source adds, per source cell, volumes of a cell.
            array first_fill: f32 [n_source_cells] if n_sources > 0,
            /// Volumes that the sources emit beyond their cells in the sub-step, volumes of a cell.
            array inflows: f32 [n_sources] if n_sources > 0,
            /// Cells of each source with a component.
            pub(crate) array labelled: u32 [n_sources] if n_sources > 0,
        }
        views {}
        parts {}
    }
}

impl LevelExchange {
    /// Allocates and writes the cells. Returns `None` where a level exchanges nothing.
    pub fn new(
        gpu: &Gpu,
        liquid: &LiquidBuffers,
        taps: &SourcesAndSinks,
        open_sides: Sides,
    ) -> Result<Option<LevelExchange>, Error> {
        let effects = &liquid.plan.effects;
        if !effects.level || !effects.exchange() {
            return Ok(None);
        }
        let (grid, padded) = (&liquid.plan.grid, &liquid.padded);
        let index = |cell: usize| padded.index(grid.cell_at(cell)) as u32;
        let outlets = Axis::ALL.into_iter().flat_map(|axis| {
            (0..grid.n_faces(axis)).filter_map(move |face| {
                let ijk = grid.face_at(axis, face);
                let side = grid.wall(axis, ijk).filter(|&side| open_sides.has(axis, side))?;
                let cell = grid.face_sides(axis, ijk)[1 - side]?;
                let at = axis.index() * padded.len() + padded.index(ijk);
                Some((index(cell), at as u32 | (PLUS_SIDE * side as u32)))
            })
        });
        let (outlet_cells, outlet_faces): (Vec<u32>, Vec<u32>) = outlets.unzip();
        let fill = |fill: Fill| {
            let level = (fill.level as f32).to_bits();
            let beside = if fill.side { SIDE } else { 0 };
            let number = fill.index.map_or(beside, |index| index as u32 + 1);
            [index(fill.cell), fill.source, level, number]
        };
        let fills: Vec<[u32; 4]> = taps.fills(grid).into_iter().map(fill).collect();
        let leaves = effects.open_sides || effects.sinks;
        let exchange = LevelExchange::allocate(
            gpu,
            outlet_cells.len(),
            if leaves { padded.len() } else { 0 },
            fills.len(),
            taps.source_cells.len(),
            taps.n_sources(),
        )?;
        let lists = [(&exchange.outlet_cells, outlet_cells), (&exchange.outlet_faces, outlet_faces)];
        for (array, values) in lists {
            if let Some(array) = array {
                gpu.upload(array, &values);
            }
        }
        if let Some(array) = &exchange.fills {
            gpu.upload(array, &fills);
        }
        Ok(Some(exchange))
    }

    /// Faces of open sides.
    pub fn n_outlets(&self) -> usize {
        self.n_outlets
    }

    /// Entries of the list of cells that sources fill.
    pub fn n_fills(&self) -> usize {
        self.fills.as_ref().map_or(0, |fills| fills.len())
    }

    /// Writes the volumes that the sources emit in a sub-step of dt (s).
    pub fn write_step(&self, gpu: &Gpu, taps: &SourcesAndSinks, sources: Running, (dt, cell_volume): (f64, f64)) {
        if let Some(array) = &self.inflows {
            let inflows = taps.inflows(sources, dt).map(|volume| (volume / cell_volume) as f32);
            gpu.upload(array, &inflows.collect::<Vec<_>>());
        }
    }
}

/// Sources, sinks and the exchange of a level on the device, as far as a scene has them.
#[derive(Clone, Copy, Debug, Default)]
pub struct ExchangeBuffers<'a> {
    /// Sources.
    pub sources: Option<&'a Sources>,
    /// Sinks.
    pub sinks: Option<&'a Sinks>,
    /// Volumes of a level.
    pub level: Option<&'a LevelExchange>,
}
