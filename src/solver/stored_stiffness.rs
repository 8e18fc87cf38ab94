//! The stored S of the solids on the host: assembled, factorised, and inverted on the wet nodes.
//!
//! Constraints of walls, obstacles and pins are applied as on the device: P S P + mu (I - P), with the projector P of each node and the mean mu
//! of its diagonal. This matrix is regular, and its inverse in the free directions is that of the free part.

use std::sync::{Arc, Mutex, OnceLock};

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::Error;
use crate::elastic::{Incidence, stiffness_block};
use crate::fields::{SolidBuffers, SolidSystemBuffers};
use crate::gpu::{Gpu, Readback, Recorder, lock};
use crate::linalg::{Cholesky, Csr, SymbolicCholesky};

use super::solid_host::Free;

/// Columns of an inverse that one task solves for: their order, and with it every bit, does not depend on the threads.
const COLUMNS: usize = 48;

/// Topology, symbolic factor, and the arrays on their way to the host.
#[derive(Debug)]
pub(super) struct StoredStiffness {
    elements: Arc<Vec<[u32; 4]>>,
    incidence: Incidence,
    symbolic: OnceLock<SymbolicCholesky>,
    pub(super) readbacks: Mutex<StoredReadbacks>,
}

/// Transfers of [`Stored`].
#[derive(Debug)]
pub(super) struct StoredReadbacks {
    freedom: Readback<[f32; 4]>,
    rotated: Readback<u32>,
    masses: Readback<u32>,
}

impl StoredReadbacks {
    fn new(gpu: &Gpu, solids: &SolidSystemBuffers, fields: &SolidBuffers) -> Result<StoredReadbacks, Error> {
        let n = solids.sizes.n_nodes as usize;
        let words = solids.variant.real.bytes() / 4;
        Ok(StoredReadbacks {
            freedom: Readback::new(gpu, "stored_stiffness.freedom", n)?,
            rotated: Readback::new(gpu, "stored_stiffness.rotated", fields.rotated.words.len())?,
            masses: Readback::new(gpu, "stored_stiffness.masses", words * n)?,
        })
    }

    pub(super) fn record(&mut self, to: &mut Recorder, solids: &SolidSystemBuffers, fields: &SolidBuffers) {
        to.read(&fields.freedom, &mut self.freedom);
        to.read(&fields.rotated.words, &mut self.rotated);
        to.read_part(&solids.masses.words, 0, &mut self.masses);
    }

    pub(super) fn wait(
        &mut self,
        gpu: &Gpu,
        solids: &SolidSystemBuffers,
        fields: &SolidBuffers,
    ) -> Result<Stored, Error> {
        Ok(Stored {
            freedom: self.freedom.wait(gpu)?,
            rotated: fields.rotated.widen(&self.rotated.wait(gpu)?),
            masses: solids.masses.widen(&self.masses.wait(gpu)?),
        })
    }
}

/// Arrays of a sub-step, read back; n nodes, m elements.
#[derive(Debug)]
pub(super) struct Stored {
    /// Four numbers per node: direction that an obstacle holds, and flags of free components.
    pub(super) freedom: Vec<[f32; 4]>,
    /// Four numbers per element, three sections: rotated gradients with zeta_K V lambda, zeta_K V mu, det F.
    pub(super) rotated: Vec<f64>,
    /// zeta_M m of the nodes, kg/s.
    pub(super) masses: Vec<f64>,
}

impl StoredStiffness {
    pub(super) fn new(gpu: &Gpu, solids: &SolidSystemBuffers, fields: &SolidBuffers) -> Result<StoredStiffness, Error> {
        let elements = &solids.layout.elements;
        Ok(StoredStiffness {
            incidence: Incidence::new(solids.sizes.n_nodes as usize, elements),
            elements: elements.clone(),
            symbolic: OnceLock::new(),
            readbacks: Mutex::new(StoredReadbacks::new(gpu, solids, fields)?),
        })
    }

