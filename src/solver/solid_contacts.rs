//! Walls and obstacles in the system of the solids: which nodes they hold, before the first solve of a sub-step and after each.
//!
//! The rules, and the active set that they make, stand with the twin, `reference/solid_contacts.rs`.

use crate::Error;
use crate::gpu::{Bound, Buffer, Gpu, Kernel, Pass, RealBuffer};
use crate::grid::Layout;

use super::solid_system::{SolidFields, SolidSystemBuffers};

/// The distance to the obstacles.
#[derive(Clone, Copy, Debug)]
pub struct ObstacleField<'a> {
    /// Its layout.
    pub level: &'a Buffer<Layout>,
    /// Cell centres, m.
    pub solid_distance: &'a Buffer<f32>,
}

/// The kernels.
#[derive(Debug)]
pub(super) struct SolidContacts {
    /// Who touches what and is pressed to it: walls, then obstacles.
    touch: Vec<Bound>,
    hold: Bound,
    update: Update,
    n_nodes: usize,
}

/// Who is held after a solve: products of the elements with the velocity, and what follows from them.
#[derive(Debug)]
pub(super) struct Update([Bound; 2]);

impl Update {
    /// Compiles and binds. `pushes`: what pushes nodes, N, `Real4` per node.
    pub(super) fn new(
        gpu: &Gpu,
        buffers: &SolidSystemBuffers,
        fields: SolidFields,
        pushes: &RealBuffer,
    ) -> Result<Update, Error> {
        Ok(Update([
            buffers.bind_products(gpu, fields, fields.velocity)?,
            Kernel::new(gpu, &crate::wgsl!("update_contacts"), buffers.variant)?.bind(
                gpu,
                &[
                    ("step", fields.step),
                    ("gaps", fields.gaps.into()),
                    ("incidence", (&buffers.incidence).into()),
                    ("products", (&buffers.products).into()),
                    ("masses", (&buffers.masses).into()),
                    ("rhs", pushes.into()),
                    ("velocity", fields.velocity.into()),
                    ("freedom", fields.freedom.into()),
                    ("changes", fields.changes.into()),
                ],
            )?,
        ]))
    }

    pub(super) fn record(&self, pass: &mut Pass, n_nodes: usize) {
        for bound in &self.0 {
            pass.dispatch(bound, n_nodes);
        }
    }
}

impl SolidContacts {
    pub(super) fn new(
        gpu: &Gpu,
        buffers: &SolidSystemBuffers,
        fields: SolidFields,
        obstacles: Option<ObstacleField>,
    ) -> Result<SolidContacts, Error> {
        let kernel = |source| Kernel::new(gpu, source, buffers.variant);
        let step = ("step", fields.step);
        let rest = ("rest", fields.rest.into());
        let displacement = ("displacement", fields.displacement.into());
        let gaps = ("gaps", fields.gaps.into());
        let freedom = ("freedom", fields.freedom.into());
        let rhs = ("rhs", (&buffers.rhs).into());
        let velocity = ("velocity", fields.velocity.into());
        let flags = ("flags", fields.flags.into());
        let mut touch = vec![
            kernel(&crate::wgsl!("solid_contacts"))?
                .bind(gpu, &[step, rest, flags, displacement, rhs, gaps, freedom])?,
        ];
        if let Some(obstacles) = obstacles {
            let level = ("level", obstacles.level.into());
            let distance = ("distances", obstacles.solid_distance.into());
            let bindings = [
                level,
                step,
                rest,
                displacement,
                distance,
                rhs,
                gaps,
                freedom,
            ];
            touch.push(kernel(&crate::wgsl!("obstacle_contacts"))?.bind(gpu, &bindings)?);
        }
        Ok(SolidContacts {
            touch,
            hold: kernel(&crate::wgsl!("hold_nodes"))?
                .bind(gpu, &[step, gaps, freedom, velocity])?,
            update: Update::new(gpu, buffers, fields, &buffers.rhs)?,
            n_nodes: buffers.sizes.n_nodes as usize,
        })
    }

    pub(super) fn record_touch(&self, pass: &mut Pass) {
        for bound in &self.touch {
            pass.dispatch(bound, self.n_nodes);
        }
    }

    pub(super) fn record_hold(&self, pass: &mut Pass) {
        pass.dispatch(&self.hold, self.n_nodes);
    }

    pub(super) fn record_update(&self, pass: &mut Pass) {
        self.update.record(pass, self.n_nodes);
    }
}
