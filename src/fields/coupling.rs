//! The coupling matrix J between liquid and solids in the units of the pressure's system, and the arrays of a coupled solve.

use rayon::prelude::*;

use crate::Error;
use crate::arrays;
use crate::geometry::{self, counting_sort};
use crate::gpu::{Gpu, Variant, WG_SIZE, groups};
use crate::grid::Grid;

use super::pressure_system::{FOLD_THREADS, SolverBuffers};
use super::solid_system::SolidSystemBuffers;

/// Lists of a coupled system after those of the levels, in the order of `shaders/coupled_args.wgsl`: nodes, solids, wet quads, and a
/// slot for the length of the partials.
pub(crate) const N_LISTS: usize = 4;
/// Slots of those lists, from the number of levels on.
pub(crate) const NODES: usize = 0;
pub(crate) const BODIES: usize = 1;
pub(crate) const WET: usize = 2;
pub(crate) const PARTIALS: usize = 3;

/// Words of [`CouplingBuffers::report`].
pub const REPORT_WORDS: usize = 16;

/// Share of zeta_M M in Z1.
const SIGMA: f32 = 0.5;

/// Sizes and units of J.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Coupling {
    /// Quads with patches.
    pub n_wet: u32,
    /// Nodes.
    pub n_nodes: u32,
    /// First word of where the pairs of the wet quads start.
    pub quad_starts: u32,
    /// First word of where the pairs of the nodes start.
    pub node_starts: u32,
    /// rho dx^3 / dt, kg/s.
    pub mass: f32,
    /// sigma.
    pub share: f32,
    /// Nothing.
    pub pad_0: u32,
    /// Nothing.
    pub pad_1: u32,
}

/// A cell and a node that patches join.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Index of the cell in the padded layout.
    pub cell: usize,
    /// Among the nodes of all solids.
    pub node: usize,
    /// Area over dx^2 times the unit normal into the solid, shared out by the weights at the patch's centroid.
    pub value: [f32; 3],
}

impl Pair {
    /// All pairs of a coupling matrix J, whose areas are in m^2.
    pub fn all(coupling: &geometry::Coupling, grid: &Grid) -> Vec<Pair> {
        let (padded, area) = (grid.padded(), grid.dx * grid.dx);
        let pairs = coupling.pairs().par_iter().map(|pair| Pair {
            cell: padded.index(grid.cell_at(pair.cell)),
            node: pair.node,
            value: (pair.value / area).as_vec3().to_array(),
        });
        pairs.collect()
    }
}

/// How much room there is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CouplingSize {
    /// Quads with patches, at most.
    pub quads: usize,
    /// Pairs, at most.
    pub pairs: usize,
}

/// J as last written.
#[derive(Debug, Default)]
pub(crate) struct Written {
    pub(crate) sizes: Coupling,
    pub(crate) pairs: Vec<Pair>,
}

arrays! {
    /// J, and the vectors of a coupled solve over nodes and wet quads.
    pub struct CouplingBuffers in "coupling" {
        fields {
            /// Room.
            pub size: CouplingSize,
            /// Nodes of all solids.
            pub n_nodes: usize,
            n_bodies: usize,
            n_levels: usize,
            pub(crate) variant: Variant,
            pub(crate) written: Written,
        }
        arrays {
            /// Sizes and units.
            pub uniform coupling: Coupling [Coupling::default()],
            /// Dispatch size and length of the lists of a coupled system.
            pub(crate) array sizes: u32 [4 * (N_LISTS + 1)],
            /// Dispatch size and length of all lists; after them the length of folded partials.
            pub(crate) array args: u32 [4 * (n_levels + N_LISTS + 1)],
            /// Wet quads, where their pairs start, where those of the nodes start.
            pub array words: u32 [2 * size.quads + n_nodes + 2],
            /// By wet quad: bits of the value, 4 node + lane.
            pub array quad_pairs: [u32; 4] [size.pairs],
            /// By node: bits of the value, padded index of the cell.
            pub array node_pairs: [u32; 4] [size.pairs],
            /// Partial sums of the wet quads, then of the nodes; `Real4`.
            pub real partials: (variant.real) [4 * (size.quads + n_nodes)],
            /// g_p of the wet quads while the V-cycle has another right-hand side.
            pub(crate) real kept: (variant.inner) [4 * size.quads],
            /// Right-hand side of the wet quads before anything flows through solids.
            pub(crate) real base: (variant.real) [4 * size.quads],
            /// Half step of the two-field operator and its difference to the velocities; forces and velocities of the Schur operator.
            pub(crate) real t: (variant.real) [4 * n_nodes],
            pub(crate) real difference: (variant.real) [4 * n_nodes],
            /// Sums that the host reads once per step: `fields::CouplingReport`.
            pub array report: u32 [REPORT_WORDS],
        }
        views {}
        parts {}
    }
}

