//! Sparse sums of patch values by cell and node, stored by cell and by node.

use std::ops::AddAssign;

use glam::DVec3;
use rayon::prelude::*;

use super::{Patch, counting_sort};

/// One vector per pair of a cell and a node with a common patch.
///
/// With area times normal, weighted by the barycentric coordinates of the centroid, it is J (N^T C of thesis 5.10, 5.14):
///
/// ```text
/// (J v)_c = sum over the nodes of c of value . v_node        (J^T p)_node = sum over the cells of node of value p_c
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Coupling {
    /// Cells with patches, ascending.
    cells: Vec<usize>,
    /// Start of each cell's pairs; one more than there are cells.
    cell_start: Vec<usize>,
    by_cell: Vec<CellNode>,
    /// Start of each node's pairs; one more than there are nodes.
    node_start: Vec<usize>,
    by_node: Vec<CellNode>,
}

/// A pair of a cell and a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellNode {
    /// Host index of the cell.
    pub cell: usize,
    /// Node number among all solids.
    pub node: usize,
    /// Sum over the common patches.
    pub value: DVec3,
}

impl Coupling {
    /// J, m^2. `triangles` has the nodes of each surface triangle, `n_nodes` counts those of all solids.
    pub fn new(patches: &[Patch], triangles: &[[u32; 3]], n_nodes: usize) -> Coupling {
        Coupling::from_patches(patches, triangles, n_nodes, |patch, corner| {
            patch.area * patch.barycentric[corner] * patch.normal
        })
    }

    /// Sums `value` over patches and corners, in the order of the patches.
    pub fn from_patches(
        patches: &[Patch],
        triangles: &[[u32; 3]],
        n_nodes: usize,
        value: impl Fn(&Patch, usize) -> DVec3 + Sync,
    ) -> Coupling {
        let value = &value;
        let corners = move |&(cell, number): &(usize, usize)| {
            let patch = &patches[number];
            let nodes = triangles[patch.triangle].into_iter().enumerate();
            nodes.map(move |(corner, node)| CellNode { cell, node: node as usize, value: value(patch, corner) })
        };
        let order = by_cell(patches);
        let cells: Vec<&[(usize, usize)]> = order.chunk_by(|a, b| a.0 == b.0).collect();
        let cell_pairs = |cell: &[(usize, usize)]| {
            let mut pairs: Vec<CellNode> = cell.iter().flat_map(corners).collect();
            // Stable, so that sums are in the order of the patches.
            pairs.sort_by_key(|pair| pair.node);
            pairs.dedup_by(|next, kept| {
                let same = next.node == kept.node;
                if same {
                    kept.value += next.value;
                }
                same
            });
            pairs
        };
        Coupling::sorted(cells.into_par_iter().flat_map_iter(cell_pairs).collect(), n_nodes)
    }

    /// Sums of `value` for each of the [`Coupling::pairs`], starting from zero, in the order of the patches.
    pub fn sums<T: Copy + AddAssign + Send + Sync>(
        &self,
        zero: T,
        patches: &[Patch],
        triangles: &[[u32; 3]],
        value: impl Fn(&Patch, usize) -> T + Sync,
    ) -> Vec<T> {
        let order = by_cell(patches);
        let cell_sums = |row: usize| {
            let (cell, pairs) = (self.cells[row], &self.by_cell[self.cell_start[row]..self.cell_start[row + 1]]);
            let mut sums = vec![zero; pairs.len()];
            let first = order.partition_point(|&(other, _)| other < cell);
            for &(_, number) in order[first..].iter().take_while(|(other, _)| *other == cell) {
                let patch = &patches[number];
                for (corner, node) in triangles[patch.triangle].into_iter().enumerate() {
                    if let Ok(at) = pairs.binary_search_by_key(&(node as usize), |pair| pair.node) {
                        sums[at] += value(patch, corner);
                    }
                }
            }
            sums
        };
        (0..self.cells.len()).into_par_iter().flat_map_iter(cell_sums).collect()
    }

    /// `by_cell` is sorted by cell, then by node.
    fn sorted(by_cell: Vec<CellNode>, n_nodes: usize) -> Coupling {
        let (mut cells, mut cell_start) = (Vec::new(), Vec::new());
        for (at, pair) in by_cell.iter().enumerate() {
            if cells.last() != Some(&pair.cell) {
                cells.push(pair.cell);
                cell_start.push(at);
            }
        }
        cell_start.push(by_cell.len());
        let (node_start, order) = counting_sort(n_nodes, by_cell.iter().map(|pair| pair.node));
        let by_node = order.into_iter().map(|pair| by_cell[pair]).collect();
        Coupling { cells, cell_start, by_cell, node_start, by_node }
    }

    /// The pairs of the cells for which `keep` is true.
    pub fn restricted(&self, keep: impl Fn(usize) -> bool) -> Coupling {
        let pairs = self.by_cell.iter().filter(|pair| keep(pair.cell));
        Coupling::sorted(pairs.copied().collect(), self.n_nodes())
    }

    /// The same pairs with other values.
    pub fn mapped(&self, value: impl Fn(DVec3) -> DVec3) -> Coupling {
        let mut mapped = self.clone();
        for pair in mapped.by_cell.iter_mut().chain(&mut mapped.by_node) {
            pair.value = value(pair.value);
        }
        mapped
    }

    /// Number of nodes, with and without patches.
    pub fn n_nodes(&self) -> usize {
        self.node_start.len().saturating_sub(1)
    }

    /// All pairs, by cell, then by node.
    pub fn pairs(&self) -> &[CellNode] {
        &self.by_cell
    }

    /// Cells with patches, ascending, with their pairs.
    pub fn cells(&self) -> impl Iterator<Item = (usize, &[CellNode])> {
        let ranges = self.cell_start.windows(2);
        let cells = self.cells.iter().zip(ranges);
        cells.map(|(&cell, range)| (cell, &self.by_cell[range[0]..range[1]]))
    }

    /// The pairs of a cell, nodes ascending.
    pub fn cell_pairs(&self, cell: usize) -> &[CellNode] {
        match self.cells.binary_search(&cell) {
            Ok(row) => &self.by_cell[self.cell_start[row]..self.cell_start[row + 1]],
            Err(_) => &[],
        }
    }

    /// The pairs of a node, cells ascending.
    pub fn node_pairs(&self, node: usize) -> &[CellNode] {
        &self.by_node[self.node_start[node]..self.node_start[node + 1]]
    }

    /// out += J v, with three numbers per node in `v` and one per cell in `out`.
    pub fn add_product(&self, v: &[f64], out: &mut [f64]) {
        for (cell, pairs) in self.cells() {
            let terms = pairs.iter().map(|pair| pair.value.dot(DVec3::from_slice(&v[3 * pair.node..])));
            out[cell] += terms.sum::<f64>();
        }
    }

    /// out += J^T p, with one number per cell in `p` and three per node in `out`.
    pub fn add_transposed(&self, p: &[f64], out: &mut [f64]) {
        for (node, out) in out.chunks_exact_mut(3).enumerate() {
            let terms = self.node_pairs(node).iter();
            let sum: DVec3 = terms.map(|pair| pair.value * p[pair.cell]).sum();
            for (out, sum) in out.iter_mut().zip(sum.to_array()) {
                *out += sum;
            }
        }
    }
}

/// Cell and number of each patch, by cell, the patches of a cell in their order.
fn by_cell(patches: &[Patch]) -> Vec<(usize, usize)> {
    let mut order: Vec<(usize, usize)> = patches.iter().map(|patch| patch.cell).zip(0..).collect();
    order.par_sort_unstable();
    order
}
