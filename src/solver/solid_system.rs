//! The system of the solids on the device, S v = rhs with S = zeta_M M + zeta_K K: its rows, buffers, and the kernels that set it up.
//!
//! What is solved is made of the rotated elements (`solid.rotated`) and never assembled: residuals and the operator of conjugate gradients
//! sum the products of the elements. Only the preconditioner has a matrix, 3x3 blocks in rows that are sorted by length in windows
//! and cut into slices of 64 (SELL-C-sigma, Kreutzer et al. 2014), so that one thread per row streams.

use std::sync::{Arc, Mutex};

use crate::Error;
use crate::elastic::{Incidence, Solids};
use crate::fields::SolidBuffers;
use crate::gpu::{Arrays, Bound, Gpu, Pass, Real, RealBuffer, Variant, WG_SIZE, groups};
use crate::scene::Solver;
use crate::step::Stage;
use crate::{arrays, wgsl};

use super::pcg::Block;
use super::solid_contacts::{ContactSearch, ObstacleField, SolidContacts};
use super::solid_host::SolidReadbacks;
use super::{FOLD_THREADS, Level, bind, variant};

/// Rows in a slice; `common/rows.wgsl` has it too. As many as threads in a workgroup.
const SLICE: usize = WG_SIZE as usize;
/// Rows among which the longest come first: enough to make the slices' rows about equally long, few enough to stay near in memory.
const WINDOW: usize = 16 * SLICE;
/// Numbers up to this one are exact in f32, as which the blocks hold their columns.
const LARGEST_COLUMN: usize = 1 << 24;
/// Elements that four corners' worth of bits leave room for in a word.
const LARGEST_ELEMENT: usize = 1 << 28;
/// Lists whose dispatch sizes open while a round runs: nodes, solids.
pub(super) const N_LISTS: usize = 2;
/// Slots of those lists.
pub(super) const NODES: usize = 0;
pub(super) const BODIES: usize = 1;

/// The doppelganger of `Rows` in `shaders/common/rows.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Rows {
    /// Nodes.
    pub n_nodes: u32,
    /// Elements.
    pub n_elements: u32,
    /// Blocks off the diagonal, padding counted.
    pub n_entries: u32,
    /// First word in the list of where the slices start.
    pub slices: u32,
    /// First word in the list of where the bodies start.
    pub bodies: u32,
    /// Solids.
    pub n_bodies: u32,
    /// Nothing.
    pub pad_0: u32,
    /// Nothing.
    pub pad_1: u32,
}

/// The rows of the solids as the device holds them: topology, which never changes.
#[derive(Clone, Debug)]
pub struct SolidRows {
    /// Sizes.
    pub rows: Rows,
    /// Node in each slot, then where the slices and the bodies start.
    list: Vec<u32>,
    /// Column of each entry.
    neighbours: Vec<u32>,
    /// Where the joints of each entry start, then the joints.
    joints: Vec<u32>,
    /// Where the corners of each node start, then the corners.
    incidence: Vec<u32>,
    /// Blocks without padding.
    n_blocks: usize,
    /// Nodes of the largest solid.
    largest_body: usize,
    /// What the host needs for a residual of its own.
    pub(super) elements: Arc<Vec<[u32; 4]>>,
}

