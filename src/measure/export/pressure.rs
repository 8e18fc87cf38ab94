//! The pressure system of a sub-step.

use serde_json::json;

use super::{File, Options, SubStep, System, value_of};
use crate::Error;
use crate::grid::Grid;
use crate::reference::StepSystem;
use crate::scene::Scene;

/// B p = E u*.
pub(super) fn system(scene: &Scene, options: &Options) -> Result<(System, SubStep), Error> {
    let density = density(scene)?;
    let ((system, pressure), sub_step) = value_of(scene, options, |system| match system {
        StepSystem::Pressure(system, pressure) => Some((system.clone(), pressure.to_vec())),
        _ => None,
    })?;
    let cells = system.stencil.active_cells();
    let active = |field: &[f64]| cells.iter().map(|&cell| field[cell]).collect::<Vec<f64>>();
    let written = System {
        matrix: system.to_csr(),
        rhs: active(&system.rhs),
        solution: active(&pressure),
        comments: ["B, m^3/s per Pa; cells.csv says which cell a row is", "E u*, m^3/s", "p, Pa"],
        others: tables(&scene.grid(), &cells, &system.separated),
        part: json!({ "density": density, "closed_components": system.closed.len() }),
    };
    Ok((written, sub_step))
}

/// cells.csv and, where cells separated, separated.csv with these.
pub(super) fn tables(grid: &Grid, cells: &[usize], separated: &[usize]) -> Vec<File> {
    let mut tables = vec![("cells.csv", table(grid, cells))];
    if !separated.is_empty() {
        tables.push(("separated.csv", table(grid, separated)));
    }
    tables
}

/// CSV with a line per row: its cell and the centre of it.
fn table(grid: &Grid, cells: &[usize]) -> String {
    let mut table = String::from("row,i,j,k,x,y,z\n");
    for (row, &cell) in cells.iter().enumerate() {
        let [i, j, k] = grid.cell_at(cell);
        let x = grid.cell_centre([i, j, k]);
        table += &format!("{},{i},{j},{k},{:?},{:?},{:?}\n", row + 1, x.x, x.y, x.z);
    }
    table
}

/// Density of the liquid, kg/m^3.
pub(super) fn density(scene: &Scene) -> Result<f64, Error> {
    scene.liquid.as_ref().map(|liquid| liquid.density).ok_or_else(|| {
        Error::input(
            scene.file.display().to_string(),
            "the scene has neither liquid nor solids, so there is no system",
            "add a [liquid] section with a region, or a [[solid]]",
        )
    })
}
