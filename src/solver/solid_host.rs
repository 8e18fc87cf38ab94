//! The residual of the stored system of the solids in f64 on the host, for adapters without f64 and for verdicts on f32 solves.

use std::sync::Arc;

use glam::{DMat3, DVec3};

use crate::Error;
use crate::fields::solid_system::SolidReadbacks;
use crate::fields::{SolidBuffers, SolidSystemBuffers};
use crate::gpu::{Gpu, Recorder, lock};

use super::plus;
use super::refine::{HostResidual, HostSystem};

/// Constraint projector of a node, widened: see `shaders/common/freedom.wgsl`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Free {
    components: DVec3,
    constrained: DVec3,
}

impl Free {
    pub(super) fn new(&[x, y, z, flags]: &[f32; 4]) -> Free {
        let constrained = DVec3::new(x.into(), y.into(), z.into());
        let bit = |axis: u32| f64::from(flags as u32 >> axis & 1);
        Free { components: DVec3::new(bit(0), bit(1), bit(2)), constrained: constrained.normalize_or_zero() }
    }

    pub(super) fn part(&self, y: DVec3) -> DVec3 {
        let kept = self.components * y;
        kept - self.constrained.dot(kept) * self.constrained
    }

    /// P, of which `part` is the product.
    pub(super) fn projector(&self) -> DMat3 {
        DMat3::from_cols(self.part(DVec3::X), self.part(DVec3::Y), self.part(DVec3::Z))
    }
}

/// The stored system, widened. Vectors hold four numbers per node.
#[derive(Debug)]
pub(super) struct HostElastic {
    elements: Arc<Vec<[u32; 4]>>,
    pub(super) freedom: Vec<Free>,
    rotated: Vec<f64>,
    /// zeta_M m of the nodes, then the means of the diagonal of S, kg/s.
    masses: Vec<f64>,
    /// N, and the squared norm of the terms that it sums.
    pub(super) rhs: Vec<f64>,
    /// Constrained parts of the velocities.
    pub(super) constrained: Vec<f64>,
    /// Free part of v*.
    guess: Vec<f64>,
}

impl HostElastic {
    /// Reads the system back.
    pub(super) fn download(
        gpu: &Gpu,
        buffers: &SolidSystemBuffers,
        fields: &SolidBuffers,
    ) -> Result<HostElastic, Error> {
        let readbacks = buffers.to_host.as_ref();
        let readbacks = readbacks.expect("made with the buffers of every system whose residual the device rounds");
        let mut readbacks = lock(readbacks);
        let SolidReadbacks { elements, freedom, rotated, masses, rhs, velocity, guess } = &mut *readbacks;
        let mut recorder = Recorder::new(gpu);
        recorder.read(&fields.freedom, freedom);
        recorder.read(&fields.rotated.words, rotated);
        recorder.read(&buffers.masses.words, masses);
        recorder.read(&buffers.rhs.words, rhs);
        recorder.read(&fields.velocity.words, velocity);
        // The second section of the search directions: see solid_guess.
        recorder.read_part(&buffers.search.words, 4 * buffers.sizes.n_nodes as usize, guess);
        recorder.submit();
        Ok(HostElastic {
            elements: elements.clone(),
            freedom: freedom.wait(gpu)?.iter().map(Free::new).collect(),
            rotated: fields.rotated.widen(&rotated.wait(gpu)?),
            masses: buffers.masses.widen(&masses.wait(gpu)?),
            rhs: buffers.rhs.widen(&rhs.wait(gpu)?),
            constrained: fields.velocity.widen(&velocity.wait(gpu)?),
            guess: buffers.search.widen(&guess.wait(gpu)?),
        })
    }

    /// Number of free directions of the nodes.
    pub(super) fn n_free(&self) -> u32 {
        let traces = self.freedom.iter().map(|free| {
            let p = free.projector();
            p.x_axis.x + p.y_axis.y + p.z_axis.z
        });
        traces.map(|trace| trace.round() as u32).sum()
    }

    /// Squared norm of the terms that the right-hand side sums.
    pub(super) fn terms(&self) -> f64 {
        self.rhs.chunks_exact(4).map(|node| node[3]).sum()
    }

    /// One of three sections of vectors per element.
    fn vector(&self, section: usize, element: usize) -> (DVec3, f64) {
        let at = 4 * (section * self.elements.len() + element);
        let [x, y, z, w] = [0, 1, 2, 3].map(|part| self.rotated[at + part]);
        (DVec3::new(x, y, z), w)
    }

    /// P (rhs + added - S x), N; summed element by element, then node by node.
    pub(super) fn residual_with(&self, added: Option<&[f64]>, x: &[f64]) -> HostResidual {
        let node = |node: u32| DVec3::from_slice(&x[4 * node as usize..]);
        let mut product = vec![DVec3::ZERO; self.freedom.len()];
        for (element, corners) in self.elements.iter().enumerate() {
            let (g1, lambda) = self.vector(0, element);
            let (g2, mu) = self.vector(1, element);
            let gradients = [g1, g2, self.vector(2, element).0];
            let origin = node(corners[0]);
            let differences = [1, 2, 3].map(|corner: usize| node(corners[corner]) - origin);
            let pairs = || differences.iter().zip(gradients);
            let trace: f64 = pairs().map(|(x, g)| x.dot(g)).sum();
            for (corner, at) in gradients.into_iter().enumerate() {
                // (H + H^T) g.
                let strain: DVec3 = pairs().map(|(&x, g)| x * g.dot(at) + g * x.dot(at)).sum();
                let force = lambda * trace * at + mu * strain;
                product[corners[corner + 1] as usize] += force;
                product[corners[0] as usize] -= force;
            }
        }
        let mut r = vec![0.0; x.len()];
        let (mut rr, mut coupling, mut dd) = (0.0, 0.0, 0.0);
        let (masses, diagonals) = self.masses.split_at(self.freedom.len());
        for (node, product) in product.into_iter().enumerate() {
            let at = |all: &[f64]| DVec3::from_slice(&all[4 * node..]);
            let x = at(x);
            let added = added.map_or(DVec3::ZERO, at);
            let rhs = at(&self.rhs) + added;
            let here = &self.freedom[node];
            let free = here.part(rhs - (masses[node] * x + product));
            r[4 * node..4 * node + 3].copy_from_slice(&free.to_array());
            rr += free.length_squared();
            coupling += here.part(added).length_squared();
            dd += here.part(diagonals[node] * x).length_squared();
        }
        HostResidual { r, rr, coupling, dd }
    }
}

impl HostSystem for HostElastic {
    /// v*, unless zero leaves less of the right-hand side.
    fn start(&self) -> Vec<Vec<f64>> {
        let guess = plus(&self.constrained, 1.0, &self.guess);
        let [with, without] = [&guess, &self.constrained].map(|x| self.residual_with(None, x).rr);
        vec![if with < without { guess } else { self.constrained.clone() }]
    }

    fn residuals(&self, x: &[Vec<f64>]) -> Vec<HostResidual> {
        vec![self.residual_with(None, &x[0])]
    }
}
