//! The system of liquid and solids of a sub-step, in all formulations.

use std::sync::Arc;

use super::{Options, Part, Ran, System, on_cpu, pressure, solids};
use crate::Error;
use crate::linalg::{Csr, Symmetry, matrix_text, vector_text};
use crate::reference::{BlockPattern, SIGMA, StepSystem, StressVariables, solid_matrices};
use crate::scene::Scene;
use crate::sim::{Backend, solids_of};

/// A \[p; P v\] = rhs of thesis (5.25), P on what walls and obstacles leave, with the same problem in its other forms.
pub(super) fn system(scene: &Scene, options: &Options) -> Result<(System, Ran), Error> {
    if let Backend::Gpu(_) = options.backend {
        return Err(Error::input(
            scene.file.display().to_string(),
            "the system of liquid and solids is exported from the f64 path only",
            "use --backend cpu",
        ));
    }
    let (density, all) = (pressure::density(scene)?, solids_of(scene)?);
    let ((system, mut x), ran, path) = on_cpu(scene, options.step, |of_step| match of_step {
        StepSystem::Coupled(system, pressure, velocity) => {
            // What is held is on the other side.
            let free = system.solid.free_part(velocity);
            let x: Vec<f64> = pressure.iter().chain(&free).copied().collect();
            Some((system.clone(), x))
        }
        StepSystem::Pressure(..) | StepSystem::Solid(..) => None,
    })?;
    let blocks = system.blocks();
    let n_cells = blocks.cells.len();
    // Where nothing fixes the level, the matrices put the cell with twice its diagonal at 0.
    for component in &system.pressure.closed {
        let level = x[component[0]];
        component.iter().for_each(|&cell| x[cell] -= level);
    }
    let solution = blocks.gather(&x);
    let components = blocks.components.iter();
    let minus_w: Vec<f64> = components.map(|&at| system.solid.rhs[at]).collect();
    let e: Vec<f64> = blocks
        .cells
        .iter()
        .map(|&cell| system.pressure.rhs[cell])
        .collect();
    let w: Vec<f64> = minus_w.iter().map(|w| -w).collect();
    let both = |of_v: &[f64]| e.iter().chain(of_v).copied().collect::<Vec<f64>>();
    let pattern = Arc::new(BlockPattern::new(&all));
    let deformations = solid_matrices(&all, &pattern, &path.state().displacement).deformations;
    let variables = StressVariables::new(&all, &deformations, ran.dt);
    let (stress, stress_matrix) = variables.system(&blocks)?;
    let symmetric = |matrix: &Csr, what| matrix_text(matrix, Symmetry::Symmetric, what);
    let z1 = Csr::diagonal_of(&blocks.z1(SIGMA));
    let others = vec![
        (
            "indefinite.mtx",
            symmetric(
                &blocks.indefinite(),
                "[B J; J^T -S], rows as those of spd.mtx",
            ),
        ),
        (
            "indefinite_rhs.mtx",
            vector_text(&both(&w), "[E u*; w], m^3/s and N"),
        ),
        (
            "stress.mtx",
            symmetric(
                &stress_matrix,
                "pressures as in spd.mtx, then six stresses per element, in roots of W",
            ),
        ),
        (
            "stress_rhs.mtx",
            vector_text(&stress.rhs(&both(&minus_w)), "its right-hand side"),
        ),
        (
            "B.mtx",
            symmetric(
                &blocks.b,
                "B, m^3/s per Pa; cells.csv says which cell a row is",
            ),
        ),
        (
            "J.mtx",
            matrix_text(
                &blocks.j,
                Symmetry::General,
                "J P, m^2: rows as those of B, columns as the velocities of nodes.csv",
            ),
        ),
        (
            "M.mtx",
            symmetric(
                &system.solid.mass_to_csr(),
                "M, kg: row 3 n + 1, 2, 3 is x, y, z of node n",
            ),
        ),
        (
            "K.mtx",
            symmetric(
                &system.solid.stiffness_to_csr(),
                "K, N/m, rows as those of M",
            ),
        ),
        (
            "Z1.mtx",
            symmetric(
                &z1,
                "Z1 = sigma (1/dt + tau_M) M on the free components, kg/s; nodes.csv",
            ),
        ),
        (
            "Z2.mtx",
            symmetric(&blocks.z2(SIGMA), "Z2 = P S P + mu (I - P) - Z1, kg/s"),
        ),
        ("cells.csv", pressure::table(&scene.grid(), &blocks.cells)),
        (
            "nodes.csv",
            solids::table(&all, &blocks.components, n_cells),
        ),
    ];
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
        part: Part::Coupled {
            density,
            sigma: SIGMA,
            alpha: 1.0,
            closed_components: system.pressure.closed.len(),
            cells: n_cells,
            nodes: all.rest.len(),
            elements: all.elements.len(),
            solids: all.bodies.iter().map(solids::meta).collect(),
        },
    };
    Ok((written, ran))
}
