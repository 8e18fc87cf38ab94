//! Walls and obstacles in the system of the solids: which nodes they hold, before the first solve of a sub-step and after each.
//!
//! The rules, and the active set that they make, stand with the twin, `reference/solid_contacts.rs`.

use crate::Error;
use crate::fields::{SolidBuffers, SolidSystemBuffers};
use crate::gpu::{Bound, Buffer, Gpu, Pass, RealBuffer, bind};
use crate::grid::Layout;
use crate::wgsl;

/// The distance to the obstacles.
#[derive(Clone, Copy, Debug)]
pub struct ObstacleField<'a> {
    /// Layout.
    pub level: &'a Buffer<Layout>,
    /// Cell centres, m.
    pub solid_distance: &'a Buffer<f32>,
}

/// The active-set search from one solve to the next; the method is documented in the twin.
#[derive(Debug)]
pub struct ContactSearch {
    /// Products of the elements with the velocity, for the judgement.
    judge: [Bound; 2],
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
        fields: &SolidBuffers,
        pushes: &RealBuffer,
    ) -> Result<ContactSearch, Error> {
        let own = [("rhs", pushes.into()), ("next", (&buffers.z).into()), ("sums", (&buffers.search).into())];
        let bound = |source| bind(gpu, &source, buffers.variant, own, &[buffers, fields]);
        Ok(ContactSearch {
            judge: [buffers.bind_products(gpu, fields, &fields.velocity)?, bound(wgsl!("judge_contacts"))?],
            rest: bound(wgsl!("rest_nodes"))?,
            approach: [
                bound(wgsl!("approach_nodes"))?,
                buffers.bind_products(gpu, fields, &buffers.search)?,
                bound(wgsl!("measure_gain"))?,
            ],
            judge_gain: bound(wgsl!("judge_gain"))?,
            first_stop: bound(wgsl!("first_stop"))?,
            hold_stopped: bound(wgsl!("hold_stopped"))?,
            n_nodes: buffers.sizes.n_nodes as usize,
        })
    }

    /// Records what is wrong with the velocities in the fields: answers with the nodes beyond and the nodes pulled, and told 1 lets these go.
    pub fn record_judge(&self, pass: &mut Pass) {
        for bound in &self.judge {
            pass.dispatch(bound, self.n_nodes);
        }
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

/// Binds the contacts of the nodes: with walls, then with obstacles, then with moving ones; none where the host has the rows.
pub(super) fn bind_touch(
    gpu: &Gpu,
    buffers: &SolidSystemBuffers,
    fields: &SolidBuffers,
    obstacles: Option<ObstacleField>,
) -> Result<Vec<Bound>, Error> {
    let variant = buffers.variant;
    let bound = |source| bind(gpu, &source, variant, [], &[buffers, fields]);
    let mut touch = Vec::new();
    if !buffers.rows_on_host {
        touch.push(bound(wgsl!("solid_contacts"))?);
        if let Some(ObstacleField { level, solid_distance }) = obstacles {
            let own = [("level", level.into()), ("distances", solid_distance.into())];
            touch.push(bind(gpu, &wgsl!("obstacle_contacts"), variant, own, &[buffers, fields])?);
        }
        if fields.plan.n_moving > 0 {
            touch.push(bound(wgsl!("moving_contacts"))?);
        }
    }
    Ok(touch)
}
