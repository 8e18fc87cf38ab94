//! Solids that touch each other: unilateral rows beside the solves on the device (twin: reference/contact_rows.rs).
//!
//! The host has the rows, the factor of S and the small dense problem of [`UnilateralRows`], in f64; the device solves for the velocities with
//! the contact forces in the right-hand side. Alone, solids take two solves: without rows, and with the forces that these call for. In liquid the
//! Schur-complement form has the rows as equations ([`HeldSolve`]): the host downdates the wet compliance and computes the forces of the rows
//! with each correction of the velocities. The two-field form, for more nodes or on request, is solved again until the forces meet the rows
//! ([`ForceSearch`](crate::linalg::ForceSearch)).

use std::sync::Mutex;

use glam::DVec3;
use rayon::prelude::*;

use super::plus;
use super::schur::Inverse;
use super::stored_stiffness::{Factor, StoredStiffness};
use crate::Error;
use crate::fields::{SolidBuffers, SolidSystemBuffers};
use crate::gpu::{Gpu, Readback, RealBuffer, Recorder, StageTimes, lock};
use crate::linalg::{HeldRows, Row, UnilateralRows};
use crate::scene::{Precision, Solver};
use crate::state::ContactReport;

/// Makes the rows for velocities (m/s, three numbers per node) and rows so far; `None` where the velocities meet all rows.
pub type RowsOf<'a> = &'a mut dyn FnMut(&[f64], &[Row]) -> Result<Option<Vec<Row>>, Error>;

/// Refuses contact of solids in a solve without f64.
///
/// # Errors
/// [`Error::Input`] for the precision.
pub fn check_contact(solver: &Solver) -> Result<(), Error> {
    if !solver.solid_contact || solver.precision != Precision::F32 {
        return Ok(());
    }
    Err(Error::input(
        "solver.solid_contact",
        "contact of solids with each other does not work with precision = \"f32\" on the GPU",
        "use \"mixed\", --backend cpu, or solid_contact = false",
    ))
}

/// Index of a component of a node in vectors with four numbers per node.
fn with_four(component: usize) -> usize {
    4 * (component / 3) + component % 3
}

/// X and W of rows, in vectors with four numbers per node.
pub(super) fn unilateral(rows: Vec<Row>, n_nodes: usize, factor: &Factor) -> UnilateralRows {
    let rows = rows.into_iter().map(|mut row| {
        row.components().for_each(|at| *at = with_four(*at));
        row
    });
    UnilateralRows::new(rows.collect(), 4 * n_nodes, |force| factor.solve(&force))
}

/// Vectors of the nodes on their way to the host.
#[derive(Debug)]
pub(super) struct NodeReadbacks {
    velocity: Readback<u32>,
    rhs: Readback<u32>,
}

impl NodeReadbacks {
    pub(super) fn new(gpu: &Gpu, solids: &SolidSystemBuffers, fields: &SolidBuffers) -> Result<NodeReadbacks, Error> {
        let readback = |label, buffer: &RealBuffer| Readback::new(gpu, label, buffer.words.len());
        let velocity = readback("contact.velocity", &fields.velocity)?;
        Ok(NodeReadbacks { velocity, rhs: readback("contact.rhs", &solids.rhs)? })
    }

    /// Velocities, m/s, and right-hand side, four numbers per node, after the recording.
    pub(super) fn read(
        &mut self,
        gpu: &Gpu,
        mut recorder: Recorder,
        solids: &SolidSystemBuffers,
        fields: &SolidBuffers,
    ) -> Result<([Vec<f64>; 2], StageTimes), Error> {
        recorder.read(&fields.velocity.words, &mut self.velocity);
        recorder.read(&solids.rhs.words, &mut self.rhs);
        let timing = recorder.submit();
        let velocity = fields.velocity.widen(&self.velocity.wait(gpu)?);
        let rhs = solids.rhs.widen(&self.rhs.wait(gpu)?);
        Ok(([velocity, rhs], timing.wait()?))
    }

    /// The velocities alone.
    pub(super) fn read_velocity(&mut self, gpu: &Gpu, fields: &SolidBuffers) -> Result<Vec<f64>, Error> {
        Ok(fields.velocity.widen(&self.velocity.fetch(gpu, &fields.velocity.words)?))
    }
}

/// Three of each four numbers.
pub(super) fn three(four: &[f64]) -> Vec<f64> {
    let (nodes, _) = four.as_chunks::<4>();
    nodes.iter().flat_map(|&[x, y, z, _]| [x, y, z]).collect()
}

/// S of solids that no liquid touches, on the host.
#[derive(Debug)]
pub(super) struct DrySystem {
    stiffness: StoredStiffness,
    nodes: Mutex<NodeReadbacks>,
}

/// Rows so far, the first solve without them (velocities, m/s, and right-hand side, N, four numbers per node), and the factor of S.
#[derive(Debug)]
pub(super) struct DryProgress<'a> {
    rows: Vec<Row>,
    velocity: Vec<f64>,
    rhs: Vec<f64>,
    factor: Factor<'a>,
}

impl DrySystem {
    pub(super) fn new(gpu: &Gpu, solids: &SolidSystemBuffers, fields: &SolidBuffers) -> Result<DrySystem, Error> {
        Ok(DrySystem {
            stiffness: StoredStiffness::new(gpu, solids, fields)?,
            nodes: Mutex::new(NodeReadbacks::new(gpu, solids, fields)?),
        })
    }

