//! Incompatible boundary flux: prescribed motion that would change the volume of an enclosed liquid component. The
//! f64 twins are [`PressureSystem::squeezed`](crate::reference::PressureSystem::squeezed) and, where liquid may separate,
//! [`PressureSystem::take_growing`](crate::reference::PressureSystem::take_growing).

use std::collections::BTreeMap;

use glam::DVec3;

use crate::Error;
use crate::effects::Effects;
use crate::geometry::{CellNode, SolidClip};
use crate::gpu::{Gpu, Readback, Recorder};
use crate::grid::Grid;
use crate::reference::SQUEEZE;
use crate::scene::{CouplingScheme, Scene};

use super::gpu_liquid::GpuLiquid;
use super::gpu_solids::GpuSolids;

/// Bits of the flags of a quad: lanes in closed components, and those with a face that is not all open (`shaders/common/active.wgsl`).
const CLOSED: usize = 4;
const HELD: usize = 12;

/// Readbacks of the check. Allocated at the start for prescribed nodes, otherwise on first use, because most liquid
/// has a free surface.
#[derive(Debug)]
pub(super) struct SqueezeReadbacks {
    flags: Readback<u32>,
    labels: Readback<u32>,
    /// Velocities of the nodes, with prescribed nodes.
    velocity: Option<Readback<u32>>,
}

/// Whether prescribed nodes can cause an incompatible flux. Weak coupling does not constrain it.
fn nodes_prescribed(scene: &Scene) -> bool {
    let effects = Effects::of(scene);
    effects.coupling && effects.scripts && scene.solver.coupling != CouplingScheme::Weak
}

/// Whether any prescribed motion can cause an incompatible flux.
pub(super) fn can_squeeze(scene: &Scene) -> bool {
    let effects = Effects::of(scene);
    nodes_prescribed(scene) || effects.moving_obstacles || effects.sources
}

/// Whether closed liquid may open, given that liquid may separate. The weaker couplings do not constrain its volume in the same solve.
pub(super) fn can_open(scene: &Scene) -> bool {
    !Effects::of(scene).coupling || scene.solver.coupling == CouplingScheme::Strong
}

impl SqueezeReadbacks {
    /// Readbacks allocated at the start; `None` without prescribed nodes.
    pub(super) fn at_start(
        gpu: &Gpu,
        scene: &Scene,
        solids: Option<&GpuSolids>,
    ) -> Result<Option<SqueezeReadbacks>, Error> {
        let moved = solids.filter(|_| nodes_prescribed(scene));
        let allocate = |solids: &GpuSolids| {
            let len = solids.buffers.velocity.words.len();
            let velocity = Some(Readback::new(gpu, "squeeze.velocity", len)?);
            Ok(SqueezeReadbacks { velocity, ..SqueezeReadbacks::new(gpu, &scene.grid())? })
        };
        moved.map(allocate).transpose()
    }

    /// Readbacks without node velocities.
    fn new(gpu: &Gpu, grid: &Grid) -> Result<SqueezeReadbacks, Error> {
        let padded = grid.padded();
        Ok(SqueezeReadbacks {
            flags: Readback::new(gpu, "squeeze.flags", padded.quads)?,
            labels: Readback::new(gpu, "squeeze.labels", padded.len())?,
            velocity: None,
        })
    }
}

/// Enclosed components whose volume prescribed motion would change.
#[derive(Debug, Default)]
pub(super) struct Squeeze {
    /// Largest change relative to the prescribed flux, of those that stay full.
    pub share: f64,
    /// Cells (scalar indices of the padded grid) whose walls recede, of components that open.
    pub receding: Vec<u32>,
}

/// Prescribed motion at enclosed components. `prescribed`: flux of obstacles and sources, m^3/s. `solids` adds J v of their nodes, which
/// are all prescribed beside such a component. `opens`: whether components whose room grows open.
/// Waits for all submitted work.
pub(super) fn squeezed(
    gpu: &Gpu,
    readbacks: &mut Option<SqueezeReadbacks>,
    liquid: &GpuLiquid,
    solids: Option<(&GpuSolids, &SolidClip)>,
    prescribed: impl IntoIterator<Item = (usize, f64)>,
    opens: bool,
) -> Result<Squeeze, Error> {
    let mut cell_flux = BTreeMap::<usize, f64>::new();
    for (cell, flux) in prescribed {
        *cell_flux.entry(cell).or_default() += flux;
    }
    let has_nodes = |readbacks: &SqueezeReadbacks| readbacks.velocity.is_some();
    let solids = solids.filter(|_| readbacks.as_ref().is_some_and(has_nodes));
    if solids.is_none() && cell_flux.is_empty() {
        return Ok(Squeeze::default());
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
        let node_velocity = &solids.buffers.velocity;
        to.read(&node_velocity.words, velocity);
        to.submit();
        let velocity = node_velocity.widen(&velocity.wait(gpu)?);
        for (cell, pairs) in clip.coupling().cells() {
            let flux = |pair: &CellNode| pair.value.dot(DVec3::from_slice(&velocity[4 * pair.node..]));
            *cell_flux.entry(cell).or_default() += pairs.iter().map(flux).sum::<f64>();
        }
    } else {
        to.submit();
    }
    let (flags, labels) = (readbacks.flags.wait(gpu)?, readbacks.labels.wait(gpu)?);
    let padded = grid.padded();
    let mut components = BTreeMap::<u32, Component>::new();
    for (cell, flux) in cell_flux {
        let index = padded.index(grid.cell_at(cell));
        let flag = |first: usize| flags[index / 4] >> (first + index % 4) & 1 == 1;
        if flag(CLOSED) {
            let component = components.entry(labels[index]).or_default();
            component.net += flux;
            component.gross += flux.abs();
            component.receding.extend((flux > 0.0 && flag(HELD)).then_some(index as u32));
        }
    }
    let mut squeeze = Squeeze::default();
    for component in components.into_values() {
        if opens && component.net > SQUEEZE * component.gross && !component.receding.is_empty() {
            squeeze.receding.extend(component.receding);
        } else if component.gross > 0.0 {
            squeeze.share = squeeze.share.max(component.net.abs() / component.gross);
        }
    }
    Ok(squeeze)
}

/// An enclosed component: sum of its prescribed flux and of the absolute values, m^3/s, and the cells whose walls recede.
#[derive(Default)]
struct Component {
    net: f64,
    gross: f64,
    receding: Vec<u32>,
}
