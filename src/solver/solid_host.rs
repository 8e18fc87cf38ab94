//! The residual of the stored system of the solids in f64 on the host, for adapters without f64 and for verdicts on f32 solves.

use std::sync::{Arc, PoisonError};

use glam::DVec3;

use crate::Error;
use crate::gpu::{BufferPlan, Gpu, Readback, Recorder};

use super::refine::HostSystem;
use super::solid_system::{SolidFields, SolidRows, SolidSystemBuffers};

/// Where the stored system, in f32, arrives, and what of it never changes.
#[derive(Debug)]
pub(super) struct SolidReadbacks {
    topology: Arc<Topology>,
    rotated: Readback<u32>,
    masses: Readback<u32>,
    rhs: Readback<u32>,
    velocity: Readback<u32>,
    guess: Readback<u32>,
}

/// Nodes of the elements, and which components of the nodes are prescribed.
#[derive(Clone, Debug, Default)]
pub(super) struct Topology {
    pub(super) elements: Vec<[u32; 4]>,
    pub(super) prescribed: Vec<[bool; 3]>,
}

impl SolidReadbacks {
    /// What will be allocated for n nodes and m elements.
    pub(super) fn plan(n: usize, m: usize) -> [BufferPlan; 5] {
        [
            BufferPlan::of::<u32>("solid.rotated (read-back)", 12 * m),
            BufferPlan::of::<u32>("solid_solver.masses (read-back)", n),
            BufferPlan::of::<u32>("solid_solver.rhs (read-back)", 4 * n),
            BufferPlan::of::<u32>("solid.velocity (read-back)", 4 * n),
            BufferPlan::of::<u32>("solid_solver.guess (read-back)", 4 * n),
        ]
    }

    pub(super) fn new(gpu: &Gpu, rows: &SolidRows) -> Result<SolidReadbacks, Error> {
        let (n, m) = (rows.rows.n_nodes as usize, rows.rows.n_elements as usize);
        Ok(SolidReadbacks {
            topology: rows.topology.clone(),
            rotated: Readback::new(gpu, "solid.rotated", 12 * m)?,
            masses: Readback::new(gpu, "solid_solver.masses", n)?,
            rhs: Readback::new(gpu, "solid_solver.rhs", 4 * n)?,
            velocity: Readback::new(gpu, "solid.velocity", 4 * n)?,
            guess: Readback::new(gpu, "solid_solver.guess", 4 * n)?,
        })
    }
}

/// The stored system, widened. Vectors hold four numbers per node.
#[derive(Debug)]
pub(super) struct HostElastic {
    topology: Arc<Topology>,
    rotated: Vec<f64>,
    masses: Vec<f64>,
    rhs: Vec<f64>,
    /// Prescribed components; the others are zero.
    prescribed: Vec<f64>,
    /// v* in the free components; the others are zero.
    guess: Vec<f64>,
}

impl HostElastic {
    /// Reads the system back.
    pub(super) fn download(
        gpu: &Gpu,
        buffers: &SolidSystemBuffers,
        fields: SolidFields,
    ) -> Result<HostElastic, Error> {
        let readbacks = buffers.to_host.as_ref();
        let readbacks = readbacks
            .expect("made with the buffers of every system whose residual the device rounds");
        // A panic in another solve leaves nothing half done here: every use begins with new copies.
        let mut readbacks = readbacks.lock().unwrap_or_else(PoisonError::into_inner);
        let SolidReadbacks {
            topology,
            rotated,
            masses,
            rhs,
            velocity,
            guess,
        } = &mut *readbacks;
        let mut recorder = Recorder::new(gpu);
        recorder.read(&fields.rotated.words, rotated);
        recorder.read_part(&buffers.masses.words, 0, masses);
        recorder.read(&buffers.rhs.words, rhs);
        recorder.read(&fields.velocity.words, velocity);
        // The second section of the search directions: see solid_guess.
        recorder.read_part(
            &buffers.search.words,
            4 * buffers.sizes.n_nodes as usize,
            guess,
        );
        recorder.submit();
        Ok(HostElastic {
            topology: topology.clone(),
            rotated: fields.rotated.widen(&rotated.wait(gpu)?),
            masses: buffers.masses.widen(&masses.wait(gpu)?),
            rhs: buffers.rhs.widen(&rhs.wait(gpu)?),
            prescribed: fields.velocity.widen(&velocity.wait(gpu)?),
            guess: buffers.search.widen(&guess.wait(gpu)?),
        })
    }

    /// One of three sections of vectors per element.
    fn vector(&self, section: usize, element: usize) -> (DVec3, f64) {
        let at = 4 * (section * self.topology.elements.len() + element);
        let [x, y, z, w] = [0, 1, 2, 3].map(|part| self.rotated[at + part]);
        (DVec3::new(x, y, z), w)
    }
}

impl HostSystem for HostElastic {
    /// v*, unless zero leaves less of the right-hand side.
    fn start(&self) -> Vec<f64> {
        let pairs = self.prescribed.iter().zip(&self.guess);
        let guess: Vec<f64> = pairs
            .map(|(prescribed, guess)| prescribed + guess)
            .collect();
        let [with, without] = [&guess, &self.prescribed].map(|x| self.residual(x).1);
        if with < without {
            guess
        } else {
            self.prescribed.clone()
        }
    }

    /// Summed element by element, then node by node.
    fn residual(&self, x: &[f64]) -> (Vec<f64>, f64) {
        let node = |node: u32| DVec3::from_slice(&x[4 * node as usize..]);
        let mut product = vec![DVec3::ZERO; self.masses.len()];
        for (element, corners) in self.topology.elements.iter().enumerate() {
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
        let mut rr = 0.0;
        for (node, product) in product.into_iter().enumerate() {
            for axis in 0..3 {
                if !self.topology.prescribed[node][axis] {
                    let at = 4 * node + axis;
                    r[at] = self.rhs[at] - (self.masses[node] * x[at] + product[axis]);
                    rr += r[at] * r[at];
                }
            }
        }
        (r, rr)
    }
}