impl CouplingBuffers {
    /// Allocates for the systems of a liquid and of solids. Nothing is coupled until [`CouplingBuffers::write`].
    pub fn new(
        gpu: &Gpu,
        liquid: &SolverBuffers,
        solids: &SolidSystemBuffers,
        size: CouplingSize,
    ) -> Result<CouplingBuffers, Error> {
        CouplingBuffers::allocate(
            gpu,
            size,
            solids.sizes.n_nodes as usize,
            solids.sizes.n_bodies as usize,
            liquid.plan.len(),
            liquid.variant,
            Written::default(),
        )
    }

    /// Whether there is room for J.
    pub fn fits(&self, pairs: &[Pair]) -> bool {
        let mut quads = pairs.chunk_by(|a, b| a.cell / 4 == b.cell / 4);
        pairs.len() <= self.size.pairs && quads.by_ref().count() <= self.size.quads
    }

    /// Slot of a list.
    pub(crate) fn slot(&self, list: usize) -> usize {
        self.n_levels + list
    }

    /// Replaces J. `pairs`: by cell, then by node; `mass`: rho dx^3 / dt, kg/s.
    ///
    /// # Errors
    /// [`Error::Limit`] when there is no room for as many.
    pub fn write(&mut self, gpu: &Gpu, pairs: &[Pair], mass: f64) -> Result<(), Error> {
        let (mut quads, mut starts) = (Vec::<u32>::new(), Vec::new());
        let words = |value: [f32; 3], last: u32| {
            let [x, y, z] = value.map(f32::to_bits);
            [x, y, z, last]
        };
        for (pair, number) in pairs.iter().zip(0..) {
            let quad = (pair.cell / 4) as u32;
            if quads.last() != Some(&quad) {
                quads.push(quad);
                starts.push(number);
            }
        }
        starts.push(pairs.len() as u32);
        for (what, needed, available) in [
            ("quads of cells with patches", quads.len(), self.size.quads),
            ("pairs of cells and nodes", pairs.len(), self.size.pairs),
        ] {
            if needed > available {
                return Err(Error::Limit {
                    what: "the surfaces of the solids".to_owned(),
                    needed: needed as u64,
                    available: available as u64,
                    unit: what,
                    cure: "use coarser meshes, or --backend cpu".to_owned(),
                });
            }
        }
        let by_quad = |pair: &Pair| words(pair.value, (4 * pair.node + pair.cell % 4) as u32);
        let by_quad: Vec<[u32; 4]> = pairs.par_iter().map(by_quad).collect();
        let (node_starts, order) = counting_sort(self.n_nodes, pairs.iter().map(|pair| pair.node));
        let by_node = |&at: &usize| words(pairs[at].value, pairs[at].cell as u32);
        let by_node: Vec<[u32; 4]> = order.par_iter().map(by_node).collect();
        let n_wet = quads.len() as u32;
        let coupling = Coupling {
            n_wet,
            n_nodes: self.n_nodes as u32,
            quad_starts: n_wet,
            node_starts: 2 * n_wet + 1,
            mass: mass as f32,
            share: SIGMA,
            pad_0: 0,
            pad_1: 0,
        };
        let mut all = quads;
        all.append(&mut starts);
        all.extend(node_starts.into_iter().map(|start| start as u32));
        let mut sizes = Vec::new();
        for (n, per_group) in [(self.n_nodes as u32, WG_SIZE), (self.n_bodies as u32, 1), (n_wet, WG_SIZE)] {
            sizes.extend(groups(n.div_ceil(per_group)));
            sizes.push(n);
        }
        sizes.extend([0; 4]);
        sizes.extend([0, 0, 0, FOLD_THREADS as u32]);
        self.written.sizes = coupling;
        self.written.pairs.clear();
        self.written.pairs.extend_from_slice(pairs);
        gpu.upload(&self.coupling, &[coupling]);
        gpu.upload(&self.words, &all);
        gpu.upload(&self.quad_pairs, &by_quad);
        gpu.upload(&self.node_pairs, &by_node);
        gpu.upload(&self.sizes, &sizes);
        Ok(())
    }
}