    /// After a solve: writes the forces of the rows to the right-hand side, and fills the report. Returns true if another solve follows: rows are
    /// violated, this was not the `last` solve, and S has a factor.
    pub(super) fn push<'a>(
        &'a self,
        gpu: &Gpu,
        (solids, fields): (&SolidSystemBuffers, &SolidBuffers),
        rows_of: RowsOf,
        (progress, last): (&mut Option<DryProgress<'a>>, bool),
        report: &mut ContactReport,
    ) -> Result<bool, Error> {
        let ([velocity, rhs], _) = lock(&self.nodes).read(gpu, Recorder::new(gpu), solids, fields)?;
        let known = progress.as_ref().map_or(&[][..], |before| &before.rows);
        let rows = rows_of(&three(&velocity), known)?;
        let Some(rows) = rows.filter(|_| !last) else {
            return Ok(false);
        };
        let DryProgress { velocity, rhs, factor, .. } = match progress {
            Some(progress) => {
                progress.rows.clone_from(&rows);
                progress
            }
            None => {
                let Some(factor) = self.stiffness.read_and_factorise(gpu, solids, fields)? else {
                    report.unsettled = rows.len() as u32;
                    return Ok(false);
                };
                report.solves = 0;
                progress.insert(DryProgress { rows: rows.clone(), velocity, rhs, factor })
            }
        };
        let rows = unilateral(rows, factor.projectors.len(), factor);
        let found = rows.solve(velocity);
        report.solves += found.pivots;
        report.unsettled = found.wrong;
        solids.rhs.upload(gpu, &plus(rhs, 1.0, &rows.forces(&found.z)));
        Ok(true)
    }
}

/// Rows held as equations in a solve of the Schur-complement form, and their forces so far.
#[derive(Debug)]
pub(crate) struct HeldSolve<'a> {
    rows: HeldRows<'a>,
    /// Right-hand side without the forces of the rows, N, four numbers per node.
    rhs: Vec<f64>,
    /// On the device.
    on_device: &'a RealBuffer,
    /// After the last correction, and before it.
    progress: Mutex<[Progress; 2]>,
}

#[derive(Clone, Debug)]
struct Progress {
    /// lambda of the velocities that the rows lack: until the first correction.
    lacking: Vec<f64>,
    lambda: Vec<f64>,
}

impl<'a> HeldSolve<'a> {
    /// Before a solve that starts from the velocities `start`, prescribed ones alone; writes the right-hand side.
    pub(super) fn new(
        gpu: &Gpu,
        rows: HeldRows<'a>,
        start: &[f64],
        rhs: &[f64],
        on_device: &'a RealBuffer,
    ) -> HeldSolve<'a> {
        let lacking = rows.meeting(start);
        let progress = Progress { lambda: vec![0.0; lacking.len()], lacking };
        on_device.upload(gpu, rhs);
        HeldSolve { rows, rhs: rhs.to_vec(), on_device, progress: Mutex::new([progress.clone(), progress]) }
    }

    /// Adds to S^-1 f what the rows make of it, and returns their lambda. `unit`: what forces and velocities are multiples of.
    pub(super) fn constrain(&self, forces: &[f64], unit: f64, velocity: &mut [f64]) -> Vec<f64> {
        let lambda = self.rows.cancelling(forces);
        let lambda = plus(&lambda, unit, &lock(&self.progress)[0].lacking);
        self.rows.add_velocity(&lambda, velocity);
        lambda
    }

    /// Adds the forces of a correction and returns the right-hand side.
    pub(super) fn advance(&self, gpu: &Gpu, lambda: &[f64], unit: f64) -> Vec<f64> {
        let mut progress = lock(&self.progress);
        progress[1] = progress[0].clone();
        let now = &mut progress[0];
        now.lacking.fill(0.0);
        let sums = now.lambda.iter_mut().zip(lambda);
        sums.for_each(|(sum, lambda)| *sum += lambda / unit);
        self.write(gpu, &now.lambda)
    }

    /// Takes the forces of a rejected correction back and returns the right-hand side.
    pub(super) fn revert(&self, gpu: &Gpu) -> Vec<f64> {
        let mut progress = lock(&self.progress);
        progress[0] = progress[1].clone();
        self.write(gpu, &progress[0].lambda)
    }

    fn write(&self, gpu: &Gpu, lambda: &[f64]) -> Vec<f64> {
        let rhs = plus(&self.rhs, 1.0, &self.rows.forces(lambda));
        self.on_device.upload(gpu, &rhs);
        rhs
    }

    /// lambda, N.
    pub(super) fn lambda(&self) -> Vec<f64> {
        lock(&self.progress)[0].lambda.clone()
    }

    /// The wet compliance with the rows as equations.
    pub(super) fn compliance(&self, inverse: &Inverse) -> Vec<f32> {
        let nodes = inverse.nodes.iter();
        let components: Vec<usize> = nodes.flat_map(|&node| [0, 1, 2].map(|axis| 4 * node as usize + axis)).collect();
        let [left, right] = self.rows.correction(&components, inverse.mass);
        let (n, rank) = (components.len(), left.len() / components.len().max(1));
        let mut w = inverse.wet.clone();
        w.par_chunks_exact_mut(n.max(1)).enumerate().for_each(|(i, column)| {
            let own = &left[rank * i..rank * (i + 1)];
            for (j, entry) in column.iter_mut().enumerate() {
                let other = &right[rank * j..rank * (j + 1)];
                let sum: f64 = own.iter().zip(other).map(|(a, b)| a * b).sum();
                *entry = (f64::from(*entry) - sum) as f32;
            }
        });
        w
    }
}

/// Velocities of prescribed components alone, four numbers per node.
pub(super) fn prescribed(factor: &Factor, velocity: &[f64]) -> Vec<f64> {
    let nodes = factor.projectors.iter().zip(velocity.chunks_exact(4));
    nodes
        .flat_map(|(free, v)| {
            let v = DVec3::from_slice(v);
            (v - *free * v).extend(0.0).to_array()
        })
        .collect()
}
