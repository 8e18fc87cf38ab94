//! The system of the solids in a sub-step.

use serde_json::{Value, json};

use super::{Options, SubStep, System, symmetric, value_of};
use crate::Error;
use crate::elastic::{Body, Solids};
use crate::reference::StepSystem;
use crate::scene::Scene;
use crate::sim::solids_of;

/// P S P v = P rhs on the components that are not prescribed, with the constraint projector P of walls and obstacles; M, K and S on all components.
pub(super) fn system(scene: &Scene, options: &Options) -> Result<(System, SubStep), Error> {
    let solids = solids_of(scene)?;
    let ((system, velocity), sub_step) = value_of(scene, options, |system| match system {
        StepSystem::Solid(system, velocity) => Some((system.clone(), velocity.to_vec())),
        _ => None,
    })?;
    let components = system.components();
    let free = |values: &[f64]| components.iter().map(|&at| values[at]).collect::<Vec<f64>>();
    let others = vec![
        symmetric("M.mtx", &system.mass_to_csr(), "M, kg: row 3 n + 1, 2, 3 is x, y, z of node n"),
        symmetric("K.mtx", &system.stiffness_to_csr(), "K, N/m, rows as those of M"),
        symmetric("S.mtx", &system.to_csr(), "S = (1/dt + tau_M) M + (dt + tau_K) K, kg/s, rows as those of M"),
        ("nodes.csv", table(&solids, &components, 0)),
    ];
    let written = System {
        matrix: system.free_to_csr(),
        rhs: free(&system.rhs),
        solution: free(&system.free_part(&velocity)),
        comments: [
            "P S P + mu (I - P) on the components that are not prescribed, kg/s; nodes.csv says which component a row is",
            "P (M v*/dt - (K x* - b) + load, less S times what is prescribed and held), N",
            "P v, m/s",
        ],
        others,
        part: json!({ "nodes": solids.rest.len(), "elements": solids.elements.len(), "solids": meta(&solids) }),
    };
    Ok((written, sub_step))
}

/// Materials and sizes of the solids, in SI units.
pub(super) fn meta(solids: &Solids) -> Vec<Value> {
    let material = |body: &Body| {
        json!({
            "name": body.name, "density": body.density, "lambda": body.lambda, "mu": body.mu, "tau_m": body.mass_damping,
            "tau_k": body.stiffness_damping, "nodes": body.nodes.len(), "elements": body.elements.len(),
        })
    };
    solids.bodies.iter().map(material).collect()
}

/// CSV with a line per node: its solid, its position at rest, and the rows of its components in spd.mtx, 0 for prescribed ones. `first`: number of rows
/// before those of the nodes.
pub(super) fn table(solids: &Solids, components: &[usize], first: usize) -> String {
    let mut rows = vec![0; 3 * solids.rest.len()];
    for (row, &component) in components.iter().enumerate() {
        rows[component] = first + row + 1;
    }
    let mut table = String::from("node,solid,rest_x,rest_y,rest_z,row_x,row_y,row_z\n");
    for body in &solids.bodies {
        for node in body.nodes.clone() {
            let [x, y, z] = solids.rest[node].to_array();
            let [a, b, c] = [0, 1, 2].map(|axis| rows[3 * node + axis]);
            table += &format!("{node},{},{x:?},{y:?},{z:?},{a},{b},{c}\n", body.name);
        }
    }
    table
}
