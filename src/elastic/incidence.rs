//! Topology of a tetrahedral mesh: elements of each node, neighbours, and elements common to two nodes.

use std::ops::Range;

use rayon::prelude::*;

/// An element at a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Corner {
    /// Element.
    pub element: u32,
    /// Corner of the element that is the node.
    pub corner: u8,
}

/// An element common to two nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Joint {
    /// Element.
    pub element: u32,
    /// Corners that are the row's and the column's node.
    pub corners: [u8; 2],
}

/// Incidence of a mesh, all lists ascending, so that sums are bitwise reproducible.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Incidence {
    /// Start of each node's corners; one more than there are nodes.
    corner_start: Vec<usize>,
    corners: Vec<Corner>,
    /// Start of each node's neighbours; one more than there are nodes.
    row_start: Vec<usize>,
    neighbours: Vec<u32>,
    /// Start of each neighbour's joints; one more than there are neighbours in all rows.
    joint_start: Vec<usize>,
    joints: Vec<Joint>,
}

impl Incidence {
    /// # Panics
    /// If an element has a node beyond `n_nodes`.
    pub fn new(n_nodes: usize, elements: &[[u32; 4]]) -> Incidence {
        let mut incidence = Incidence::default();
        incidence.set_corners(n_nodes, elements);
        let rows: Vec<Vec<(u32, Joint)>> =
            (0..n_nodes).into_par_iter().map(|node| incidence.row(node, elements)).collect();
        incidence.row_start.push(0);
        for row in rows {
            let first = incidence.neighbours.len();
            for (neighbour, joint) in row {
                let known = &incidence.neighbours[first..];
                if known.last() != Some(&neighbour) {
                    incidence.neighbours.push(neighbour);
                    incidence.joint_start.push(incidence.joints.len());
                }
                incidence.joints.push(joint);
            }
            incidence.row_start.push(incidence.neighbours.len());
        }
        incidence.joint_start.push(incidence.joints.len());
        incidence
    }

    fn set_corners(&mut self, n_nodes: usize, elements: &[[u32; 4]]) {
        let mut start = vec![0; n_nodes + 1];
        for &node in elements.iter().flatten() {
            start[node as usize + 1] += 1;
        }
        for node in 0..n_nodes {
            start[node + 1] += start[node];
        }
        let mut next = start.clone();
        let nobody = Corner { element: 0, corner: 0 };
        self.corners = vec![nobody; 4 * elements.len()];
        for (element, nodes) in (0..).zip(elements) {
            for (corner, &node) in (0..).zip(nodes) {
                self.corners[next[node as usize]] = Corner { element, corner };
                next[node as usize] += 1;
            }
        }
        self.corner_start = start;
    }

    /// Neighbours of a node with their joints, ascending.
    fn row(&self, node: usize, elements: &[[u32; 4]]) -> Vec<(u32, Joint)> {
        let corners = self.corners(node).iter();
        let mut row: Vec<(u32, Joint)> = corners
            .flat_map(|&Corner { element, corner }| {
                let others = (0..).zip(elements[element as usize]);
                let others = others.filter(move |(other, _)| *other != corner);
                others.map(move |(other, neighbour)| {
                    let corners = [corner, other];
                    (neighbour, Joint { element, corners })
                })
            })
            .collect();
        row.sort_unstable();
        row
    }

    /// Number of nodes.
    pub fn n_nodes(&self) -> usize {
        self.corner_start.len().saturating_sub(1)
    }

    /// The elements of a node.
    pub fn corners(&self, node: usize) -> &[Corner] {
        &self.corners[self.corner_start[node]..self.corner_start[node + 1]]
    }

    /// The other nodes of a node's elements.
    pub fn neighbours(&self, node: usize) -> &[u32] {
        &self.neighbours[self.blocks(node)]
    }

    /// Numbers of the off-diagonal blocks in a node's row, one per neighbour.
    pub fn blocks(&self, node: usize) -> Range<usize> {
        self.row_start[node]..self.row_start[node + 1]
    }

    /// Number of off-diagonal blocks: twice the edges of the mesh.
    pub fn n_blocks(&self) -> usize {
        self.neighbours.len()
    }

    /// Elements common to the two nodes of a block.
    pub fn joints(&self, block: usize) -> &[Joint] {
        &self.joints[self.joint_start[block]..self.joint_start[block + 1]]
    }

    /// Number of joints of all blocks: twelve per element.
    pub fn n_joints(&self) -> usize {
        self.joints.len()
    }
}
