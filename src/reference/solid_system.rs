//! The system S v = rhs of one sub-step of the solids: S = zeta_M M + zeta_K K in the free directions.
//!
//! With the constraint projector P ([`Freedom`]), v = P x + c with the constrained part c.
//! The unknown x solves P S P x = P (rhs - S c).

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::{BlockMatrix, Freedom, SolidRightHandSide};
use crate::elastic::{Body, Solids};
use crate::linalg::{Csr, LinearOperator, norm};

/// S, the right-hand side, and the constrained part of v. Vectors have three numbers per node.
#[derive(Clone, Debug)]
pub struct SolidSystem {
    stiffness: BlockMatrix,
    /// m per node, kg.
    lumped: Vec<f64>,
    /// zeta_M m per node, kg/s.
    mass: Vec<f64>,
    /// zeta_K per node, s.
    zeta_stiffness: Vec<f64>,
    /// Constraint projector per node.
    freedom: Vec<Freedom>,
    /// M v*/dt - (K x* - b) + load, N.
    forces: Vec<[f64; 3]>,
    /// Scale of the rounding error of `forces`, N.
    forces_scale: f64,
    /// (I - P) v*, m/s.
    constrained: Vec<f64>,
    /// P (rhs - S c), N.
    pub rhs: Vec<f64>,
    /// Scale of the rounding error of the right-hand side, N.
    pub rhs_scale: f64,
    /// Length of the step, s.
    dt: f64,
}

impl SolidSystem {
    /// The system of a step of dt (s). `velocity`: v* of all nodes, m/s; its constrained part is that of the
    /// solution.
    pub fn new(
        solids: &Solids,
        stiffness: BlockMatrix,
        rhs: &SolidRightHandSide,
        velocity: &[[f64; 3]],
        freedom: Vec<Freedom>,
        dt: f64,
    ) -> SolidSystem {
        let n = solids.rest.len();
        let mut system = SolidSystem {
            stiffness,
            lumped: solids.mass.clone(),
            mass: (0..n).map(|node| solids.body_of_node(node).zeta_mass(dt) * solids.mass[node]).collect(),
            zeta_stiffness: (0..n).map(|node| solids.body_of_node(node).zeta_stiffness(dt)).collect(),
            freedom: Vec::new(),
            forces: rhs.values.clone(),
            forces_scale: rhs.scale,
            constrained: Vec::new(),
            rhs: Vec::new(),
            rhs_scale: 0.0,
            dt,
        };
        system.free(freedom, velocity);
        system
    }

    /// Replaces the constraint projectors. The constrained part of the velocities (m/s) is that of the solution.
    pub fn free(&mut self, freedom: Vec<Freedom>, velocity: &[[f64; 3]]) {
        self.freedom = freedom;
        let all = velocity.as_flattened().iter();
        let constrained = all.zip(self.free_part(velocity)).map(|(v, free)| v - free);
        self.constrained = constrained.collect();
        // Moves the constrained part of S v to the right-hand side.
        let constrained_product = self.product(&self.constrained);
        let values = self.free_part(&self.forces);
        let pairs = values.iter().zip(&constrained_product);
        self.rhs = pairs.map(|(value, constrained_product)| value - constrained_product).collect();
        self.rhs_scale = self.forces_scale + norm(&constrained_product);
    }

    /// The system of the same step with other zeta_M (1/s) and zeta_K (s) per body, and another right-hand side.
    pub fn changed(&self, solids: &Solids, zeta: impl Fn(&Body) -> [f64; 2], rhs: &SolidRightHandSide) -> SolidSystem {
        let mut system = self.clone();
        for node in 0..self.mass.len() {
            let [mass, stiffness] = zeta(solids.body_of_node(node));
            system.mass[node] = mass * self.lumped[node];
            system.zeta_stiffness[node] = stiffness;
        }
        system.forces.clone_from(&rhs.values);
        system.forces_scale = rhs.scale;
        let constrained: Vec<[f64; 3]> = self.constrained.as_chunks().0.to_vec();
        system.free(self.freedom.clone(), &constrained);
        system
    }

    /// The right-hand side with all directions free.
    pub fn right_hand_side(&self) -> SolidRightHandSide {
        SolidRightHandSide { values: self.forces.clone(), scale: self.forces_scale }
    }

    /// M v / dt in components that are not prescribed, N; `velocity` in m/s.
    pub fn inertia(&self, velocity: &[[f64; 3]]) -> SolidRightHandSide {
        let nodes = self.lumped.iter().zip(velocity).zip(&self.freedom);
        let values = nodes.map(|((mass, v), freedom)| {
            std::array::from_fn(|axis| match freedom.free[axis] {
                true => mass * v[axis] / self.dt,
                false => 0.0,
            })
        });
        let values: Vec<[f64; 3]> = values.collect();
        SolidRightHandSide { scale: norm(values.as_flattened()), values }
    }

