//! The residual of the stored system in f64 on the host, for adapters without f64 and for verdicts on f32 solves.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::Error;
use crate::gpu::Gpu;
use crate::grid::Padded;

use super::SolverBuffers;
use super::components::OPEN;

/// Level 0 of the stored system, widened; device layout.
#[derive(Debug)]
pub(super) struct HostSystem {
    level: Padded,
    /// Weights of the minus faces along x, y, z, and the free-surface term.
    matrix: [Vec<f64>; 4],
    active: Vec<bool>,
}

impl HostSystem {
    pub(super) fn download(gpu: &Gpu, buffers: &SolverBuffers) -> Result<HostSystem, Error> {
        let level = buffers.plan.levels[0];
        let all = buffers.matrix.download(gpu)?;
        let section = |s: usize| all[4 * buffers.plan.total * s..][..level.len()].to_vec();
        let flags = gpu.download(&buffers.flags)?;
        let active = (0..level.len())
            .map(|ix| flags[ix / 4] >> (ix % 4) & 1 == 1)
            .collect();
        Ok(HostSystem {
            level,
            matrix: [section(0), section(1), section(2), section(3)],
            active,
        })
    }

    /// b - B x, 0 in inactive cells, and its squared norm, summed slab by slab.
    pub(super) fn residual(&self, x: &[f64], b: &[f64]) -> (Vec<f64>, f64) {
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
                        *r = b[c] - bx;
                        rr += *r * *r;
                    }
                }
                rr
            })
            .collect();
        (r, norms.iter().sum())
    }

    /// Takes the mean over every closed component out of a field; `labels` as in [`SolverBuffers::labels`].
    pub(super) fn remove_closed_means(&self, labels: &[u32], field: &mut [f64]) {
        let closed = |cell: &usize| self.active[*cell] && labels[*cell] & OPEN == 0;
        let mut sums = BTreeMap::new();
        for cell in (0..field.len()).filter(closed) {
            let (sum, cells) = sums.entry(labels[cell]).or_insert((0.0, 0.0));
            *sum += field[cell];
            *cells += 1.0;
        }
        for cell in (0..field.len()).filter(closed) {
            let (sum, cells) = sums[&labels[cell]];
            field[cell] -= sum / cells;
        }
    }

    /// Sets inactive cells to 0.
    pub(super) fn mask(&self, x: &mut [f64]) {
        for (x, &active) in x.iter_mut().zip(&self.active) {
            if !active {
                *x = 0.0;
            }
        }
    }
}