impl SolidRows {
    /// Lays the rows out.
    ///
    /// # Errors
    /// [`Error::Limit`] for more nodes or elements than the device's words can count.
    pub fn new(solids: &Solids) -> Result<SolidRows, Error> {
        let (n, m) = (solids.rest.len(), solids.elements.len());
        for (what, needed, available, unit) in [
            ("the rows of the solids", n, LARGEST_COLUMN, "nodes"),
            ("the elements of the solids", m, LARGEST_ELEMENT, "elements"),
        ] {
            if needed > available {
                return Err(Error::Limit {
                    what: what.to_owned(),
                    needed: needed as u64,
                    available: available as u64,
                    unit,
                    cure: "use coarser meshes, or --backend cpu".to_owned(),
                });
            }
        }
        let incidence = Incidence::new(n, &solids.elements);
        let mut order: Vec<u32> = (0..n as u32).collect();
        for body in &solids.bodies {
            for window in order[body.nodes.clone()].chunks_mut(WINDOW) {
                // Stable: equally long rows stay in order.
                let length = |node: &u32| incidence.neighbours(*node as usize).len();
                window.sort_by_key(|node| std::cmp::Reverse(length(node)));
            }
        }
        let mut rows = SolidRows {
            rows: Rows {
                n_nodes: n as u32,
                n_elements: m as u32,
                n_bodies: solids.bodies.len() as u32,
                ..Rows::default()
            },
            list: Vec::new(),
            neighbours: Vec::new(),
            joints: Vec::new(),
            incidence: Vec::new(),
            n_blocks: incidence.n_blocks(),
            largest_body: 0,
            elements: Arc::new(solids.elements.clone()),
        };
        rows.set_slices(&incidence, &order);
        let bodies = solids.bodies.iter().map(|body| &body.nodes);
        rows.rows.bodies = rows.list.len() as u32;
        rows.list.push(0);
        for nodes in bodies {
            rows.list.push(nodes.end as u32);
            rows.largest_body = rows.largest_body.max(nodes.len());
        }
        rows.incidence.push(0);
        for node in 0..n {
            let end = rows.incidence[node] + incidence.corners(node).len() as u32;
            rows.incidence.push(end);
        }
        for start in &mut rows.incidence {
            *start += n as u32 + 1;
        }
        for node in 0..n {
            let corners = incidence.corners(node).iter();
            let words = corners.map(|corner| 4 * corner.element + u32::from(corner.corner));
            rows.incidence.extend(words);
        }
        Ok(rows)
    }

    fn set_slices(&mut self, incidence: &Incidence, order: &[u32]) {
        let mut starts = vec![0];
        let mut joints = Vec::with_capacity(incidence.n_joints());
        let mut joint_starts = Vec::new();
        for slice in order.chunks(SLICE) {
            let lengths = slice.iter().map(|&node| incidence.blocks(node as usize));
            let longest = lengths.map(|blocks| blocks.len()).max().unwrap_or(0);
            for column in 0..longest {
                for lane in 0..SLICE {
                    joint_starts.push(joints.len() as u32);
                    let node = slice.get(lane).copied();
                    let block = node.and_then(|node| incidence.blocks(node as usize).nth(column));
                    let Some((node, block)) = node.zip(block) else {
                        self.neighbours.push(node.unwrap_or(0));
                        continue;
                    };
                    self.neighbours
                        .push(incidence.neighbours(node as usize)[column]);
                    joints.extend(incidence.joints(block).iter().map(|joint| {
                        let [row, column] = joint.corners.map(u32::from);
                        16 * joint.element + 4 * row + column
                    }));
                }
            }
            starts.push(starts[starts.len() - 1] + longest as u32);
        }
        let n_entries = self.neighbours.len();
        self.joints = joint_starts;
        self.joints.push(joints.len() as u32);
        for start in &mut self.joints {
            *start += n_entries as u32 + 1;
        }
        self.joints.append(&mut joints);
        self.list = order.to_vec();
        self.rows.slices = self.list.len() as u32;
        self.rows.n_entries = n_entries as u32;
        self.list.append(&mut starts);
    }

    /// Blocks stored over blocks needed.
    pub fn padding(&self) -> f64 {
        self.neighbours.len() as f64 / self.n_blocks.max(1) as f64
    }

    /// Blocks off the diagonal, padding not counted.
    pub fn n_blocks(&self) -> usize {
        self.n_blocks
    }

    /// Nodes of the largest solid.
    pub fn largest_body(&self) -> usize {
        self.largest_body
    }

    /// Nodes of all solids.
    fn n_nodes(&self) -> usize {
        self.rows.n_nodes as usize
    }

    /// Whether sums take two levels.
    pub(super) fn long_sums(&self) -> bool {
        self.rows.n_nodes as usize > 4 * FOLD_THREADS
    }
}

/// Scalar types of outer loop and corrections: conjugate gradients are as precise as the residual, and only their preconditioner is not.
pub(super) fn corrections(variant: Variant) -> Variant {
    variant.real.into()
}

