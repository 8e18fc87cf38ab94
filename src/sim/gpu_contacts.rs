//! Contact of solids with each other on a device: the host's share, which is the rows and what comes near what.

use std::sync::Mutex;

use crate::Error;
use crate::elastic::Solids;
use crate::fields::SolidBuffers;
use crate::geometry::{ContactField, ObstacleCut};
use crate::gpu::{Gpu, Readback, Recorder, lock};
use crate::grid::Grid;
use crate::reference::{ActiveSurfaces, Contacts, Touching, hold_near_others};

/// Contacts of the solids of a scene.
#[derive(Debug)]
pub(super) struct GpuContacts {
    /// Obstacles at the end of the sub-step.
    pub(super) field: ContactField,
    /// Length of the sub-step, s.
    dt: f64,
    displacement: Mutex<Readback<[f32; 4]>>,
    velocity: Readback<u32>,
}

impl GpuContacts {
    pub(super) fn new(
        gpu: &Gpu,
        grid: &Grid,
        (solids, buffers): (&Solids, &SolidBuffers),
    ) -> Result<GpuContacts, Error> {
        let n = buffers.plan.n_nodes;
        let displacement = Readback::new(gpu, "contact.displacement", 2 * n)?;
        // No surface holds a node: components that are not prescribed are free.
        let free = solids.prescribed.iter().map(|[x, y, z]| {
            let flags = u8::from(!x) | u8::from(!y) << 1 | u8::from(!z) << 2;
            [0.0, 0.0, 0.0, f32::from(flags)]
        });
        gpu.upload(&buffers.freedom, &free.collect::<Vec<_>>());
        Ok(GpuContacts {
            field: ObstacleCut::none(grid).contact_field(grid),
            dt: 0.0,
            displacement: Mutex::new(displacement),
            velocity: Readback::new(gpu, "contact.before", buffers.velocity.words.len())?,
        })
    }

    /// Before a sub-step of dt (s) that ends at a time (s).
    pub(super) fn begin(
        &mut self,
        gpu: &Gpu,
        (solids, buffers): (&Solids, &SolidBuffers),
        grid: &Grid,
        [time, dt]: [f64; 2],
    ) -> Result<(), Error> {
        self.dt = dt;
        self.field.move_to(time, dt);
        let Some(free_bodies) = &buffers.free_bodies else {
            return Ok(());
        };
        let mut recorder = Recorder::new(gpu);
        let mut displacement = lock(&self.displacement);
        recorder.read(&buffers.displacement, &mut displacement);
        recorder.read(&buffers.velocity.words, &mut self.velocity);
        recorder.submit();
        let displacement = buffers.displacement_of(&displacement.wait(gpu)?);
        let velocity = buffers.velocity.widen(&self.velocity.wait(gpu)?);
        let (nodes, _) = velocity.as_chunks::<4>();
        let velocity: Vec<[f64; 3]> = nodes.iter().map(|&[x, y, z, _]| [x, y, z]).collect();
        let mut apart = vec![true; solids.bodies.len()];
        hold_near_others(solids, grid.dx, dt, &displacement, &velocity, &mut apart);
        let ranges = solids.free_bodies().map(|(body, nodes)| match apart[body] {
            true => [nodes.start as u32, nodes.end as u32, 0, 0],
            false => [0; 4],
        });
        gpu.upload(free_bodies, &ranges.collect::<Vec<_>>());
        gpu.upload(&buffers.ballistic, &vec![0; buffers.plan.n_nodes]);
        Ok(())
    }

    /// Displacements of the nodes now, m.
    pub(super) fn displacement(&self, gpu: &Gpu, buffers: &SolidBuffers) -> Result<Vec<[f64; 3]>, Error> {
        Ok(buffers.displacement_of(&lock(&self.displacement).fetch(gpu, &buffers.displacement)?))
    }

    /// What may touch with the displacements (m) of the sub-step; `dx` in m.
    pub(super) fn touching<T>(
        &self,
        solids: &Solids,
        dx: f64,
        displacement: &[[f64; 3]],
        then: impl FnOnce(Touching) -> T,
    ) -> T {
        let active = vec![ActiveSurfaces::default(); displacement.len()];
        let contacts = Contacts::holding(solids, &self.field, displacement, &active, self.dt);
        let moved = solids.moved(displacement);
        then(Touching { solids, contacts: &contacts, positions: &moved.nodes, dt: self.dt, dx })
    }
}
