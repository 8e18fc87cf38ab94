//! Walls and obstacles in the system of the solids: which nodes they hold, before the first solve of a sub-step and after each.
//!
//! The rules, and the active set that they make, stand with the twin, `reference/solid_contacts.rs`.

use crate::Error;
use crate::gpu::{Bound, Buffer, Gpu, Kernel, Pass, RealBuffer};
use crate::grid::Layout;
use crate::step::Stage;

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
    pub(super) search: ContactSearch,
    n_nodes: usize,
}

/// The search for who is held, from one solve to the next: its method stands with the twin.
#[derive(Debug)]
pub struct ContactSearch {
    /// Products of the elements with the velocity.
    products: Bound,
    judge: Bound,
    rest: Bound,
    /// The next velocity on trial, with products of its sum with the best one.
    approach: [Bound; 3],
    judge_gain: Bound,
    first_stop: Bound,
    hold_stopped: Bound,
    n_nodes: usize,
}

impl ContactSearch {
    /// Compiles and binds. `pushes`: what pushes nodes, N, `Real4` per node.
    pub(super) fn new(
        gpu: &Gpu,
        buffers: &SolidSystemBuffers,
        fields: SolidFields,
        pushes: &RealBuffer,
    ) -> Result<ContactSearch, Error> {
        let kernel = |source| Kernel::new(gpu, source, buffers.variant);
        let step = ("step", fields.step);
        let gaps = ("gaps", fields.gaps.into());
        let incidence = ("incidence", (&buffers.incidence).into());
        let products = ("products", (&buffers.products).into());
        let masses = ("masses", (&buffers.masses).into());
        let rhs = ("rhs", pushes.into());
        let velocity = ("velocity", fields.velocity.into());
        let answer = ("answer", fields.answer.into());
        let best = ("best", (&buffers.best).into());
        let next = ("next", (&buffers.z).into());
        let sums = ("sums", (&buffers.search).into());
        let partials = ("partials", (&buffers.partials).into());
        let freedom = ("freedom", fields.freedom.into());
        let of_judge = [
            step, gaps, incidence, products, masses, rhs, velocity, freedom, answer,
        ];
        let of_gain = [step, incidence, products, masses, rhs, best, next, partials];
        let of_stopped = [step, gaps, best, velocity, freedom, answer];
        Ok(ContactSearch {
            products: buffers.bind_products(gpu, fields, fields.velocity)?,
            judge: kernel(&crate::wgsl!("judge_contacts"))?.bind(gpu, &of_judge)?,
            rest: kernel(&crate::wgsl!("rest_nodes"))?.bind(gpu, &[step, gaps, velocity, best])?,
            approach: [
                kernel(&crate::wgsl!("approach_nodes"))?
                    .bind(gpu, &[step, gaps, answer, best, velocity, next, sums])?,
                buffers.bind_products(gpu, fields, &buffers.search)?,
                kernel(&crate::wgsl!("measure_gain"))?.bind(gpu, &of_gain)?,
            ],
            judge_gain: kernel(&crate::wgsl!("judge_gain"))?
                .bind(gpu, &[step, partials, answer])?,
            first_stop: kernel(&crate::wgsl!("first_stop"))?
                .bind(gpu, &[step, gaps, best, velocity, answer])?,
            hold_stopped: kernel(&crate::wgsl!("hold_stopped"))?.bind(gpu, &of_stopped)?,
            n_nodes: buffers.sizes.n_nodes as usize,
        })
    }

    /// Records what is wrong with the velocities in the fields: answers with the nodes beyond and the nodes pulled, and told 1 lets these go.
    pub fn record_judge(&self, pass: &mut Pass) {
        pass.dispatch(&self.products, self.n_nodes);
        pass.dispatch(&self.judge, self.n_nodes);
    }

    /// Records the velocity that the search starts from, before any other is the best.
    pub fn record_rest(&self, pass: &mut Pass) {
        pass.dispatch(&self.rest, self.n_nodes);
    }

    /// Records the next velocity, on the way from the best one to that in the fields, told the bits of the share in f32; answers 1 where phi
    /// grows on it.
    pub fn record_approach(&self, pass: &mut Pass) {
        for bound in &self.approach {
            pass.dispatch(bound, self.n_nodes);
        }
        pass.dispatch(&self.judge_gain, 1);
    }

    /// Records the share of this way up to the first surface: makes its bits in f32 of those of 1.
    pub fn record_first_stop(&self, pass: &mut Pass) {
        pass.dispatch(&self.first_stop, self.n_nodes);
    }

    /// Records who is held besides: what is on a surface with the best velocity, and beyond it with that in the fields or, told 1, anyway.
    pub fn record_hold_stopped(&self, pass: &mut Pass) {
        pass.dispatch(&self.hold_stopped, self.n_nodes);
    }
}

impl SolidContacts {
    pub(super) fn new(
        gpu: &Gpu,
        buffers: &SolidSystemBuffers,
        fields: SolidFields,
        obstacles: Option<ObstacleField>,
    ) -> Result<SolidContacts, Error> {
        let gpu_at = &gpu.at(Stage::RightHandSide.name());
        let kernel = |source| Kernel::new(gpu_at, source, buffers.variant);
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
            search: ContactSearch::new(gpu, buffers, fields, &buffers.rhs)?,
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
}
