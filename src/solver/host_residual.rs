//! The residual of the stored pressure system in f64 on the host, for adapters without f64 and for verdicts on f32 solves.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::Error;
use crate::fields::SolverBuffers;
use crate::fields::pressure_system::PressureReadbacks;
use crate::gpu::{Gpu, Readback, Recorder, lock};
use crate::grid::Padded;

use super::refine::{HostResidual, HostSystem};

/// Level 0 of the stored system, widened; device layout.
#[derive(Debug)]
pub(super) struct HostPressure {
    level: Padded,
    /// Weights of the minus faces along x, y, z, and the free-surface term.
    matrix: [Vec<f64>; 4],
    pub(super) active: Vec<bool>,
    /// Cells of enclosed components.
    pub(super) closed: Vec<bool>,
    pub(super) rhs: Vec<f64>,
}

impl HostPressure {
    /// Reads the system back, with the right-hand side that `amend` makes of the stored one; without its mean over closed components
    /// unless they are known to be none.
    pub(super) fn download(
        gpu: &Gpu,
        buffers: &SolverBuffers,
        closed: u32,
        amend: impl FnOnce(&mut [f64]),
    ) -> Result<HostPressure, Error> {
        let level = buffers.plan.levels[0];
        let readbacks = buffers.to_host.as_ref();
        let readbacks = readbacks.expect("made with the buffers of every system whose residual the device rounds");
        let mut readbacks = lock(readbacks);
        let PressureReadbacks { matrix, flags, rhs, labels } = &mut *readbacks;
        let mut recorder = Recorder::new(gpu);
        for (s, section) in matrix.iter_mut().enumerate() {
            recorder.read_part(&buffers.matrix.words, 4 * buffers.plan.total * s, section);
        }
        recorder.read(&buffers.flags, flags);
        recorder.read(&buffers.rhs.words, rhs);
        if closed > 0 {
            recorder.read(&buffers.labels, labels);
        }
        recorder.submit();
        let [x, y, z, dirichlet] = matrix;
        let section = |section: &mut Readback<u32>| Ok::<_, Error>(buffers.matrix.widen(&section.wait(gpu)?));
        let flags = flags.wait(gpu)?;
        // Bits 0 to 3, then 4 to 7: see `shaders/common/active.wgsl`.
        let lanes = |first: usize| {
            let bits = (0..level.len()).map(|ix| flags[ix / 4] >> (first + ix % 4) & 1 == 1);
            bits.collect()
        };
        let mut system = HostPressure {
            level,
            matrix: [section(x)?, section(y)?, section(z)?, section(dirichlet)?],
            active: lanes(0),
            closed: lanes(4),
            rhs: buffers.rhs.widen(&rhs.wait(gpu)?),
        };
        amend(&mut system.rhs);
        if closed > 0 {
            // Rounding to f32 gave them means again, of which no solution could get below the tolerance.
            system.remove_closed_means(&labels.wait(gpu)?);
        }
        Ok(system)
    }

    /// Subtracts the mean over every enclosed component from the right-hand side; `labels` as in [`SolverBuffers::labels`].
    fn remove_closed_means(&mut self, labels: &[u32]) {
        let HostPressure { closed, rhs, .. } = self;
        let closed = |cell: &usize| closed[*cell];
        let mut sums = BTreeMap::new();
        for cell in (0..rhs.len()).filter(closed) {
            let (sum, cells) = sums.entry(labels[cell]).or_insert((0.0, 0.0));
            *sum += rhs[cell];
            *cells += 1.0;
        }
        for cell in (0..rhs.len()).filter(closed) {
            let (sum, cells) = sums[&labels[cell]];
            rhs[cell] -= sum / cells;
        }
    }

    /// rhs - B x, summed slab by slab; the coupling terms include rhs.
    pub(super) fn residual_of(&self, rhs: &[f64], x: &[f64]) -> HostResidual {
        let strides = [1, 4 * self.level.stride_y, 4 * self.level.stride_z];
        let mut r = vec![0.0; x.len()];
        let slab = strides[2];
        let sums: Vec<[f64; 3]> = r
            .par_chunks_mut(slab)
            .enumerate()
            .map(|(k, r)| {
                let (mut rr, mut coupling, mut dd) = (0.0, 0.0, 0.0);
                for (at, r) in r.iter_mut().enumerate() {
                    let c = k * slab + at;
                    if self.active[c] {
                        let mut diagonal = self.matrix[3][c];
                        let mut bx = diagonal * x[c];
                        for (weights, stride) in self.matrix.iter().zip(strides) {
                            diagonal += weights[c] + weights[c + stride];
                            bx += weights[c] * (x[c] - x[c - stride]) + weights[c + stride] * (x[c] - x[c + stride]);
                        }
                        *r = rhs[c] - bx;
                        rr += *r * *r;
                        coupling += rhs[c] * rhs[c];
                        dd += (diagonal * x[c]).powi(2);
                    }
                }
                [rr, coupling, dd]
            })
            .collect();
        let [rr, coupling, dd] = [0, 1, 2].map(|part: usize| sums.iter().map(|sums| sums[part]).sum());
        HostResidual { r, rr, coupling, dd }
    }
}

impl HostSystem for HostPressure {
    fn start(&self) -> Vec<Vec<f64>> {
        vec![vec![0.0; self.rhs.len()]]
    }

    fn residuals(&self, x: &[Vec<f64>]) -> Vec<HostResidual> {
        vec![HostResidual { coupling: 0.0, ..self.residual_of(&self.rhs, &x[0]) }]
    }

    fn finish(&self, _: &Gpu, x: &mut [Vec<f64>]) {
        for (x, &active) in x[0].iter_mut().zip(&self.active) {
            if !active {
                *x = 0.0;
            }
        }
    }
}
