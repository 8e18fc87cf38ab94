//! `solid_matrices`: deformations, forces and the stiffness of all elements, and the assembled stiffness matrix.

use std::sync::Arc;

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::elastic::{Deformation, Solids, forces, stiffness_block};
use crate::linalg::Csr;

/// Block sparsity pattern of the stiffness matrix, by rows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BlockPattern {
    /// Index of the first block of each node, and the total.
    start: Vec<usize>,
    /// Columns (nodes), ascending in each row, including the diagonal.
    columns: Vec<u32>,
}

impl BlockPattern {
    /// The pattern of all solids.
    pub fn new(solids: &Solids) -> BlockPattern {
        let pairs = |corners: &[u32; 4]| {
            let corners = *corners;
            corners.into_iter().flat_map(move |row| corners.map(|column| (row, column)))
        };
        let mut places: Vec<(u32, u32)> = solids.elements.iter().flat_map(pairs).collect();
        places.par_sort_unstable();
        places.dedup();
        let mut start = vec![0; solids.rest.len() + 1];
        for &(row, _) in &places {
            start[row as usize + 1] += 1;
        }
        for row in 0..solids.rest.len() {
            start[row + 1] += start[row];
        }
        BlockPattern { start, columns: places.into_iter().map(|(_, column)| column).collect() }
    }

    /// Index of the block of two nodes of an element.
    fn place(&self, row: u32, column: u32) -> usize {
        let range = self.start[row as usize]..self.start[row as usize + 1];
        let found = self.columns[range.clone()].binary_search(&column);
        range.start + found.expect("nodes of one element share a block")
    }
}

/// A symmetric matrix of 3x3 blocks, K in N/m.
#[derive(Clone, Debug)]
pub struct BlockMatrix {
    pattern: Arc<BlockPattern>,
    blocks: Vec<DMat3>,
}

impl BlockMatrix {
    /// Sums the blocks of elements and pairs of corners, elements in ascending order.
    pub fn assemble(
        solids: &Solids,
        pattern: &Arc<BlockPattern>,
        block: impl Fn(usize, usize, usize) -> DMat3,
    ) -> BlockMatrix {
        let mut blocks = vec![DMat3::ZERO; pattern.columns.len()];
        for (element, corners) in solids.elements.iter().enumerate() {
            for (a, &row) in corners.iter().enumerate() {
                for (b, &column) in corners.iter().enumerate() {
                    blocks[pattern.place(row, column)] += block(element, a, b);
                }
            }
        }
        BlockMatrix { pattern: Arc::clone(pattern), blocks }
    }

    /// Number of nodes.
    pub fn n_nodes(&self) -> usize {
        self.pattern.start.len() - 1
    }

    /// Nodes and blocks of a node's row, ascending.
    pub fn row(&self, node: usize) -> impl Iterator<Item = (usize, DMat3)> + '_ {
        let range = self.pattern.start[node]..self.pattern.start[node + 1];
        let columns = self.pattern.columns[range.clone()].iter();
        columns.map(|&column| column as usize).zip(self.blocks[range].iter().copied())
    }

    /// The diagonal block.
    pub fn diagonal(&self, node: usize) -> DMat3 {
        self.blocks[self.pattern.place(node as u32, node as u32)]
    }

    /// K x at a node, from differences: a translation yields exactly 0. `x`: three numbers per node.
    pub fn product(&self, node: usize, x: &[f64]) -> DVec3 {
        let at = |node: usize| DVec3::from_slice(&x[3 * node..]);
        let here = at(node);
        self.row(node).map(|(column, block)| block * (at(column) - here)).sum()
    }

    /// The matrix by scalars: x, y, z of node 0, then of node 1 and so on.
    pub fn to_csr(&self) -> Csr {
        let n = 3 * self.n_nodes();
        Csr::from_rows(n, n, |row, entries| {
            for (column, block) in self.row(row / 3) {
                let numbers = block.row(row % 3).to_array();
                entries.extend((3 * column..).zip(numbers));
            }
        })
    }
}

/// Element matrices of a displacement.
#[derive(Clone, Debug)]
pub struct SolidMatrices {
    /// Deformation of each element.
    pub deformations: Vec<Deformation>,
    /// (K x* - b) at the corners of each element, N.
    pub element_forces: Vec<[DVec3; 4]>,
    /// K, N/m.
    pub stiffness: BlockMatrix,
}

/// Deformations, forces and stiffness for displacements of all nodes (m). Elements are added in ascending order.
pub fn solid_matrices(solids: &Solids, pattern: &Arc<BlockPattern>, displacement: &[[f64; 3]]) -> SolidMatrices {
    let n_elements = solids.elements.len();
    let deformations = solids.deformations(displacement);
    let element_forces = (0..n_elements)
        .into_par_iter()
        .map(|element| {
            let body = solids.body_of_element(element);
            let (gradients, volume) = (&solids.gradients[element], solids.volume[element]);
            forces(gradients, volume, &deformations[element], body.lambda, body.mu)
        })
        .collect();
    let stiffness = BlockMatrix::assemble(solids, pattern, |element, a, b| {
        let body = solids.body_of_element(element);
        let turned = |corner: usize| {
            let gradient = solids.gradients[element][corner];
            deformations[element].rotation * gradient
        };
        solids.volume[element] * stiffness_block(turned(a), turned(b), body.lambda, body.mu)
    });
    SolidMatrices { deformations, element_forces, stiffness }
}
