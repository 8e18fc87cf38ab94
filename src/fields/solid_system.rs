//! Arrays of the system of the solids, and the layout of its rows.

use std::sync::{Arc, Mutex};

use crate::Error;
use crate::arrays;
use crate::elastic::{Incidence, Solids};
use crate::gpu::{Gpu, Readback, Real, Variant, WG_SIZE, groups};
use crate::scene::Solver;

use super::pressure_system::{FOLD_THREADS, check_precision, variant};

/// Rows in a slice; `common/rows.wgsl` has it too. As many as threads in a workgroup.
const SLICE: usize = WG_SIZE as usize;
/// Rows among which the longest come first: enough to make the slices' rows about equally long, few enough to stay near in memory.
const WINDOW: usize = 16 * SLICE;
/// Numbers up to this one are exact in f32, as which the blocks hold their columns.
const LARGEST_COLUMN: usize = 1 << 24;
/// Elements that four corners' worth of bits leave room for in a word.
const LARGEST_ELEMENT: usize = 1 << 28;
/// Lists whose dispatch sizes open while a round runs: nodes, solids.
pub(crate) const N_LISTS: usize = 2;
/// Slots of those lists.
pub(crate) const NODES: usize = 0;
pub(crate) const BODIES: usize = 1;

/// Sizes of the rows.
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
    /// Offsets of the joints of each entry, then the joints.
    joints: Vec<u32>,
    /// Offsets of the corners of each node, then the corners.
    incidence: Vec<u32>,
    /// Blocks without padding.
    n_blocks: usize,
    /// Nodes of the largest solid.
    largest_body: usize,
    /// Nodes of the elements, for residuals on the host.
    pub(crate) elements: Arc<Vec<[u32; 4]>>,
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
                    self.neighbours.push(incidence.neighbours(node as usize)[column]);
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
    pub(crate) fn long_sums(&self) -> bool {
        self.rows.n_nodes as usize > 4 * FOLD_THREADS
    }
}

arrays! {
    /// The system of the solids on the device. A node is a quad x, y, z, 0.
    pub struct SolidSystemBuffers in "solid_solver" {
        fields {
            /// Scalar types: `real` of outer loop and conjugate gradients, `inner` of the preconditioner.
            pub variant: Variant,
            pub(crate) sizes: Rows,
            /// Whether walls, obstacles and solids are rows of one problem on the host, and none holds nodes here.
            pub(crate) rows_on_host: bool,
            pub(crate) layout: SolidRows,
            /// The system on the host, where the device rounds the residual.
            pub(crate) to_host: Option<Mutex<SolidReadbacks>>,
        }
        arrays {
            /// The rows.
            pub uniform rows: Rows [sizes],
            /// Node in each slot of the rows, then where the slices and the solids start.
            pub array list: u32 [layout.list.len()],
            /// Dispatch size and number of nodes and of solids; after them the length of folded partials.
            pub(crate) array args: u32 [4 * (N_LISTS + 1)],
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
            pub(crate) real outer: (variant.real) [4 * layout.n_nodes()],
            /// Products of the elements with a velocity.
            pub(crate) real products: (variant.real) [12 * layout.rows.n_elements as usize],
            /// Residual of conjugate gradients.
            pub(crate) real r: (variant.real) [4 * layout.n_nodes()],
            /// Preconditioned residual; between solves the next velocity of the active-set search, m/s.
            pub real z: (variant.real) [4 * layout.n_nodes()],
            /// Search direction, then correction.
            pub(crate) real search: (variant.real) [8 * layout.n_nodes()],
            /// S s.
            pub(crate) real q: (variant.real) [4 * layout.n_nodes()],
            /// Two iterates of the polynomial, and the last increment.
            pub(crate) real pair: (variant.inner) [8 * layout.n_nodes()],
            pub(crate) real increment: (variant.inner) [4 * layout.n_nodes()],
            /// Best velocity of the active-set search, m/s.
            pub real best: (variant.real) [4 * layout.n_nodes()],
            pub(crate) real partials: (variant.real) [4 * layout.n_nodes().max(FOLD_THREADS)],
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
    pub fn new(gpu: &Gpu, layout: &SolidRows, solver: &Solver) -> Result<SolidSystemBuffers, Error> {
        check_precision(gpu, solver.precision)?;
        let variant = variant(gpu.has_f64(), solver.precision);
        let sizes = layout.rows;
        let to_host =
            (variant.real == Real::F32).then(|| SolidReadbacks::new(gpu, layout).map(Mutex::new)).transpose()?;
        let buffers = SolidSystemBuffers::allocate(gpu, variant, sizes, solver.solid_contact, layout.clone(), to_host)?;
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
}

/// Read-backs of the stored system, in f32, and its constant part.
#[derive(Debug)]
pub(crate) struct SolidReadbacks {
    pub(crate) elements: Arc<Vec<[u32; 4]>>,
    pub(crate) freedom: Readback<[f32; 4]>,
    pub(crate) rotated: Readback<u32>,
    pub(crate) masses: Readback<u32>,
    pub(crate) rhs: Readback<u32>,
    pub(crate) velocity: Readback<u32>,
    pub(crate) guess: Readback<u32>,
}

impl SolidReadbacks {
    pub(crate) fn new(gpu: &Gpu, rows: &SolidRows) -> Result<SolidReadbacks, Error> {
        let (n, m) = (rows.rows.n_nodes as usize, rows.rows.n_elements as usize);
        Ok(SolidReadbacks {
            elements: rows.elements.clone(),
            freedom: Readback::new(gpu, "solid.freedom", n)?,
            rotated: Readback::new(gpu, "solid.rotated", 12 * m)?,
            masses: Readback::new(gpu, "solid_solver.masses", 2 * n)?,
            rhs: Readback::new(gpu, "solid_solver.rhs", 4 * n)?,
            velocity: Readback::new(gpu, "solid.velocity", 4 * n)?,
            guess: Readback::new(gpu, "solid_solver.guess", 4 * n)?,
        })
    }
}
