//! How far solids that are moved, obstacles and sources squeeze liquid without a free surface; its twin is
//! [`PressureSystem::squeezed`](crate::reference::PressureSystem::squeezed).

use std::collections::BTreeMap;

use glam::DVec3;

use crate::Error;
use crate::effects::Effects;
use crate::geometry::{CellNode, SolidClip};
use crate::gpu::{BufferPlan, Gpu, Readback, Real, Recorder};
use crate::scene::{CouplingScheme, Scene};

use super::gpu_liquid::GpuLiquid;
use super::gpu_solids::GpuSolids;

/// Where what tells of solids that are moved arrives.
#[derive(Debug)]
pub(super) struct SqueezeReadbacks {
    flags: Readback<u32>,
    labels: Readback<u32>,
    velocity: Readback<u32>,
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
    /// Everything that they allocate.
    pub(super) fn buffers(scene: &Scene, n_nodes: usize, real: Real) -> Vec<BufferPlan> {
        if !by_nodes(scene) {
            return Vec::new();
        }
        let padded = scene.grid().padded();
        // Four numbers per node.
        let words = real.bytes() * n_nodes;
        vec![
            BufferPlan::of::<u32>("coupling.flags (read-back)", padded.quads),
            BufferPlan::of::<u32>("coupling.labels (read-back)", padded.len()),
            BufferPlan::of::<u32>("coupling.velocity (read-back)", words),
        ]
    }

    /// `None` where no nodes are moved.
    ///
    /// # Errors
    /// [`Error::Limit`] when the adapter does not allow a size.
    pub(super) fn new(
        gpu: &Gpu,
        scene: &Scene,
        solids: &GpuSolids,
    ) -> Result<Option<SqueezeReadbacks>, Error> {
        if !by_nodes(scene) {
            return Ok(None);
        }
        let padded = scene.grid().padded();
        let velocity = solids.buffers.velocity.words.len();
        Ok(Some(SqueezeReadbacks {
            flags: Readback::new(gpu, "coupling.flags", padded.quads)?,
            labels: Readback::new(gpu, "coupling.labels", padded.len())?,
            velocity: Readback::new(gpu, "coupling.velocity", velocity)?,
        }))
    }
}

/// The largest share of what is taken of its cells (m^3/s) by which a component of the liquid without a free surface would have to change
/// its volume: `taken` by obstacles and sources, J v by the nodes of `solids`, which are all moved beside such a component. Waits for
/// all submitted work.
pub(super) fn squeezed(
    gpu: &Gpu,
    liquid: &GpuLiquid,
    solids: Option<(&GpuSolids, &SolidClip, &mut SqueezeReadbacks)>,
    taken: impl IntoIterator<Item = (usize, f64)>,
) -> Result<f64, Error> {
    let mut of_cells = BTreeMap::<usize, f64>::new();
    for (cell, flux) in taken {
        *of_cells.entry(cell).or_default() += flux;
    }
    let (flags, labels) = match solids {
        None if of_cells.is_empty() => return Ok(0.0),
        None => (
            gpu.download(&liquid.solver.flags)?,
            gpu.download(&liquid.solver.labels)?,
        ),
        Some((solids, clip, readbacks)) => {
            let SqueezeReadbacks {
                flags,
                labels,
                velocity,
            } = readbacks;
            let of_nodes = &solids.buffers.velocity;
            let mut to = Recorder::new(gpu);
            to.read(&liquid.solver.flags, flags);
            to.read(&liquid.solver.labels, labels);
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
            (flags.wait(gpu)?, labels.wait(gpu)?)
        }
    };
    let grid = &liquid.buffers.plan.grid;
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