    /// Reads the arrays and factorises.
    ///
    /// # Errors
    /// When the factor does not fit into memory, or the device is lost.
    pub(super) fn read_and_factorise(
        &self,
        gpu: &Gpu,
        solids: &SolidSystemBuffers,
        fields: &SolidBuffers,
    ) -> Result<Option<Factor<'_>>, Error> {
        let mut readbacks = lock(&self.readbacks);
        let mut recorder = Recorder::new(gpu);
        readbacks.record(&mut recorder, solids, fields);
        recorder.submit();
        self.factorise(&readbacks.wait(gpu, solids, fields)?)
    }

    /// Assembles and factorises; `None` where the matrix is not positive definite in f64.
    ///
    /// # Errors
    /// When the factor does not fit into memory.
    pub(super) fn factorise(&self, stored: &Stored) -> Result<Option<Factor<'_>>, Error> {
        let nodes = stored.freedom.iter();
        let projectors: Vec<DMat3> = nodes.map(|node| Free::new(node).projector()).collect();
        let matrix = self.assemble(stored, &projectors);
        let symbolic = match self.symbolic.get() {
            Some(symbolic) => symbolic,
            None => {
                let made = SymbolicCholesky::new(&matrix)?;
                self.symbolic.get_or_init(|| made)
            }
        };
        let factor = symbolic.factorise(&matrix).ok();
        Ok(factor.map(|cholesky| Factor { cholesky, projectors }))
    }

    fn block(&self, stored: &Stored, element: usize, a: usize, b: usize) -> DMat3 {
        let m = self.elements.len();
        let part = |section: usize, part: usize| stored.rotated[4 * (section * m + element) + part];
        let at = |section| DVec3::new(part(section, 0), part(section, 1), part(section, 2));
        let gradient = |corner: usize| match corner {
            0 => -(at(0) + at(1) + at(2)),
            corner => at(corner - 1),
        };
        stiffness_block(gradient(a), gradient(b), part(0, 3), part(1, 3))
    }

    fn assemble(&self, stored: &Stored, projectors: &[DMat3]) -> Csr {
        let n = projectors.len();
        // Rows of 3x3 blocks: the diagonal, then the neighbours.
        let rows: Vec<(DMat3, Vec<DMat3>)> = (0..n)
            .into_par_iter()
            .map(|node| {
                let corners = self.incidence.corners(node).iter();
                let mut diagonal = DMat3::from_diagonal(DVec3::splat(stored.masses[node]));
                for corner in corners {
                    let at = corner.corner as usize;
                    diagonal += self.block(stored, corner.element as usize, at, at);
                }
                let mean = (diagonal.x_axis.x + diagonal.y_axis.y + diagonal.z_axis.z) / 3.0;
                let free = projectors[node];
                let kept = free * diagonal * free + mean * (DMat3::IDENTITY - free);
                let others = self.incidence.blocks(node).zip(self.incidence.neighbours(node));
                let others = others.map(|(block, &other)| {
                    let joints = self.incidence.joints(block).iter();
                    let sum = joints.fold(DMat3::ZERO, |sum, joint| {
                        let [row, column] = joint.corners.map(usize::from);
                        sum + self.block(stored, joint.element as usize, row, column)
                    });
                    free * sum * projectors[other as usize]
                });
                (kept, others.collect())
            })
            .collect();
        Csr::from_rows(3 * n, 3 * n, |row, entries| {
            let (node, axis) = (row / 3, row % 3);
            let (diagonal, others) = &rows[node];
            let neighbours = self.incidence.neighbours(node);
            let before = neighbours.partition_point(|&other| (other as usize) < node);
            let blocks = neighbours.iter().map(|&other| other as usize).zip(others);
            let all = blocks.clone().take(before).chain([(node, diagonal)]);
            for (other, block) in all.chain(blocks.skip(before)) {
                let values = block.row(axis).to_array().into_iter().enumerate();
                entries.extend(values.map(|(b, value)| (3 * other + b, value)));
            }
        })
    }
}

/// A factor of it.
#[derive(Debug)]
pub(super) struct Factor<'a> {
    cholesky: Cholesky<'a>,
    pub(super) projectors: Vec<DMat3>,
}

impl Factor<'_> {
    /// The free part of S^-1 y, four numbers per node in and out.
    pub(super) fn solve(&self, y: &[f64]) -> Vec<f64> {
        let nodes = self.projectors.iter().zip(y.chunks_exact(4));
        let mut x: Vec<f64> = nodes.flat_map(|(free, y)| (*free * DVec3::from_slice(y)).to_array()).collect();
        self.cholesky.solve(&mut x);
        let nodes = self.projectors.iter().zip(x.as_chunks::<3>().0);
        nodes.flat_map(|(free, x)| (*free * DVec3::from(*x)).extend(0.0).to_array()).collect()
    }

    /// The part of it among the components of some nodes, times a factor, three columns per node.
    pub(super) fn inverse_among(&self, nodes: &[u32], factor: f64) -> Vec<f32> {
        let n = 3 * self.projectors.len();
        let columns: Vec<usize> = (0..3 * nodes.len()).collect();
        let parts: Vec<Vec<f32>> = columns
            .par_chunks(COLUMNS)
            .map(|columns| {
                let mut x = vec![0.0; n * columns.len()];
                for (&column, x) in columns.iter().zip(x.chunks_exact_mut(n)) {
                    let node = nodes[column / 3] as usize;
                    let unit = self.projectors[node].col(column % 3);
                    x[3 * node..3 * node + 3].copy_from_slice(&unit.to_array());
                }
                self.cholesky.solve_columns(&mut x, columns.len());
                let of_nodes = x.chunks_exact(n).flat_map(|x| {
                    nodes.iter().flat_map(|&node| {
                        let at = node as usize;
                        let free = self.projectors[at] * DVec3::from_slice(&x[3 * at..]);
                        (factor * free).as_vec3().to_array()
                    })
                });
                of_nodes.collect()
            })
            .collect();
        parts.concat()
    }
}
