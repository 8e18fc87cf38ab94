//! The system S v = rhs of one step of the solids (design section 2): S = zeta_M M + zeta_K K on the free components of v.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::{BlockMatrix, SolidRightHandSide};
use crate::elastic::Solids;
use crate::linalg::{Csr, LinearOperator, norm};

/// S, what S v must be, and the prescribed components of v. Vectors have three numbers per node.
#[derive(Clone, Debug)]
pub struct SolidSystem {
    stiffness: BlockMatrix,
    /// m per node, kg.
    lumped: Vec<f64>,
    /// zeta_M m per node, kg/s.
    mass: Vec<f64>,
    /// zeta_K per node, s.
    zeta_stiffness: Vec<f64>,
    /// Whether each component is an unknown.
    free: Vec<bool>,
    /// Prescribed components, m/s; 0 in free ones.
    held: Vec<f64>,
    /// The right-hand side less S times the prescribed components, N; 0 in prescribed components.
    pub rhs: Vec<f64>,
    /// What rounding of the right-hand side is a part of, N.
    pub rhs_scale: f64,
    /// s
    dt: f64,
}

impl SolidSystem {
    /// The system of a step of dt (s). `velocity`: v* of all nodes, m/s; its prescribed components are those of the answer.
    pub fn new(
        solids: &Solids,
        stiffness: BlockMatrix,
        rhs: &SolidRightHandSide,
        velocity: &[[f64; 3]],
        dt: f64,
    ) -> SolidSystem {
        let n = solids.rest.len();
        let prescribed = solids.prescribed.as_flattened();
        let held = |(v, prescribed): (&f64, &bool)| if *prescribed { *v } else { 0.0 };
        let velocity = velocity.as_flattened().iter();
        let mut system = SolidSystem {
            stiffness,
            lumped: solids.mass.clone(),
            mass: (0..n)
                .map(|node| solids.body_of_node(node).zeta_mass(dt) * solids.mass[node])
                .collect(),
            zeta_stiffness: (0..n)
                .map(|node| solids.body_of_node(node).zeta_stiffness(dt))
                .collect(),
            free: prescribed.iter().map(|prescribed| !prescribed).collect(),
            held: velocity.zip(prescribed).map(held).collect(),
            rhs: Vec::new(),
            rhs_scale: rhs.scale,
            dt,
        };
        // S times the held components is on the other side.
        let pull = system.product(&system.held);
        let values = rhs.values.as_flattened().iter();
        system.rhs = values
            .zip(&pull)
            .map(|(value, pull)| value - pull)
            .collect();
        system.rhs_scale += norm(&pull);
        system
    }

    /// Length of the step, s.
    pub fn dt(&self) -> f64 {
        self.dt
    }

    /// Components that are unknowns, ascending: three times the node, plus 0, 1, 2 for x, y, z.
    pub fn unknowns(&self) -> Vec<usize> {
        let components = 0..self.free.len();
        components
            .filter(|&component| self.free[component])
            .collect()
    }

    /// rhs - S x on the free components, 0 in prescribed ones.
    pub fn residual(&self, x: &[f64]) -> Vec<f64> {
        let product = self.product(x);
        let rhs = self.rhs.iter();
        rhs.zip(product)
            .map(|(rhs, product)| rhs - product)
            .collect()
    }

    /// Velocities of all nodes from the unknowns, m/s.
    pub fn velocity(&self, x: &[f64]) -> Vec<[f64; 3]> {
        let (nodes, _) = x.as_chunks::<3>();
        let (held, _) = self.held.as_chunks::<3>();
        let sums = nodes.iter().zip(held);
        sums.map(|(x, held)| std::array::from_fn(|axis| x[axis] + held[axis]))
            .collect()
    }

    /// zeta_M m per node, kg/s: what of S is mass.
    pub fn mass_term(&self) -> &[f64] {
        &self.mass
    }

    /// S with all components, also the prescribed ones.
    pub fn to_csr(&self) -> Csr {
        let n = self.free.len();
        Csr::from_rows(n, n, |row, entries| {
            self.push_row(row, entries, &mut |column| Some(column))
        })
    }

    /// K with all components, N/m.
    pub fn stiffness_to_csr(&self) -> Csr {
        self.stiffness.to_csr()
    }

    /// M with all components, kg: lumped, so diagonal.
    pub fn mass_to_csr(&self) -> Csr {
        let n = self.free.len();
        Csr::from_rows(n, n, |row, entries| {
            entries.push((row, self.lumped[row / 3]));
        })
    }

    /// S on the free components, numbered in order.
    pub fn free_to_csr(&self) -> Csr {
        let unknowns = self.unknowns();
        let mut number = vec![None; self.free.len()];
        for (n, &component) in unknowns.iter().enumerate() {
            number[component] = Some(n);
        }
        let n = unknowns.len();
        Csr::from_rows(n, n, |row, entries| {
            self.push_row(unknowns[row], entries, &mut |column| number[column]);
        })
    }

    /// Pushes the row of a component, its columns renamed; those without a name are left out.
    fn push_row(
        &self,
        component: usize,
        entries: &mut Vec<(usize, f64)>,
        rename: &mut dyn FnMut(usize) -> Option<usize>,
    ) {
        let (node, axis) = (component / 3, component % 3);
        for (other, block) in self.stiffness.row(node) {
            let numbers = self.zeta_stiffness[node] * block.row(axis);
            for other_axis in 0..3 {
                let column = 3 * other + other_axis;
                let mass = if column == component {
                    self.mass[node]
                } else {
                    0.0
                };
                if let Some(name) = rename(column) {
                    entries.push((name, numbers[other_axis] + mass));
                }
            }
        }
    }

    /// The block of a node on the diagonal of S, with 1 in place of what is prescribed.
    pub(super) fn diagonal(&self, node: usize) -> DMat3 {
        let mass = DMat3::from_diagonal(DVec3::splat(self.mass[node]));
        let mut block = mass + self.zeta_stiffness[node] * self.stiffness.diagonal(node);
        for axis in (0..3).filter(|axis| !self.free[3 * node + axis]) {
            for other in 0..3 {
                block.col_mut(axis)[other] = 0.0;
                block.col_mut(other)[axis] = 0.0;
            }
            block.col_mut(axis)[axis] = 1.0;
        }
        block
    }

    /// S x, 0 in prescribed components.
    fn product(&self, x: &[f64]) -> Vec<f64> {
        let mut product = vec![0.0; x.len()];
        self.apply(x, &mut product);
        product
    }
}

/// S x on the free components, 0 in prescribed ones.
impl LinearOperator for SolidSystem {
    fn size(&self) -> usize {
        self.free.len()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        y.par_chunks_mut(3)
            .with_min_len(256)
            .enumerate()
            .for_each(|(node, y)| {
                let elastic = self.zeta_stiffness[node] * self.stiffness.product(node, x);
                for axis in 0..3 {
                    let component = 3 * node + axis;
                    y[axis] = match self.free[component] {
                        true => self.mass[node] * x[component] + elastic[axis],
                        false => 0.0,
                    };
                }
            });
    }
}
