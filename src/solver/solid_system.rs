//! The system of the solids on the device, S v = rhs with S = zeta_M M + zeta_K K: its rows, buffers, and the kernels that set it up.
//!
//! What is solved is made of the rotated elements (`solid.rotated`) and never assembled: residuals and the operator of conjugate gradients
//! sum the products of the elements. Only the preconditioner has a matrix, 3x3 blocks in rows that are sorted by length in windows
//! and cut into slices of 64 (SELL-C-sigma, Kreutzer et al. 2014), so that one thread per row streams.

use std::sync::{Arc, Mutex};

use crate::Error;
use crate::elastic::{Incidence, Solids};
use crate::fields::SolidBuffers;
use crate::gpu::{
    Binding, Bound, Buffer, Gpu, Kernel, Pass, Real, RealBuffer, Variant, WG_SIZE, groups,
};
use crate::scene::Solver;
use crate::step::Stage;

use super::pcg::{Labels, labels};
use super::solid_contacts::{ContactSearch, ObstacleField, SolidContacts};
use super::solid_host::SolidReadbacks;
use super::{FOLD_THREADS, Level, variant};

pub(super) const LABELS: Labels = labels!("solid_solver");

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

    /// Whether sums take two levels.
    pub(super) fn long_sums(&self) -> bool {
        self.rows.n_nodes as usize > 4 * FOLD_THREADS
    }
}

/// Scalar types of outer loop and rounds: conjugate gradients are as precise as the residual, and only their preconditioner is not.
pub(super) fn rounds(variant: Variant) -> Variant {
    variant.real.into()
}

/// What the solver reads of the solids, and their velocity, which it solves for. n nodes, m elements; `Real4` is four scalars
/// of the outer loop's type.
#[derive(Clone, Copy, Debug)]
pub struct SolidFields<'a> {
    /// Uniform `SolidStep`.
    pub step: Binding<'a>,
    /// Per node: position and lumped mass, kg.
    pub rest: &'a Buffer<[f32; 4]>,
    /// `Real4` per node: velocity, m/s.
    pub velocity: &'a RealBuffer,
    /// Per node: bits 0, 1, 2 for free components.
    pub flags: &'a Buffer<u32>,
    /// Per node: displacement from rest, m, larger parts, then smaller.
    pub displacement: &'a Buffer<[f32; 4]>,
    /// Distances from walls and obstacles: see `shaders/common/contact.wgsl`.
    pub gaps: &'a Buffer<[f32; 4]>,
    /// How nodes may move: see `shaders/common/freedom.wgsl`.
    pub freedom: &'a Buffer<[f32; 4]>,
    /// What the search for contacts answers, and is told: see `shaders/common/ask.wgsl`.
    pub answer: &'a Buffer<u32>,
    /// Nodes of the elements.
    pub elements: &'a Buffer<[u32; 4]>,
    /// `Real4`, three sections of m: rotated gradients, 1/m, with zeta_K V lambda, zeta_K V mu and det F.
    pub rotated: &'a RealBuffer,
    /// `Real4`, three sections of m: K x* - b at corners 1, 2, 3, N.
    pub element_forces: &'a RealBuffer,
    /// `Real4` per node: constant force, N, and tau_M, 1/s.
    pub load: &'a RealBuffer,
}

impl SolidBuffers {
    /// What the solver reads of them, and the velocity, which it solves for.
    pub fn fields(&self) -> SolidFields<'_> {
        SolidFields {
            step: (&self.step).into(),
            rest: &self.rest,
            velocity: &self.velocity,
            flags: &self.flags,
            displacement: &self.displacement,
            gaps: &self.gaps,
            freedom: &self.freedom,
            answer: &self.answer,
            elements: &self.elements,
            rotated: &self.rotated,
            element_forces: &self.element_forces,
            load: &self.load,
        }
    }
}

