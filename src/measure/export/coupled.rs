//! The system of liquid and solids of a sub-step, in all formulations.

use serde_json::json;

use super::{Options, SubStep, System, pressure, solids, symmetric, value_of, vector};
use crate::Error;
use crate::elastic::Solids;
use crate::linalg::{Csr, Symmetry, matrix_text};
use crate::reference::{SIGMA, StepSystem, StressVariables};
use crate::scene::{CouplingScheme, Scene};
use crate::sim::{Backend, solids_of};

/// A \[p; P v\] = rhs of thesis (5.25), with the constraint projector P of walls and obstacles, and the same problem in its other forms.
pub(super) fn system(scene: &Scene, options: &Options) -> Result<(System, SubStep), Error> {
    ensure_system(scene, options)?;
    let (density, all) = (pressure::density(scene)?, solids_of(scene)?);
    let ((system, mut x, velocity), sub_step) = value_of(scene, options, |system| match system {
        StepSystem::Coupled(system, pressure, velocity) => Some((system.clone(), pressure.to_vec(), velocity.to_vec())),
        _ => None,
    })?;
    // Constrained components are on the right-hand side.
    x.extend(system.solid.free_part(&velocity));
    let blocks = system.blocks();
    let n_cells = blocks.cells.len();
    // In components without a pressure level, the matrices set the cell with twice its diagonal to 0.
    for component in system.level_free() {
        let level = x[component[0]];
        component.iter().for_each(|&cell| x[cell] -= level);
    }
    let solution = blocks.gather(&x);
    let minus_w: Vec<f64> = blocks.components.iter().map(|&at| system.solid.rhs[at]).collect();
    let e: Vec<f64> = blocks.cells.iter().map(|&cell| system.pressure.rhs[cell]).collect();
    let w: Vec<f64> = minus_w.iter().map(|w| -w).collect();
    let both = |v: &[f64]| e.iter().chain(v).copied().collect::<Vec<f64>>();
    let (stress, matrix) = stress_variables(scene, &all, &sub_step).system(&blocks)?;
    let j = "J P, m^2: rows as those of B, columns as the velocities of nodes.csv";
    let z1 = Csr::diagonal_of(&blocks.z1(SIGMA));
    let mut others = vec![
        symmetric("indefinite.mtx", &blocks.indefinite(), "[B J; J^T -S], rows as those of spd.mtx"),
        vector("indefinite_rhs.mtx", &both(&w), "[E u*; w], m^3/s and N"),
        symmetric("stress.mtx", &matrix, "pressures as in spd.mtx, then six stresses per element, in roots of W"),
        vector("stress_rhs.mtx", &stress.rhs(&both(&minus_w)), "its right-hand side"),
        symmetric("B.mtx", &blocks.b, "B, m^3/s per Pa; cells.csv says which cell a row is"),
        ("J.mtx", matrix_text(&blocks.j, Symmetry::General, j)),
        symmetric("M.mtx", &system.solid.mass_to_csr(), "M, kg: row 3 n + 1, 2, 3 is x, y, z of node n"),
        symmetric("K.mtx", &system.solid.stiffness_to_csr(), "K, N/m, rows as those of M"),
        symmetric("Z1.mtx", &z1, "Z1 = sigma (1/dt + tau_M) M on the free components, kg/s; nodes.csv"),
        symmetric("Z2.mtx", &blocks.z2(SIGMA), "Z2 = P S P + mu (I - P) - Z1, kg/s"),
    ];
    others.extend(pressure::tables(&scene.grid(), &blocks.cells, &system.pressure.separated));
    others.push(("nodes.csv", solids::table(&all, &blocks.components, n_cells)));
    let written = System {
        matrix: blocks.two_field(SIGMA)?,
        rhs: blocks.two_field_rhs(SIGMA, &e, &w),
        solution,
        comments: [
            "A of the thesis's (5.25): pressures (cells.csv), then velocities (nodes.csv)",
            "[E u* + J Z1^-1 w; -Z2 Z1^-1 w]",
            "[p; P v], Pa and m/s",
        ],
        others,
        part: json!({
            "density": density, "sigma": SIGMA, "alpha": 1.0, "closed_components": system.level_free().count(), "active_cells": n_cells,
            "nodes": all.rest.len(), "elements": all.elements.len(), "solids": solids::meta(&all),
        }),
    };
    Ok((written, sub_step))
}

/// Refuses coupling schemes without a coupled system, or whose blocks the device does not store.
fn ensure_system(scene: &Scene, options: &Options) -> Result<(), Error> {
    let (problem, cure) = match (scene.solver.coupling, &options.backend) {
        (CouplingScheme::Weak, _) => (
            "solver.coupling = \"weak\" solves for the pressure, then for the solids, and has no system of both",
            "add --set solver.coupling=strong",
        ),
        (CouplingScheme::DampingOnly, Backend::Gpu(_)) => (
            "the system of solver.coupling = \"damping_only\" is exported from the f64 path only",
            "use --backend cpu, or --set solver.coupling=strong",
        ),
        _ => return Ok(()),
    };
    Err(Error::input(scene.file.display().to_string(), problem, cure))
}

/// Stress variables of the sub-step, on the GPU path with the rotations of the device.
fn stress_variables(scene: &Scene, all: &Solids, sub_step: &SubStep) -> StressVariables {
    let SubStep { dt, displacement, solids, .. } = sub_step;
    let Some(stored) = solids else {
        return StressVariables::new(all, &all.deformations(displacement), |body| match scene.solver.coupling {
            CouplingScheme::DampingOnly => body.stiffness_damping,
            CouplingScheme::Strong | CouplingScheme::Weak => body.zeta_stiffness(*dt),
        });
    };
    let all = &stored.on_device(all);
    let mut deformations = all.deformations(&stored.displacement);
    for (element, deformation) in deformations.iter_mut().enumerate() {
        *deformation = stored.turned(all, element, deformation.gradient);
    }
    // The device stores it in f32.
    StressVariables::new(all, &deformations, |body| body.zeta_stiffness(f64::from(*dt as f32)))
}
