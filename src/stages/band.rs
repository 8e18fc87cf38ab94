//! `band`: the quads that the other stages work on.
//!
//! Tiles of 8 x 8 x 8 cells that hold liquid, dilated by what extrapolation and advection reach in a sub-step; every quad of a
//! dilated tile is in the band. The list is row-major, so neighbours in it are neighbours in memory.

use crate::Error;
use crate::gpu::{CompactKernels, Compaction, Dispatches, Gpu, Kernel, Real};
use crate::step::Stage;
use crate::wgsl;

use super::{LiquidBuffers, extrapolation_layers};

/// Cells along the edge of a tile, two quads; `shaders/common/tiles.wgsl` has it too.
const TILE: usize = 8;

/// Tiles that cover every cell and every face: the doppelganger of `Tiles` in `shaders/common/tiles.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Tiles {
    /// Tiles along x, y, z.
    pub n: [u32; 3],
    /// Tiles that the band reaches beyond those with liquid.
    pub reach: u32,
}

impl Tiles {
    /// The tiles of a grid. A marker makes cells active within one cell of its own, their plus faces are one further, and the
    /// extrapolation adds its layers; in what cuts the grid the extension of the liquid distance adds one more active cell.
    pub fn new(cells: [usize; 3], cfl: f64, cuts: bool) -> Tiles {
        let reach = extrapolation_layers(cfl) + 2 + usize::from(cuts);
        Tiles {
            n: cells.map(|n| (n / TILE + 1) as u32),
            reach: reach.div_ceil(TILE) as u32,
        }
    }

    /// Number of tiles.
    pub fn len(&self) -> usize {
        self.n.iter().map(|&n| n as usize).product()
    }

    /// Whether there are none; never, kept for the pair with [`Tiles::len`].
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The tile of a cell.
    pub fn of(&self, [i, j, k]: [usize; 3]) -> usize {
        let [nx, ny, _] = self.n.map(|n| n as usize);
        i / TILE + nx * (j / TILE + ny * (k / TILE))
    }
}

/// The stage. With `surface = "fixed"` it runs once, after the state was written; with markers in every sub-step.
///
/// # Errors
/// As [`Kernel::new`] and [`Kernel::bind_arrays`].
pub fn band(gpu: &Gpu, liquid: &LiquidBuffers) -> Result<Dispatches, Error> {
    let gpu = &gpu.at(Stage::Band.name());
    let bound = |source| Kernel::new(gpu, &source, Real::F32)?.bind_arrays(gpu, &[liquid]);
    let n_tiles = liquid.plan.tiles().len();
    let mut list = Vec::new();
    if let Some(markers) = &liquid.markers {
        list.push(bound(wgsl!("occupy"))?.threads(markers.len()));
    }
    list.push(bound(wgsl!("dilate_tiles"))?.threads(n_tiles));
    list.push(bound(wgsl!("flag_band"))?.threads(TILE * n_tiles));
    let compaction = Compaction::new(
        gpu,
        &CompactKernels::new(gpu)?,
        &liquid.band_flags,
        &liquid.band_list,
        &liquid.band_args,
        &liquid.band_scratch,
        [0, liquid.band_flags.len()],
        0,
    )?;
    list.extend(compaction.into_dispatches());
    Ok(Dispatches::new(Stage::Band.name(), list))
}
