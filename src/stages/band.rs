//! `band`: the quads that the other stages work on.
//!
//! Tiles of 8 x 8 x 8 cells that hold liquid, dilated by what extrapolation and advection reach in a sub-step; every quad of a
//! dilated tile is in the band. The list is row-major, so neighbours in it are neighbours in memory.

use crate::Error;
use crate::gpu::{Bound, CompactKernels, Compaction, Gpu, Kernel, Real, Recorder};
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

/// The stage.
#[derive(Debug)]
pub struct Band {
    occupy: Option<(Bound, usize)>,
    n_tiles: usize,
    dilate_tiles: Bound,
    flag_band: Bound,
    compaction: Compaction,
}

impl Band {
    /// The stage's name.
    pub const NAME: &'static str = "band";

    /// Compiles and binds.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind`].
    pub fn new(
        gpu: &Gpu,
        compact: &CompactKernels,
        buffers: &LiquidBuffers,
    ) -> Result<Band, Error> {
        let level = ("level", (&buffers.level).into());
        let step = ("step", (&buffers.step).into());
        let tiles = ("tiles", (&buffers.tiles).into());
        let marks = ("marks", (&buffers.marks).into());
        let dilated = ("dilated", (&buffers.dilated).into());
        let kernel = |source| Kernel::new(gpu, &source, Real::F32);
        let mark = |markers: &super::MarkerBuffers| {
            let positions = ("markers", (&markers.positions).into());
            let occupied = ("occupied", (&markers.occupied).into());
            let occupy = kernel(wgsl!("occupy"))?
                .bind(gpu, &[level, step, tiles, positions, occupied, marks])?;
            Ok::<_, Error>((occupy, markers.positions.len()))
        };
        Ok(Band {
            occupy: buffers.markers.as_ref().map(mark).transpose()?,
            n_tiles: buffers.plan.tiles().len(),
            dilate_tiles: kernel(wgsl!("dilate_tiles"))?.bind(gpu, &[tiles, marks, dilated])?,
            flag_band: kernel(wgsl!("flag_band"))?.bind(
                gpu,
                &[
                    level,
                    step,
                    tiles,
                    dilated,
                    marks,
                    ("flags", (&buffers.band_flags).into()),
                    ("liquid_distance", (&buffers.liquid_distance).into()),
                    ("valid", (&buffers.valid).into()),
                    ("valid_next", (&buffers.valid_next).into()),
                ],
            )?,
            compaction: Compaction::new(
                gpu,
                compact,
                &buffers.band_flags,
                &buffers.band_list,
                &buffers.band_args,
                &buffers.band_scratch,
                [0, buffers.band_flags.len()],
                0,
            )?,
        })
    }

    /// Records it. With `surface = "fixed"` once, after the state was written; with markers in every sub-step.
    pub fn record(&self, recorder: &mut Recorder) {
        recorder.stage(Band::NAME, |pass| {
            if let Some((occupy, n_markers)) = &self.occupy {
                pass.dispatch(occupy, *n_markers);
            }
            pass.dispatch(&self.dilate_tiles, self.n_tiles);
            pass.dispatch(&self.flag_band, TILE * self.n_tiles);
            self.compaction.record(pass);
        });
    }
}