    /// Adds forces on all nodes, N, three numbers per node.
    pub fn push(&mut self, forces: &[f64]) {
        let (nodes, _) = forces.as_chunks::<3>();
        let free = self.free_part(nodes);
        for (rhs, force) in self.rhs.iter_mut().zip(&free) {
            *rhs += force;
        }
        for ((sums, forces), freedom) in self.forces.iter_mut().zip(nodes).zip(&self.freedom) {
            for axis in (0..3).filter(|&axis| freedom.free[axis]) {
                sums[axis] += forces[axis];
            }
        }
        self.rhs_scale += norm(&free);
        self.forces_scale += norm(&free);
    }

    /// M v*/dt - (K x* - b) + load per node, N; 0 in prescribed components.
    pub fn forces(&self) -> &[[f64; 3]] {
        &self.forces
    }

    /// P y: the free part of node vectors.
    pub fn free_part(&self, y: &[[f64; 3]]) -> Vec<f64> {
        let nodes = self.freedom.iter().zip(y);
        nodes.flat_map(|(freedom, &y)| (freedom.projector * DVec3::from(y)).to_array()).collect()
    }

    /// Constraint projector per node.
    pub fn freedom(&self) -> &[Freedom] {
        &self.freedom
    }

    /// Number of unknowns: free directions of all nodes.
    pub fn n_unknowns(&self) -> usize {
        self.freedom.iter().map(Freedom::rank).sum()
    }

    /// Length of the step, s.
    pub fn dt(&self) -> f64 {
        self.dt
    }

    /// Components that are not prescribed, ascending: three times the node, plus 0, 1, 2 for x, y, z.
    pub fn components(&self) -> Vec<usize> {
        let components = 0..3 * self.freedom.len();
        components.filter(|&component| self.is_free(component)).collect()
    }

    fn is_free(&self, component: usize) -> bool {
        self.freedom[component / 3].free[component % 3]
    }

    /// P (rhs - S x) for x = P x.
    pub fn residual(&self, x: &[f64]) -> Vec<f64> {
        let product = self.product(x);
        let rhs = self.rhs.iter();
        rhs.zip(product).map(|(rhs, product)| rhs - product).collect()
    }

    /// Velocities of all nodes from the unknowns, m/s.
    pub fn velocity(&self, x: &[f64]) -> Vec<[f64; 3]> {
        let (nodes, _) = x.as_chunks::<3>();
        let (constrained, _) = self.constrained.as_chunks::<3>();
        let sums = nodes.iter().zip(constrained);
        sums.map(|(x, constrained)| std::array::from_fn(|axis| x[axis] + constrained[axis])).collect()
    }

    /// zeta_M m per node, kg/s: the mass term of S.
    pub fn mass_term(&self) -> &[f64] {
        &self.mass
    }

    /// S v at all nodes without constraints, N; `velocity` in m/s.
    pub fn multiply(&self, velocity: &[[f64; 3]]) -> Vec<DVec3> {
        let x = velocity.as_flattened();
        let nodes = (0..velocity.len()).into_par_iter();
        nodes.map(|node| self.row_times(node, x)).collect()
    }

    /// phi(to) - phi(from), W, with phi(v) = v . S v / 2 - F . v and F all forces. The velocities (m/s) differ in
    /// free directions only. Computed from their difference, because a difference of two sums would cancel.
    pub fn gain(&self, from: &[[f64; 3]], to: &[[f64; 3]]) -> f64 {
        let pairs = from.iter().zip(to);
        let sums: Vec<[f64; 3]> = pairs.map(|(from, to)| [0, 1, 2].map(|axis| from[axis] + to[axis])).collect();
        let slopes = self.multiply(&sums).into_iter().zip(&self.forces);
        let slopes = slopes.map(|(product, forces)| 0.5 * product - DVec3::from(*forces));
        let ways = from.iter().zip(to);
        let ways = ways.map(|(from, to)| DVec3::from(*to) - DVec3::from(*from));
        slopes.zip(ways).map(|(slope, way)| slope.dot(way)).sum()
    }

    /// Constrains all nodes to velocities, m/s.
    pub fn hold_all(&mut self, velocity: &[[f64; 3]]) {
        let freedom = self.freedom.iter();
        let none = freedom.map(|freedom| Freedom::none(freedom.free.map(|free| !free)));
        self.free(none.collect(), velocity);
    }

