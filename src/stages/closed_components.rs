//! Stage `closed_components`: the liquid components without a free surface, whose pressure is fixed up to a constant.
//!
//! **Labels.** Union-find over the faces with weight. Every cell first points to its neighbour below, which makes trees without atomics
//! (Komura 2015). `atomicMin` then joins trees across faces between two of them (Playne and Hawick 2018). The root of a component is its
//! smallest cell, for every order of the threads. Only quads at surfaces and walls do more than read their neighbours' flags. Roots without a
//! free-surface face are counted, and those without a face at a wall, a solid or a source (ballistic ones). Without any of them nothing else
//! is dispatched.
//!
//! **Means.** Sums over a component are integer sums of 96 bits, so a run repeats bitwise, and f32 is as exact as f64. They share buffers
//! with the solve, which never runs at the same time.

use crate::Error;
use crate::fields::{CouplingBuffers, LiquidBuffers, SolverBuffers};
use crate::gpu::bind;
use crate::gpu::{Bound, Buffer, Gpu, Pass, RealBuffer};
use crate::step::Stage;
use crate::wgsl;

/// Words with the largest magnitude in closed components: of the right-hand side, of the potential.
const LARGEST: [u32; 2] = [4, 5];

/// The stage, in two parts: [`Components::label`] after `active_cells`, before anything asks which cells are closed, and
/// [`Components::remove_means`] once the right-hand side stands.
#[derive(Debug)]
pub struct Components {
    init: Bound,
    merge: Bound,
    open: Bound,
    gate: Bound,
    flag: Bound,
    opening: Option<Opening>,
    rhs: Shift,
    potential: Shift,
    /// Dispatch sizes: a thread per active quad where some component has no free surface or is ballistic; where some are closed fewer, with a run of quads
    /// each.
    sizes: Buffer<u32>,
}

impl Components {
    /// Compiles and binds. All fields are in [`SolverBuffers`]. `lifts`: the least potential of closed components is 0, as with separation, not
    /// their mean.
    pub fn new(gpu: &Gpu, buffers: &SolverBuffers, lifts: bool) -> Result<Components, Error> {
        let level = gpu.uniform("solver.level", &buffers.plan.level(0))?;
        let sizes = gpu.buffer("solver.closed_sizes", 8)?;
        let own = [("level", (&level).into()), ("sizes", (&sizes).into())];
        let gpu = &gpu.at(Stage::ClosedComponents.name());
        let bound = |source| bind(gpu, &source, buffers.variant.inner, own, &[buffers]);
        Ok(Components {
            init: bound(wgsl!("components_init"))?,
            merge: bound(wgsl!("components_merge"))?,
            open: bound(wgsl!("components_open"))?,
            gate: bound(wgsl!("components_gate"))?,
            flag: bound(wgsl!("components_flag"))?,
            opening: None,
            rhs: Shift::new(gpu, buffers, &buffers.rhs, (LARGEST[0], false))?,
            potential: Shift::new(gpu, buffers, &buffers.potential, (LARGEST[1], lifts))?,
            sizes,
        })
    }

    /// Records the labelling, with solids also by which components they seal. Afterwards bits 4 to 7 of [`SolverBuffers::flags`] say which
    /// lanes of a quad belong to closed components, bits 8 to 11 which belong to those without a free surface, closed or sealed, bits 20 to 23
    /// which belong to ballistic ones.
    pub fn label(&self, pass: &mut Pass, buffers: &SolverBuffers, seal: Option<&Seal>) {
        for bound in [&self.init, &self.merge, &self.open] {
            pass.dispatch_indirect(bound, &buffers.args, 0);
        }
        if let Some(seal) = seal {
            pass.dispatch(&seal.seal, seal.n_quads);
        }
        if let Some(opening) = self.opening.as_ref().filter(|opening| opening.active) {
            pass.dispatch(&opening.bound, opening.cells.len());
        }
        pass.dispatch(&self.gate, 1);
        pass.dispatch_indirect(&self.flag, &self.sizes, 0);
    }

    /// Enclosed components whose room grows, given by the cells (scalar indices of the padded grid) whose walls recede: until they are cleared,
    /// [`Components::label`] counts them as open, and adds the cells to those that separated in the last sub-step. With separation only.
    ///
    /// # Errors
    /// Where the device has no memory for the list.
    pub fn set_opening(
        &mut self,
        gpu: &Gpu,
        liquid: &LiquidBuffers,
        solver: &SolverBuffers,
        cells: &[u32],
    ) -> Result<(), Error> {
        let opening = match self.opening.take().filter(|opening| opening.cells.len() >= cells.len()) {
            Some(opening) => opening,
            None => Opening::new(gpu, liquid, solver, cells.len().next_power_of_two())?,
        };
        let mut list = cells.to_vec();
        list.resize(opening.cells.len(), u32::MAX);
        gpu.upload(&opening.cells, &list);
        self.opening = Some(Opening { active: true, ..opening });
        Ok(())
    }

