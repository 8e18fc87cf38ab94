//! The system of the solids on the device, S v = rhs with S = zeta_M M + zeta_K K: rows, buffers and set-up.
//!
//! The matrix is that of the rotated elements (`solid.rotated`) and never assembled: residuals and the operator of conjugate gradients
//! sum the products of the elements. Only the preconditioner has a matrix, of 3x3 blocks. Its rows are sorted by length in windows and
//! cut into slices of 64, for coalesced reads by one thread a row (SELL-C-sigma, Kreutzer et al. 2014).

use crate::Error;
use crate::fields::solid_system::NODES;
use crate::fields::{SolidBuffers, SolidSystemBuffers};
use crate::gpu::{Arrays, Bound, Gpu, Pass, RealBuffer, Variant, bind};
use crate::step::Stage;
use crate::wgsl;

use super::Level;
use super::pcg::Block;
use super::solid_contacts::{ContactSearch, ObstacleField, bind_touch};

/// Scalar types of outer loop and corrections: conjugate gradients are as precise as the residual, and only their preconditioner is not.
pub(super) fn corrections(variant: Variant) -> Variant {
    variant.real.into()
}

impl SolidSystemBuffers {
    /// Binds the products of the elements with a velocity.
    pub(super) fn bind_products(&self, gpu: &Gpu, fields: &SolidBuffers, x: &RealBuffer) -> Result<Bound, Error> {
        let x = [("x", x.into())];
        bind(gpu, &wgsl!("solid_products"), self.variant, x, &[self, fields])
    }

    /// Binds P (rhs - S v), given the products with v.
    pub(super) fn bind_residual(&self, gpu: &Gpu, fields: &SolidBuffers) -> Result<Bound, Error> {
        let x = [("x", (&fields.velocity).into())];
        bind(gpu, &wgsl!("solid_residual"), self.variant, x, &[self, fields])
    }

    /// Binds the start of the unknowns, with what is free of v* as a correction on trial.
    pub(super) fn bind_guess(&self, gpu: &Gpu, fields: &SolidBuffers) -> Result<Bound, Error> {
        bind(gpu, &wgsl!("solid_guess"), self.variant, [], &[self, fields])
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
            shape: crate::grid::Layout { quads: n, total: n, ..bytemuck::Zeroable::zeroed() },
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
    /// Contacts of the nodes.
    touch: Vec<Bound>,
    hold: Bound,
    search: ContactSearch,
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
            diagonals: bind(at_right_hand_side, &wgsl!("solid_diagonals"), variant, [], &tables)?,
            right_hand_side: bind(at_right_hand_side, &right_hand_side, variant, forces, &tables)?,
            touch: bind_touch(at_right_hand_side, buffers, fields, obstacles)?,
            hold: bind(at_right_hand_side, &wgsl!("hold_nodes"), variant, [], &tables)?,
            search: ContactSearch::new(gpu, buffers, fields, &buffers.rhs)?,
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

    /// Records the constraints at the start, from the right-hand side.
    pub fn record_contacts(&self, pass: &mut Pass) {
        for bound in &self.touch {
            pass.dispatch(bound, self.n_nodes);
        }
        self.record_hold(pass);
    }

    /// Records constrained velocities and the blocks on the diagonal: before every solve.
    pub fn record_hold(&self, pass: &mut Pass) {
        pass.dispatch(&self.hold, self.n_nodes);
        pass.dispatch(&self.diagonals, self.n_nodes);
    }

    /// The search for what walls and obstacles hold.
    pub fn search(&self) -> &ContactSearch {
        &self.search
    }
}
