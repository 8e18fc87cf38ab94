//! The residual of the stored pressure system in f64 on the host, for adapters without f64 and for verdicts on f32 solves.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::Error;
use crate::gpu::Gpu;
use crate::grid::Padded;

use super::SolverBuffers;
use super::components::OPEN;
use super::refine::HostSystem;

/// Level 0 of the stored system, widened; device layout.
#[derive(Debug)]
pub(super) struct HostPressure {
    level: Padded,
    /// Weights of the minus faces along x, y, z, and the free-surface term.
    matrix: [Vec<f64>; 4],
    active: Vec<bool>,
    rhs: Vec<f64>,
}

impl HostPressure {
    /// Reads the system back; without the mean of the right-hand side over closed components, if there are any.
    pub(super) fn download(
        gpu: &Gpu,
        buffers: &SolverBuffers,
        closed: u32,
    ) -> Result<HostPressure, Error> {
        let level = buffers.plan.levels[0];
        let all = buffers.matrix.download(gpu)?;
        let section = |s: usize| all[4 * buffers.plan.total * s..][..level.len()].to_vec();
        let flags = gpu.download(&buffers.flags)?;
        let active = (0..level.len())
            .map(|ix| flags[ix / 4] >> (ix % 4) & 1 == 1)
            .collect();
        let mut system = HostPressure {
            level,
            matrix: [section(0), section(1), section(2), section(3)],
            active,
            rhs: buffers.rhs.download(gpu)?,
        };
        if closed > 0 {
            // Rounding to f32 gave them means again, of which no solution could get below the tolerance.
            system.remove_closed_means(&gpu.download(&buffers.labels)?);
        }
        Ok(system)
    }

    /// Takes the mean over every closed component out of the right-hand side; `labels` as in [`SolverBuffers::labels`].
    fn remove_closed_means(&mut self, labels: &[u32]) {
        let HostPressure { active, rhs, .. } = self;
        let closed = |cell: &usize| active[*cell] && labels[*cell] & OPEN == 0;
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
}

impl HostSystem for HostPressure {
    fn start(&self) -> Vec<f64> {
        vec![0.0; self.rhs.len()]
    }

    /// Summed slab by slab.
    fn residual(&self, x: &[f64]) -> (Vec<f64>, f64) {
        let strides = [1, 4 * self.level.stride_y, 4 * self.level.stride_z];
        let mut r = vec![0.0; x.len()];
        let slab = strides[2];
        let norms: Vec<f64> = r
            .par_chunks_mut(slab)
            .enumerate()
            .map(|(k, r)| {
                let mut rr = 0.0;
                for (at, r) in r.iter_mut().enumerate() {
                    let c = k * slab + at;
                    if self.active[c] {
                        let mut bx = self.matrix[3][c] * x[c];
                        for (weights, stride) in self.matrix.iter().zip(strides) {
                            bx += weights[c] * (x[c] - x[c - stride])
                                + weights[c + stride] * (x[c] - x[c + stride]);
                        }
                        *r = self.rhs[c] - bx;
                        rr += *r * *r;
                    }
                }
                rr
            })
            .collect();
        (r, norms.iter().sum())
    }

    fn mask(&self, x: &mut [f64]) {
        for (x, &active) in x.iter_mut().zip(&self.active) {
            if !active {
                *x = 0.0;
            }
        }
    }
}
