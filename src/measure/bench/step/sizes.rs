//! Scenes with other grids and meshes, and the largest that fits on an adapter and this machine.

use crate::Error;
use crate::gpu::AdapterReport;
use crate::measure::bench::table::{Row, row};
use crate::scene::{Scene, SolidMesh};
use crate::sim::{HostMemory, Plan, solids_of};

/// The search tries longest sides that are multiples of this many cells, or of the least number that keeps cells cubic.
const STEP: usize = 10;

/// A scene with its scales.
#[derive(Clone, Debug)]
pub struct Case {
    /// The scene, scaled.
    pub scene: Scene,
    /// Refinement of its solids' meshes.
    pub solids_scale: f64,
}

impl Case {
    /// Scene and scales as columns.
    pub(super) fn key(&self) -> Row {
        let scene = &self.scene;
        row! { scene: scene.name.as_str(), scale: scene.scale, solids_scale: self.solids_scale }
    }

    /// The scene with refined meshes of its solids. Bricks along the axes of boxes are multiplied by the scale, rounded, at least 1; edge lengths in
    /// balls, shells and filled surfaces are divided by it. Meshes from files do not change.
    ///
    /// # Errors
    /// [`Error::Input`] if the scale is not a number above 0.
    pub fn new(mut scene: Scene, solids_scale: f64) -> Result<Case, Error> {
        if !(solids_scale.is_finite() && solids_scale > 0.0) {
            let cure = "give numbers above 0, such as 0.5,1";
            return Err(Error::input(format!("--solids-scale {solids_scale}"), "not a scale", cure));
        }
        for solid in &mut scene.solids {
            match &mut solid.mesh {
                SolidMesh::Box { cells, .. } => {
                    *cells = cells.map(|n| (n as f64 * solids_scale).round().max(1.0) as usize);
                }
                SolidMesh::Sphere { cell_size, .. }
                | SolidMesh::Shell { cell_size, .. }
                | SolidMesh::Surface { cell_size, .. } => *cell_size /= solids_scale,
                SolidMesh::File { .. } => {}
            }
        }
        Ok(Case { scene, solids_scale })
    }
}

/// Largest scale that fits on the adapter and into nine tenths of this machine's free memory, as `plan` computes it. `load`: the case at a scale.
///
/// # Errors
/// Errors of `load` at scale 1, and [`Error::Limit`] and [`Error::Memory`] at the least grid.
pub fn largest_scale(load: &dyn Fn(f64) -> Result<Case, Error>, adapter: &AdapterReport) -> Result<f64, Error> {
    let cells = load(1.0)?.scene.domain.cells;
    let fits = |scale: f64| {
        let Case { scene, .. } = load(scale)?;
        let plan = Plan::new(&scene, Some(adapter))?;
        plan.check(adapter)?;
        let memory = HostMemory::new(&scene, &solids_of(&scene)?, false)?;
        let mut memory = memory.beside(plan.bytes(), adapter);
        // Other programs may use some before the run.
        memory.available = memory.available / 10 * 9;
        memory.check()
    };
    let (unit, step) = units(cells);
    let scale = |steps: usize| (steps * step) as f64 / unit as f64;
    fits(scale(1))?;
    Ok(scale(largest(&|steps| fits(scale(steps)).is_ok())))
}

/// Greatest common divisor of the cells along the axes, and its multiple that is a step of the search.
pub fn units(cells: [usize; 3]) -> (usize, usize) {
    let divides = |n: &usize| cells.into_iter().all(|cells| cells.is_multiple_of(*n));
    let unit = (1..=cells[0]).rev().find(divides).unwrap_or(1);
    let longest = cells.into_iter().fold(0, usize::max) / unit;
    (unit, STEP.div_ceil(longest))
}

/// Largest number that satisfies a monotone condition; 1 does.
pub fn largest(holds: &dyn Fn(usize) -> bool) -> usize {
    let (mut holding, mut failing) = (1, 2);
    while holds(failing) {
        (holding, failing) = (failing, 2 * failing);
    }
    while failing - holding > 1 {
        let middle = holding.midpoint(failing);
        if holds(middle) { holding = middle } else { failing = middle }
    }
    holding
}
