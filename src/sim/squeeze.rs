//! How far solids that are moved, obstacles and sources squeeze liquid without a free surface; its twin is
//! [`PressureSystem::squeezed`](crate::reference::PressureSystem::squeezed).

use std::collections::BTreeMap;

use glam::DVec3;

use crate::Error;
use crate::effects::Effects;
use crate::geometry::{CellNode, SolidClip};
use crate::gpu::{Gpu, Readback, Recorder};
use crate::grid::Grid;
use crate::scene::{CouplingScheme, Scene};

use super::gpu_liquid::GpuLiquid;
use super::gpu_solids::GpuSolids;

/// Where what tells of it arrives: made at the start where nodes are moved, else where it is first asked for, since most liquid into which
/// obstacles or sources move has a surface.
#[derive(Debug)]
pub(super) struct SqueezeReadbacks {
    flags: Readback<u32>,
    labels: Readback<u32>,
    /// Of the nodes, where some are moved.
    velocity: Option<Readback<u32>>,
}

/// Whether nodes are moved that may squeeze liquid. In weak coupling they do not wait for it.
fn by_nodes(scene: &Scene) -> bool {
    let effects = Effects::of(scene);
    effects.coupling && effects.scripts && scene.solver.coupling != CouplingScheme::Weak
}

/// Whether anything in the scene can squeeze liquid.
pub(super) fn can_squeeze(scene: &Scene) -> bool {
    let effects = Effects::of(scene);
    by_nodes(scene) || effects.moving_obstacles || effects.sources
}

impl SqueezeReadbacks {
    /// Those of the start; `None` where no nodes are moved.
    ///
    /// # Errors
    /// [`Error::Limit`] when the adapter does not allow a size.
    pub(super) fn at_start(
        gpu: &Gpu,
        scene: &Scene,
        solids: Option<&GpuSolids>,
    ) -> Result<Option<SqueezeReadbacks>, Error> {
        let moved = solids.filter(|_| by_nodes(scene));
        let of_nodes = |solids: &GpuSolids| {
            let len = solids.buffers.velocity.words.len();
            let velocity = Some(Readback::new(gpu, "squeeze.velocity", len)?);
            Ok(SqueezeReadbacks {
                velocity,
                ..SqueezeReadbacks::new(gpu, &scene.grid())?
            })
        };
        moved.map(of_nodes).transpose()
    }

    /// Without nodes.
    fn new(gpu: &Gpu, grid: &Grid) -> Result<SqueezeReadbacks, Error> {
        let padded = grid.padded();
        Ok(SqueezeReadbacks {
            flags: Readback::new(gpu, "squeeze.flags", padded.quads)?,
            labels: Readback::new(gpu, "squeeze.labels", padded.len())?,
            velocity: None,
        })
    }
}

/// The largest share of what is taken of its cells (m^3/s) by which a component of the liquid without a free surface would have to change
/// its volume: `taken` by obstacles and sources, J v by the nodes of `solids`, if some are moved: beside such a component all are. Waits
/// for all submitted work.
pub(super) fn squeezed(
    gpu: &Gpu,
    readbacks: &mut Option<SqueezeReadbacks>,
    liquid: &GpuLiquid,
    solids: Option<(&GpuSolids, &SolidClip)>,
    taken: impl IntoIterator<Item = (usize, f64)>,
) -> Result<f64, Error> {
    let mut of_cells = BTreeMap::<usize, f64>::new();
    for (cell, flux) in taken {
        *of_cells.entry(cell).or_default() += flux;
    }
    let of_nodes = |readbacks: &SqueezeReadbacks| readbacks.velocity.is_some();
    let solids = solids.filter(|_| readbacks.as_ref().is_some_and(of_nodes));
    if solids.is_none() && of_cells.is_empty() {
        return Ok(0.0);
    }
    let grid = &liquid.buffers.plan.grid;
    let readbacks = match readbacks {
        Some(readbacks) => readbacks,
        none => none.insert(SqueezeReadbacks::new(gpu, grid)?),
    };
    let moved = solids.zip(readbacks.velocity.as_mut());
    let mut to = Recorder::new(gpu);
    to.read(&liquid.solver.flags, &mut readbacks.flags);
    to.read(&liquid.solver.labels, &mut readbacks.labels);
    if let Some(((solids, clip), velocity)) = moved {
        let of_nodes = &solids.buffers.velocity;
        to.read(&of_nodes.words, velocity);
        to.submit();
        let velocity = of_nodes.widen(&velocity.wait(gpu)?);
        for (cell, pairs) in clip.coupling().cells() {
            let flux = |pair: &CellNode| {
                pair.value
                    .dot(DVec3::from_slice(&velocity[4 * pair.node..]))
            };
            *of_cells.entry(cell).or_default() += pairs.iter().map(flux).sum::<f64>();
        }
    } else {
        to.submit();
    }
    let (flags, labels) = (readbacks.flags.wait(gpu)?, readbacks.labels.wait(gpu)?);
    let padded = grid.padded();
    let mut sums = BTreeMap::<u32, [f64; 2]>::new();
    for (cell, flux) in of_cells {
        let index = padded.index(grid.cell_at(cell));
        // Bits 4 to 7: see `shaders/common/active.wgsl`.
        if flags[index / 4] >> (4 + index % 4) & 1 == 1 {
            let [net, gross] = sums.entry(labels[index]).or_default();
            *net += flux;
            *gross += flux.abs();
        }
    }
    let shares = sums.values().filter(|[_, gross]| *gross > 0.0);
    Ok(shares.fold(0.0, |most, [net, gross]| f64::max(most, net.abs() / gross)))
}
