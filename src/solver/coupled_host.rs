//! The coupled system in f64 on the host; units and signs as in [`coupled`](super::coupled).

use glam::DVec3;

use crate::Error;
use crate::fields::Pair;
use crate::gpu::{Gpu, Readback};

use super::Control;
use super::acceptance::{RHS, TERMS, evaluation_slot, norm_slot};
use super::coupled::CoupledFields;
use super::host_residual::HostPressure;
use super::refine::{HostResidual, HostSystem};
use super::solid_host::HostElastic;

/// Both systems as the device stores them, and J. Blocks: potentials, velocities, m/s.
#[derive(Debug)]
pub(super) struct HostCoupled<'a> {
    pressure: HostPressure,
    solids: HostElastic,
    at: CoupledFields<'a>,
    pairs: &'a [Pair],
    /// rho dx^3 / dt, kg/s.
    mass: f64,
}

impl HostCoupled<'_> {
    /// Reads both systems back.
    pub(super) fn download<'a>(
        gpu: &Gpu,
        at: CoupledFields<'a>,
        base: &mut Readback<u32>,
    ) -> Result<HostCoupled<'a>, Error> {
        let coupling = at.coupling;
        let base = coupling.base.widen(&base.fetch(gpu, &coupling.base.words)?);
        let pairs = coupling.written.pairs.as_slice();
        // Evaluations on the device subtract J v where solids are wet.
        let restore = |rhs: &mut [f64]| {
            let wet = pairs.chunk_by(|a, b| a.cell / 4 == b.cell / 4);
            for (wet, base) in wet.zip(base.chunks_exact(4)) {
                let first = wet[0].cell / 4 * 4;
                rhs[first..first + 4].copy_from_slice(base);
            }
        };
        Ok(HostCoupled {
            pressure: HostPressure::download(gpu, at.liquid, u32::MAX, restore)?,
            solids: HostElastic::download(gpu, at.solids, at.fields)?,
            at,
            pairs,
            mass: f64::from(coupling.written.sizes.mass),
        })
    }

    /// J^T p in N, four numbers per node.
    fn force(&self, p: &[f64]) -> Vec<f64> {
        let mut force = vec![0.0; 4 * self.solids.freedom.len()];
        for pair in self.pairs.iter().filter(|pair| self.pressure.active[pair.cell]) {
            let of_node = &mut force[4 * pair.node..];
            for (force, value) in of_node.iter_mut().zip(pair.value) {
                *force += self.mass * p[pair.cell] * f64::from(value);
            }
        }
        force
    }

    /// E u* - J v.
    fn rhs(&self, v: &[f64]) -> Vec<f64> {
        let mut rhs = self.pressure.rhs.clone();
        for pair in self.pairs {
            // Enclosed components have it already: see couple_close.
            if self.pressure.active[pair.cell] && !self.pressure.closed[pair.cell] {
                let value = DVec3::from(pair.value.map(f64::from));
                rhs[pair.cell] -= value.dot(DVec3::from_slice(&v[4 * pair.node..]));
            }
        }
        rhs
    }
}

impl HostSystem for HostCoupled<'_> {
    /// Zero but for constrained velocities.
    fn start(&self) -> Vec<Vec<f64>> {
        let n = self.pressure.rhs.len();
        vec![vec![0.0; n], self.solids.constrained.clone()]
    }

    fn residuals(&self, x: &[Vec<f64>]) -> Vec<HostResidual> {
        let [p, v] = [&x[0], &x[1]];
        let force = self.force(p);
        let mut solids = self.solids.residual_with(Some(&force), v);
        solids.r.iter_mut().for_each(|r| *r /= self.mass);
        let squared = self.mass * self.mass;
        for norm in [&mut solids.rr, &mut solids.coupling, &mut solids.dd] {
            *norm /= squared;
        }
        vec![self.pressure.residual_of(&self.rhs(v), p), solids]
    }

    fn complete(&self, start: &[HostResidual], norms: &mut [f64], control: &mut Control) {
        for (block, residual) in start.iter().enumerate() {
            norms[norm_slot(block, RHS)] = residual.rr;
        }
        norms[norm_slot(1, TERMS)] = self.solids.terms() / (self.mass * self.mass);
        norms[evaluation_slot(1, 2) + 2] = self.solids.n_free().into();
        control.unknowns += self.solids.n_free();
    }

    fn coupling(&self, p: &[f64]) -> Vec<f64> {
        let force = self.force(p);
        force.iter().map(|f| f / self.mass).collect()
    }

    fn set_forces(&mut self, forces: Vec<f64>) {
        self.solids.rhs = forces;
    }

    fn finish(&self, gpu: &Gpu, x: &mut [Vec<f64>]) {
        self.pressure.finish(gpu, x);
        // As evaluations on the device leave it.
        self.at.liquid.rhs.upload(gpu, &self.rhs(&x[1]));
    }
}