    /// S x at a node.
    fn row_times(&self, node: usize, x: &[f64]) -> DVec3 {
        let inertia = self.mass[node] * DVec3::from_slice(&x[3 * node..]);
        inertia + self.zeta_stiffness[node] * self.stiffness.product(node, x)
    }

    /// Mean of the diagonal of S at a node, kg/s.
    pub fn mean_diagonal(&self, node: usize) -> f64 {
        let block = self.stiffness.diagonal(node);
        let trace: f64 = [0, 1, 2].map(|axis| block.col(axis)[axis]).iter().sum();
        self.mass[node] + self.zeta_stiffness[node] * trace / 3.0
    }

    /// S with all components, including prescribed ones.
    pub fn to_csr(&self) -> Csr {
        let n = 3 * self.freedom.len();
        Csr::from_rows(n, n, |row, entries| {
            let (node, axis) = (row / 3, row % 3);
            for (other, block) in self.stiffness.row(node) {
                let numbers = self.zeta_stiffness[node] * block.row(axis);
                for other_axis in 0..3 {
                    let column = 3 * other + other_axis;
                    let mass = if column == row { self.mass[node] } else { 0.0 };
                    entries.push((column, numbers[other_axis] + mass));
                }
            }
        })
    }

    /// K with all components, N/m.
    pub fn stiffness_to_csr(&self) -> Csr {
        self.stiffness.to_csr()
    }

    /// M with all components, kg: lumped, so diagonal.
    pub fn mass_to_csr(&self) -> Csr {
        let n = 3 * self.freedom.len();
        Csr::from_rows(n, n, |row, entries| {
            entries.push((row, self.lumped[row / 3]));
        })
    }

    /// Index of each component among those that are not prescribed.
    fn numbers(&self) -> Vec<Option<usize>> {
        let mut number = vec![None; 3 * self.freedom.len()];
        for (n, &component) in self.components().iter().enumerate() {
            number[component] = Some(n);
        }
        number
    }

    /// P: a row per component, a column per component that is not prescribed, numbered in order.
    pub fn free_directions(&self) -> Csr {
        let number = self.numbers();
        Csr::from_rows(number.len(), self.components().len(), |row, entries| {
            let (node, axis) = (row / 3, row % 3);
            let values = self.freedom[node].projector.row(axis);
            entries.extend((0..3).filter_map(|other| number[3 * node + other].map(|column| (column, values[other]))));
        })
    }

    /// P S P + mu (I - P) on components that are not prescribed, numbered in order; mu is the mean diagonal at a
    /// node. Constrained directions have x = 0, and the pattern is that of S for any active set.
    pub fn free_to_csr(&self) -> Csr {
        let (components, number) = (self.components(), self.numbers());
        let n = components.len();
        Csr::from_rows(n, n, |row, entries| {
            let (node, axis) = (components[row] / 3, components[row] % 3);
            for (other, block) in self.stiffness.row(node) {
                let mut block = self.zeta_stiffness[node] * block;
                if other == node {
                    block += DMat3::from_diagonal(DVec3::splat(self.mass[node]));
                }
                let numbers = self.projected(node, other, block).row(axis);
                for other_axis in 0..3 {
                    if let Some(name) = number[3 * other + other_axis] {
                        entries.push((name, numbers[other_axis]));
                    }
                }
            }
        })
    }

    /// The block of two nodes in P S P + mu (I - P).
    fn projected(&self, node: usize, other: usize, block: DMat3) -> DMat3 {
        let [left, right] = [node, other].map(|node| self.freedom[node].projector);
        let mut projected = left * block * right;
        if node == other {
            projected += self.mean_diagonal(node) * (DMat3::IDENTITY - left);
        }
        projected
    }

    /// The block of a node on the diagonal of P S P + mu (I - P).
    pub(super) fn diagonal(&self, node: usize) -> DMat3 {
        let mass = DMat3::from_diagonal(DVec3::splat(self.mass[node]));
        let block = mass + self.zeta_stiffness[node] * self.stiffness.diagonal(node);
        self.projected(node, node, block)
    }

    /// P S x.
    fn product(&self, x: &[f64]) -> Vec<f64> {
        let mut product = vec![0.0; x.len()];
        self.apply(x, &mut product);
        product
    }
}

/// P S x.
impl LinearOperator for SolidSystem {
    fn size(&self) -> usize {
        3 * self.freedom.len()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        y.par_chunks_mut(3).with_min_len(256).enumerate().for_each(|(node, y)| {
            let free = self.freedom[node].projector * self.row_times(node, x);
            y.copy_from_slice(&free.to_array());
        });
    }
}
