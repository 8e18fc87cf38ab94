//! The part of `right_hand_side` for liquid that fills cavities of solids (twin: reference/cavities.rs).

use bytemuck::{Pod, Zeroable};

use crate::Error;
use crate::fields::{CouplingBuffers, LiquidBuffers, SolverBuffers};
use crate::gpu::{Bound, Buffer, Gpu, Kernel, Pass};
use crate::step::Stage;
use crate::wgsl;

use super::Components;

/// `root` of a cavity that no sealed liquid touches.
const NONE: u32 = u32::MAX;
/// Words of [`Cavity`].
const WORDS: usize = size_of::<Cavity>() / 4;

/// A cavity and the liquid in it, as in `shaders/common/cavities.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Cavity {
    /// Smallest root of the sealed components that touch it.
    pub root: u32,
    /// Open volume of that component, 2^-23 cells: low word.
    pub low: u32,
    /// High word.
    pub high: u32,
    /// Source, volumes of a cell per second.
    pub source: f32,
    /// Least open volume that fills the cavity, cells.
    pub least: f32,
    /// Largest.
    pub largest: f32,
}

impl Cavity {
    /// Of volumes (m^3) that fill it, from the least to the largest, and a source, m^3/s.
    fn new(fills: [f64; 2], source: f64, cell_volume: f64) -> Cavity {
        let [least, largest, source] = [fills[0], fills[1], source].map(|volume| (volume / cell_volume) as f32);
        Cavity { root: NONE, low: 0, high: 0, source, least, largest }
    }

    fn is_filled(&self) -> bool {
        let open = (u64::from(self.high) << 32 | u64::from(self.low)) as f64 / f64::from(1 << 23);
        self.root != NONE && (f64::from(self.least)..=f64::from(self.largest)).contains(&open)
    }
}

/// The kernels and their cavities.
#[derive(Debug)]
pub struct FilledCavities {
    /// Words of [`Cavity`].
    cavities: Buffer<u32>,
    roots: Bound,
    volumes: Bound,
    fill: Bound,
    n_quads: usize,
}

impl FilledCavities {
    /// Compiles and binds. `of_node`: cavity of each node, from 1, 0 for none; `n`: number of cavities.
    pub fn new(
        gpu: &Gpu,
        (liquid, solver, coupling): (&LiquidBuffers, &SolverBuffers, &CouplingBuffers),
        of_node: &[u32],
        n: usize,
    ) -> Result<FilledCavities, Error> {
        let nodes = gpu.buffer("coupling.cavity_of_node", of_node.len())?;
        gpu.upload(&nodes, of_node);
        let cavities = gpu.buffer("coupling.cavities", WORDS * n)?;
        let gpu = &gpu.at(Stage::RightHandSide.name());
        let own = [("cavity_of_node", (&nodes).into()), ("cavities", (&cavities).into())];
        let kernel = |source| Kernel::new(gpu, &source, solver.variant.real);
        let roots = kernel(wgsl!("cavity_roots"))?.bind(gpu, &own, &[coupling, solver])?;
        let volumes = kernel(wgsl!("cavity_volumes"))?.bind(gpu, &own[1..], &[liquid, solver])?;
        let fill = kernel(wgsl!("fill_cavities"))?.bind(gpu, &own[1..], &[liquid, solver])?;
        Ok(FilledCavities { cavities, roots, volumes, fill, n_quads: coupling.size.quads })
    }

    /// Writes the least and the largest volumes that fill the cavities (m^3) and their sources (m^3/s), before all work submitted later.
    pub fn write(&self, gpu: &Gpu, cavities: impl Iterator<Item = ([f64; 2], f64)>, cell_volume: f64) {
        let cavities: Vec<Cavity> = cavities.map(|(fills, source)| Cavity::new(fills, source, cell_volume)).collect();
        gpu.upload(&self.cavities, bytemuck::cast_slice(&cavities));
    }

    /// Records, after the right-hand side of the liquid, with the labels of `components`.
    pub fn record(&self, pass: &mut Pass, components: &Components) {
        pass.dispatch(&self.roots, self.n_quads);
        pass.dispatch_indirect(&self.volumes, components.sizes(), 0);
        pass.dispatch_indirect(&self.fill, components.sizes(), 0);
    }

    /// The words of the cavities, which [`FilledCavities::filled`] decodes.
    pub fn words(&self) -> &Buffer<u32> {
        &self.cavities
    }

    /// Whether liquid fills each cavity.
    pub fn filled(words: &[u32]) -> impl Iterator<Item = bool> + '_ {
        words
            .chunks_exact(WORDS)
            .map(|words| bytemuck::pod_read_unaligned::<Cavity>(bytemuck::cast_slice(words)).is_filled())
    }
}