    /// Ends [`Components::set_opening`].
    pub fn clear_opening(&mut self) {
        self.opening.iter_mut().for_each(|opening| opening.active = false);
    }

    /// Whether some components open in this sub-step.
    pub fn opens(&self) -> bool {
        self.opening.as_ref().is_some_and(|opening| opening.active)
    }

    /// Dispatch sizes of the labelling, for [`FilledCavities`](super::FilledCavities): first a thread per active quad where some component has no free
    /// surface.
    pub(super) fn sizes(&self) -> &Buffer<u32> {
        &self.sizes
    }

    /// Takes the mean over every closed component out of the right-hand side, without which the system has no solution.
    pub fn remove_means(&self, pass: &mut Pass) {
        self.rhs.record(pass, &self.sizes);
    }

    /// After the solve: gives the potential of every closed component its level.
    pub fn shift_potential(&self, pass: &mut Pass) {
        self.potential.record(pass, &self.sizes);
    }
}

/// Marks the components that open. Made when the first one does.
#[derive(Debug)]
struct Opening {
    bound: Bound,
    cells: Buffer<u32>,
    active: bool,
}

impl Opening {
    fn new(gpu: &Gpu, liquid: &LiquidBuffers, solver: &SolverBuffers, n_cells: usize) -> Result<Opening, Error> {
        let cells = gpu.buffer("solver.receding", n_cells)?;
        let gpu = &gpu.at(Stage::ClosedComponents.name());
        let own = [("receding", (&cells).into())];
        let bound = bind(gpu, &wgsl!("components_release"), solver.variant.inner, own, &[liquid, solver])?;
        Ok(Opening { bound, cells, active: false })
    }
}

/// Effect of solids on components without a free surface.
#[derive(Debug)]
pub struct Seal {
    seal: Bound,
    close: Bound,
    n_quads: usize,
}

impl Seal {
    /// Compiles and binds. `node_flags`: which components of the nodes give way; `velocity`: what nodes move with, m/s.
    pub fn new(
        gpu: &Gpu,
        buffers: &SolverBuffers,
        (node_flags, velocity): (&Buffer<u32>, &RealBuffer),
        coupling: &CouplingBuffers,
    ) -> Result<Seal, Error> {
        let own = [("node_flags", node_flags.into()), ("x", velocity.into())];
        let gpu = &gpu.at(Stage::ClosedComponents.name());
        let bound = |source| {
            let real = buffers.variant.real;
            bind(gpu, &source, real, own, &[coupling, buffers])
        };
        Ok(Seal {
            seal: bound(wgsl!("components_seal"))?,
            close: bound(wgsl!("couple_close"))?,
            n_quads: coupling.size.quads,
        })
    }

    /// Records, before the means are removed, what prescribed nodes take up of closed components.
    pub fn record_close(&self, pass: &mut Pass) {
        pass.dispatch(&self.close, self.n_quads);
    }
}

/// Shifts one field in closed components to the mean 0, or to the least value 0.
#[derive(Debug)]
struct Shift {
    largest: Bound,
    find: Bound,
    subtract: Bound,
}

impl Shift {
    fn new(
        gpu: &Gpu,
        buffers: &SolverBuffers,
        field: &RealBuffer,
        (largest, to_least): (u32, bool),
    ) -> Result<Shift, Error> {
        let settings = gpu.uniform("solver.closed_settings", &[largest, to_least.into(), 0, 0])?;
        let own = [
            ("settings", (&settings).into()),
            ("field", field.into()),
            // A word per cell of each, which only their own threads read in the solve, after writing it.
            ("high", (&buffers.outer).into()),
            ("middle", (&buffers.outer_partials).into()),
            ("low", (&buffers.partials).into()),
            ("count", (&buffers.q).into()),
        ];
        let gpu = &gpu.at(Stage::ClosedComponents.name());
        let bound = |source| bind(gpu, &source, field.real, own, &[buffers]);
        Ok(Shift {
            largest: bound(wgsl!("components_largest"))?,
            find: match to_least {
                true => bound(wgsl!("components_least"))?,
                false => bound(wgsl!("components_sum"))?,
            },
            subtract: bound(wgsl!("components_subtract"))?,
        })
    }

    fn record(&self, pass: &mut Pass, sizes: &Buffer<u32>) {
        pass.dispatch_indirect(&self.largest, sizes, 1);
        pass.dispatch_indirect(&self.find, sizes, 1);
        pass.dispatch_indirect(&self.subtract, sizes, 0);
    }
}