/// The solver's data on the device. A node is a quad x, y, z, 0.
#[derive(Debug)]
pub struct SolidSystemBuffers {
    /// Scalar types: `real` of outer loop and conjugate gradients, `inner` of the preconditioner.
    pub variant: Variant,
    /// The rows.
    pub rows: Buffer<Rows>,
    pub(super) sizes: Rows,
    /// What it was made for.
    pub(super) layout: SolidRows,
    pub(super) long_sums: bool,
    pub(super) largest_body: usize,
    /// Node in each slot of the rows, then where the slices and the solids start.
    pub list: Buffer<u32>,
    /// Dispatch size and number of nodes and of solids; after them the length of folded partials.
    pub(super) args: Buffer<u32>,
    /// Corners of the nodes: see `common/gather.wgsl`.
    pub incidence: Buffer<u32>,
    joints: Buffer<u32>,
    neighbours: Buffer<u32>,
    /// Blocks zeta_K K_ij off the diagonal, kg/s: see `common/rows.wgsl`.
    pub blocks: RealBuffer,
    /// Inverse blocks of the diagonal, s/kg: xx, yy, zz, zeta_M m of all nodes, then xy, xz, yz, 0, then unit vectors along which
    /// obstacles hold the nodes.
    pub inverse: RealBuffer,
    /// zeta_M m per node, then the mean of the diagonal of its block of S, kg/s.
    pub masses: RealBuffer,
    /// Right-hand side of the components that are not prescribed, N, and the squared norm of the terms that it sums.
    pub rhs: RealBuffer,
    pub(super) outer: RealBuffer,
    pub(super) products: RealBuffer,
    pub(super) r: RealBuffer,
    /// Preconditioned residual; between solves the next velocity in search of what is held, m/s.
    pub z: RealBuffer,
    pub(super) search: RealBuffer,
    pub(super) q: RealBuffer,
    pub(super) pair: RealBuffer,
    pub(super) increment: RealBuffer,
    /// The best velocity in search of what is held, m/s.
    pub best: RealBuffer,
    pub(super) partials: RealBuffer,
    /// Where the device rounds the residual.
    pub(super) to_host: Option<Mutex<SolidReadbacks>>,
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
        let (n, m) = (
            layout.rows.n_nodes as usize,
            layout.rows.n_elements as usize,
        );
        let partials = n.max(FOLD_THREADS);
        let n_neighbours = layout.neighbours.len();
        let real = |label: &str, len| RealBuffer::new(gpu, label, len, variant.real);
        let inner = |label: &str, len| RealBuffer::new(gpu, label, len, variant.inner);
        let sizes = layout.rows;
        let mut args = Vec::new();
        for n in [sizes.n_nodes.div_ceil(WG_SIZE), sizes.n_bodies] {
            args.extend(groups(n));
            args.push(n);
        }
        args[3] = sizes.n_nodes;
        args.extend([0, 0, 0, FOLD_THREADS as u32]);
        Ok(SolidSystemBuffers {
            variant,
            rows: gpu.uniform("solid_solver.rows", &sizes)?,
            sizes,
            layout: layout.clone(),
            long_sums: layout.long_sums(),
            largest_body: layout.largest_body,
            list: gpu.buffer_with("solid_solver.list", &layout.list)?,
            args: gpu.buffer_with("solid_solver.args", &args)?,
            incidence: gpu.buffer_with("solid_solver.incidence", &layout.incidence)?,
            joints: gpu.buffer_with("solid_solver.joints", &layout.joints)?,
            neighbours: gpu.buffer_with("solid_solver.neighbours", &layout.neighbours)?,
            blocks: inner("solid_solver.blocks", 12 * n_neighbours)?,
            inverse: inner("solid_solver.inverse", 12 * n)?,
            masses: real("solid_solver.masses", 2 * n)?,
            rhs: real("solid_solver.rhs", 4 * n)?,
            outer: real("solid_solver.outer", 4 * n)?,
            products: real("solid_solver.products", 12 * m)?,
            r: real("solid_solver.r", 4 * n)?,
            z: real("solid_solver.z", 4 * n)?,
            search: real("solid_solver.search", 8 * n)?,
            q: real("solid_solver.q", 4 * n)?,
            pair: inner("solid_solver.pair", 8 * n)?,
            increment: inner("solid_solver.increment", 4 * n)?,
            best: real("solid_solver.best", 4 * n)?,
            partials: real("solid_solver.partials", 4 * partials)?,
            to_host: (variant.real == Real::F32)
                .then(|| SolidReadbacks::new(gpu, layout).map(Mutex::new))
                .transpose()?,
        })
    }

    /// Binds the products of the elements with a velocity.
    pub(super) fn bind_products(
        &self,
        gpu: &Gpu,
        fields: SolidFields,
        x: &RealBuffer,
    ) -> Result<Bound, Error> {
        Kernel::new(gpu, &crate::wgsl!("solid_products"), self.variant)?.bind(
            gpu,
            &[
                ("rows", (&self.rows).into()),
                ("elements", fields.elements.into()),
                ("rotated", fields.rotated.into()),
                ("x", x.into()),
                ("products", (&self.products).into()),
            ],
        )
    }

    /// Binds P (rhs - S v), given the products with v.
    pub(super) fn bind_residual(&self, gpu: &Gpu, fields: SolidFields) -> Result<Bound, Error> {
        Kernel::new(gpu, &crate::wgsl!("solid_residual"), self.variant)?.bind(
            gpu,
            &[
                ("rows", (&self.rows).into()),
                ("freedom", fields.freedom.into()),
                ("incidence", (&self.incidence).into()),
                ("products", (&self.products).into()),
                ("masses", (&self.masses).into()),
                ("x", fields.velocity.into()),
                ("rhs", (&self.rhs).into()),
                ("outer", (&self.outer).into()),
                ("partials", (&self.partials).into()),
            ],
        )
    }

    /// Binds the start of the unknowns, with what is free of v* as a correction on trial.
    pub(super) fn bind_guess(&self, gpu: &Gpu, fields: SolidFields) -> Result<Bound, Error> {
        Kernel::new(gpu, &crate::wgsl!("solid_guess"), self.variant)?.bind(
            gpu,
            &[
                ("rows", (&self.rows).into()),
                ("freedom", fields.freedom.into()),
                ("velocity", fields.velocity.into()),
                ("search", (&self.search).into()),
            ],
        )
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
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind`].
    pub fn new(
        gpu: &Gpu,
        buffers: &SolidSystemBuffers,
        fields: SolidFields,
        obstacles: Option<ObstacleField>,
    ) -> Result<SolidSystem, Error> {
        let at_right_hand_side = &gpu.at(Stage::RightHandSide.name());
        let kernel = |source| Kernel::new(at_right_hand_side, source, buffers.variant);
        let at_matrices = gpu.at(Stage::SolidMatrices.name());
        let blocks = Kernel::new(&at_matrices, &crate::wgsl!("solid_blocks"), buffers.variant)?;
        let rows = ("rows", (&buffers.rows).into());
        let step = ("step", fields.step);
        let flags = ("flags", fields.flags.into());
        let rest = ("rest", fields.rest.into());
        let load = ("load", fields.load.into());
        let rotated = ("rotated", fields.rotated.into());
        let incidence = ("incidence", (&buffers.incidence).into());
        Ok(SolidSystem {
            blocks: blocks.bind(
                gpu,
                &[
                    rows,
                    rotated,
                    ("joints", (&buffers.joints).into()),
                    ("neighbours", (&buffers.neighbours).into()),
                    ("blocks", (&buffers.blocks).into()),
                ],
            )?,
            diagonals: kernel(&crate::wgsl!("solid_diagonals"))?.bind(
                gpu,
                &[
                    step,
                    rows,
                    ("freedom", fields.freedom.into()),
                    rest,
                    load,
                    rotated,
                    incidence,
                    ("masses", (&buffers.masses).into()),
                    ("inverse", (&buffers.inverse).into()),
                ],
            )?,
            right_hand_side: kernel(&crate::wgsl!("solid_right_hand_side"))?.bind(
                gpu,
                &[
                    step,
                    rows,
                    flags,
                    rest,
                    ("velocity", fields.velocity.into()),
                    load,
                    incidence,
                    ("products", fields.element_forces.into()),
                    ("rhs", (&buffers.rhs).into()),
                ],
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
