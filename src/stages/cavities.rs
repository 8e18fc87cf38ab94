//! The part of `right_hand_side` for liquid that fills cavities of solids.

use crate::Error;
use crate::fields::{CouplingBuffers, LiquidBuffers, SolverBuffers};
use crate::gpu::{Bound, Buffer, Gpu, Kernel, Pass};
use crate::step::Stage;
use crate::wgsl;

use super::Components;

/// Word of a cavity that no liquid fills.
const NONE: u32 = u32::MAX;

/// The kernels, and the root of the liquid and the rate of the source of each cavity.
#[derive(Debug)]
pub struct FilledCavities {
    /// Two words per cavity: root, `NONE` before; rate, 1/s, f32.
    cavities: Buffer<u32>,
    roots: Bound,
    fill: Bound,
    n_quads: usize,
}

impl FilledCavities {
    /// Compiles and binds. `of_node`: cavity of each node, from 1, 0 for none; `n`: how many there are.
    pub fn new(
        gpu: &Gpu,
        (liquid, solver, coupling): (&LiquidBuffers, &SolverBuffers, &CouplingBuffers),
        of_node: &[u32],
        n: usize,
    ) -> Result<FilledCavities, Error> {
        let nodes = gpu.buffer("coupling.cavity_of_node", of_node.len())?;
        gpu.upload(&nodes, of_node);
        let cavities = gpu.buffer("coupling.cavities", 2 * n)?;
        let gpu = &gpu.at(Stage::RightHandSide.name());
        let roots = Kernel::new(gpu, &wgsl!("cavity_roots"), solver.variant.real)?;
        let own = [("cavity_of_node", (&nodes).into()), ("cavities", (&cavities).into())];
        let roots = roots.bind(gpu, &own, &[coupling, solver])?;
        let fill = Kernel::new(gpu, &wgsl!("fill_cavities"), solver.variant.real)?;
        let fill = fill.bind(gpu, &own[1..], &[liquid, solver])?;
        Ok(FilledCavities { cavities, roots, fill, n_quads: coupling.size.quads })
    }

    /// Writes the rates (1/s), before all work submitted later.
    pub fn write(&self, gpu: &Gpu, rates: impl Iterator<Item = f64>) {
        let words = rates.flat_map(|rate| [NONE, (rate as f32).to_bits()]);
        gpu.upload(&self.cavities, &words.collect::<Vec<u32>>());
    }

    /// Records, after the right-hand side of the liquid, with the labels of `components`.
    pub fn record(&self, pass: &mut Pass, components: &Components) {
        pass.dispatch(&self.roots, self.n_quads);
        pass.dispatch_indirect(&self.fill, components.sizes(), 0);
    }

    /// The words of the cavities, which [`FilledCavities::filled`] decodes.
    pub fn words(&self) -> &Buffer<u32> {
        &self.cavities
    }

    /// Whether liquid fills each cavity.
    pub fn filled(words: &[u32]) -> impl Iterator<Item = bool> + '_ {
        words.chunks_exact(2).map(|cavity| cavity[0] != NONE)
    }
}