arrays! {
    /// The system of the solids on the device. A node is a quad x, y, z, 0.
    pub struct SolidSystemBuffers in "solid_solver" {
        fields {
            /// Scalar types: `real` of outer loop and conjugate gradients, `inner` of the preconditioner.
            pub variant: Variant,
            pub(super) sizes: Rows,
            pub(super) layout: SolidRows,
            /// The system on the host, where the device rounds the residual.
            pub(super) to_host: Option<Mutex<SolidReadbacks>>,
        }
        arrays {
            /// The rows.
            pub uniform rows: Rows [sizes],
            /// Node in each slot of the rows, then where the slices and the solids start.
            pub array list: u32 [layout.list.len()],
            /// Dispatch size and number of nodes and of solids; after them the length of folded partials.
            pub(super) array args: u32 [4 * (N_LISTS + 1)],
            /// Corners of the nodes: see `common/gather.wgsl`.
            pub array incidence: u32 [layout.incidence.len()],
            array joints: u32 [layout.joints.len()],
            array neighbours: u32 [layout.neighbours.len()],
            /// Blocks zeta_K K_ij off the diagonal, kg/s: see `common/rows.wgsl`.
            pub real blocks: (variant.inner) [12 * layout.neighbours.len()],
            /// Inverse blocks of the diagonal, s/kg: xx, yy, zz, zeta_M m of all nodes, then xy, xz, yz, 0, then unit vectors along
            /// which obstacles constrain the nodes.
            pub real inverse: (variant.inner) [12 * layout.n_nodes()],
            /// zeta_M m per node, then the mean of the diagonal of its block of S, kg/s.
            pub real masses: (variant.real) [2 * layout.n_nodes()],
            /// Right-hand side of the components that are not prescribed, N, and the squared norm of the terms that it sums.
            pub real rhs: (variant.real) [4 * layout.n_nodes()],
            /// True residual.
            pub(super) real outer: (variant.real) [4 * layout.n_nodes()],
            /// Products of the elements with a velocity.
            pub(super) real products: (variant.real) [12 * layout.rows.n_elements as usize],
            /// Residual of conjugate gradients.
            pub(super) real r: (variant.real) [4 * layout.n_nodes()],
            /// Preconditioned residual; between solves the next velocity of the active-set search, m/s.
            pub real z: (variant.real) [4 * layout.n_nodes()],
            /// Search direction, then correction.
            pub(super) real search: (variant.real) [8 * layout.n_nodes()],
            /// S s.
            pub(super) real q: (variant.real) [4 * layout.n_nodes()],
            /// Two iterates of the polynomial, and the last increment.
            pub(super) real pair: (variant.inner) [8 * layout.n_nodes()],
            pub(super) real increment: (variant.inner) [4 * layout.n_nodes()],
            /// Best velocity of the active-set search, m/s.
            pub real best: (variant.real) [4 * layout.n_nodes()],
            pub(super) real partials: (variant.real) [4 * layout.n_nodes().max(FOLD_THREADS)],
        }
        views { q_in = q, q_out = q }
        parts {}
    }
}

impl SolidSystemBuffers {
    /// Allocates for these rows and writes what never changes.
    ///
    /// # Errors
    /// [`Error::Limit`] where the adapter is too small, or has no f64 and the precision needs it.
    pub fn new(
        gpu: &Gpu,
        layout: &SolidRows,
        solver: &Solver,
    ) -> Result<SolidSystemBuffers, Error> {
        super::system::check_precision(gpu, solver.precision)?;
        let variant = variant(gpu.has_f64(), solver.precision);
        let sizes = layout.rows;
        let to_host = (variant.real == Real::F32)
            .then(|| SolidReadbacks::new(gpu, layout).map(Mutex::new))
            .transpose()?;
        let buffers = SolidSystemBuffers::allocate(gpu, variant, sizes, layout.clone(), to_host)?;
        let mut args = Vec::new();
        for n in [sizes.n_nodes.div_ceil(WG_SIZE), sizes.n_bodies] {
            args.extend(groups(n));
            args.push(n);
        }
        args[3] = sizes.n_nodes;
        args.extend([0, 0, 0, FOLD_THREADS as u32]);
        for (array, words) in [
            (&buffers.list, &layout.list),
            (&buffers.args, &args),
            (&buffers.incidence, &layout.incidence),
            (&buffers.joints, &layout.joints),
            (&buffers.neighbours, &layout.neighbours),
        ] {
            gpu.upload(array, words);
        }
        Ok(buffers)
    }

    /// Binds the products of the elements with a velocity.
    pub(super) fn bind_products(
        &self,
        gpu: &Gpu,
        fields: &SolidBuffers,
        x: &RealBuffer,
    ) -> Result<Bound, Error> {
        let x = [("x", x.into())];
        bind(
            gpu,
            &wgsl!("solid_products"),
            self.variant,
            x,
            &[self, fields],
        )
    }

    /// Binds P (rhs - S v), given the products with v.
    pub(super) fn bind_residual(&self, gpu: &Gpu, fields: &SolidBuffers) -> Result<Bound, Error> {
        let x = [("x", (&fields.velocity).into())];
        bind(
            gpu,
            &wgsl!("solid_residual"),
            self.variant,
            x,
            &[self, fields],
        )
    }

    /// Binds the start of the unknowns, with what is free of v* as a correction on trial.
    pub(super) fn bind_guess(&self, gpu: &Gpu, fields: &SolidBuffers) -> Result<Bound, Error> {
        bind(
            gpu,
            &wgsl!("solid_guess"),
            self.variant,
            [],
            &[self, fields],
        )
    }

    /// Velocities as a block of unknowns.
    pub(super) fn block<'a>(&'a self, fields: &'a SolidBuffers) -> Block<'a> {
        Block {
            level: self.level(),
            variant: corrections(self.variant),
            flags: &fields.flags,
            list: &self.list,
            args: &self.args,
            x: &fields.velocity,
            outer: &self.outer,
            search: &self.search,
        }
    }

    /// The uniform of the quads.
    pub(super) fn level(&self) -> Level {
        let n = self.sizes.n_nodes;
        Level {
            shape: crate::grid::Layout {
                quads: n,
                total: n,
                ..bytemuck::Zeroable::zeroed()
            },
            coefficient: 1.0,
            args: 4 * NODES as u32,
            pad_0: 0,
            pad_1: 0,
        }
    }
}

/// The kernels that set the system up, every step: the part of `solid_matrices` that follows the rotations of the elements, and
/// `right_hand_side` for solids, which ends with what walls and obstacles hold and, since that decides on them, the blocks on the diagonal.
#[derive(Debug)]
pub struct SolidSystem {
    blocks: Bound,
    diagonals: Bound,
    right_hand_side: Bound,
    contacts: SolidContacts,
    n_entries: usize,
    n_nodes: usize,
}

impl SolidSystem {
    /// Compiles and binds; `obstacles` where there are any.
    pub fn new(
        gpu: &Gpu,
        buffers: &SolidSystemBuffers,
        fields: &SolidBuffers,
        obstacles: Option<ObstacleField>,
    ) -> Result<SolidSystem, Error> {
        let at_matrices = gpu.at(Stage::SolidMatrices.name());
        let at_right_hand_side = &gpu.at(Stage::RightHandSide.name());
        let variant = buffers.variant;
        let tables: [&dyn Arrays; 2] = [buffers, fields];
        let forces = [("products", (&fields.element_forces).into())];
        let right_hand_side = wgsl!("solid_right_hand_side");
        Ok(SolidSystem {
            blocks: bind(&at_matrices, &wgsl!("solid_blocks"), variant, [], &tables)?,
            diagonals: bind(
                at_right_hand_side,
                &wgsl!("solid_diagonals"),
                variant,
                [],
                &tables,
            )?,
            right_hand_side: bind(
                at_right_hand_side,
                &right_hand_side,
                variant,
                forces,
                &tables,
            )?,
            contacts: SolidContacts::new(gpu, buffers, fields, obstacles)?,
            n_entries: buffers.sizes.n_entries as usize,
            n_nodes: buffers.sizes.n_nodes as usize,
        })
    }

    /// Records the blocks off the diagonal, from the rotated elements.
    pub fn record_matrices(&self, pass: &mut Pass) {
        pass.dispatch(&self.blocks, self.n_entries);
    }

    /// Records the right-hand side, from v* and the forces of the elements.
    pub fn record_right_hand_side(&self, pass: &mut Pass) {
        pass.dispatch(&self.right_hand_side, self.n_nodes);
    }

    /// Records what is held from the start, by the right-hand side.
    pub fn record_contacts(&self, pass: &mut Pass) {
        self.contacts.record_touch(pass);
        self.record_hold(pass);
    }

    /// Records the velocities of what is held, and the blocks on the diagonal: before every solve.
    pub fn record_hold(&self, pass: &mut Pass) {
        self.contacts.record_hold(pass);
        pass.dispatch(&self.diagonals, self.n_nodes);
    }

    /// The search for what walls and obstacles hold.
    pub fn search(&self) -> &ContactSearch {
        &self.contacts.search
    }
}
