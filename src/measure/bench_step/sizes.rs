//! Scenes with other grids and meshes, and which of them an adapter and this machine have room for.

use crate::Error;
use crate::gpu::AdapterReport;
use crate::scene::{Scene, SolidMesh};
use crate::sim::{HostMemory, Plan, solids_of};

/// The largest scale is looked for in grids whose longest side is a multiple of so many cells, or of the least that keeps cells cubic.
const STEP: usize = 10;

/// A scene with its scales.
#[derive(Clone, Debug)]
pub struct Case {
    /// The scene, scaled.
    pub scene: Scene,
    /// What the edges of its solids' elements are divided by.
    pub solids_scale: f64,
}

impl Case {
    /// The scene with other meshes of its solids: bricks along the axes of boxes are multiplied by the scale, rounded, at least 1; lengths of edges
    /// in balls, shells and filled surfaces are divided by it. Meshes from files stay.
    ///
    /// # Errors
    /// [`Error::Input`] where the scale is not a number above 0.
    pub fn new(mut scene: Scene, solids_scale: f64) -> Result<Case, Error> {
        if !(solids_scale.is_finite() && solids_scale > 0.0) {
            return Err(Error::input(
                format!("--solids-scale {solids_scale}"),
                "not a scale",
                "give numbers above 0, such as 0.5,1",
            ));
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
        Ok(Case {
            scene,
            solids_scale,
        })
    }
}

/// The largest scale at which the adapter and nine tenths of this machine's free memory have room for a case, as `plan` finds it. `load`: the
/// case at a scale.
///
/// # Errors
/// What `load` says of the scale 1, and what has no room at the least grid.
pub fn largest_scale(
    load: &dyn Fn(f64) -> Result<Case, Error>,
    adapter: &AdapterReport,
) -> Result<f64, Error> {
    let cells = load(1.0)?.scene.domain.cells;
    let fits = |scale: f64| {
        let Case { scene, .. } = load(scale)?;
        let plan = Plan::new(&scene, Some(adapter))?;
        plan.check(adapter)?;
        let memory = HostMemory::new(&scene, &solids_of(&scene)?, false)?;
        let mut memory = memory.beside(plan.bytes(), adapter);
        // It is asked for again when the scene is run; what else runs may take some until then.
        memory.available = memory.available / 10 * 9;
        memory.check()
    };
    let (unit, step) = units(cells);
    let scale = |steps: usize| (steps * step) as f64 / unit as f64;
    fits(scale(1))?;
    let steps = largest(&|steps| fits(scale(steps)).is_ok());
    Ok(scale(steps))
}

/// How many units of cubic cells there are along the grid, their greatest common divisor, and how many of them are a step of the search.
fn units(cells: [usize; 3]) -> (usize, usize) {
    let divisor = |mut a: usize, mut b: usize| {
        while b != 0 {
            (a, b) = (b, a % b);
        }
        a
    };
    let unit = cells.into_iter().fold(0, divisor);
    let longest = cells.into_iter().fold(0, usize::max) / unit;
    (unit, STEP.div_ceil(longest))
}

/// The largest number of which something holds, as it does of 1, and of no number beyond one of which it does not.
fn largest(holds: &dyn Fn(usize) -> bool) -> usize {
    let (mut holding, mut failing) = (1, 2);
    while holds(failing) {
        (holding, failing) = (failing, 2 * failing);
    }
    while failing - holding > 1 {
        let middle = holding.midpoint(failing);
        match holds(middle) {
            true => holding = middle,
            false => failing = middle,
        }
    }
    holding
}

#[cfg(test)]
mod tests {
    use super::{largest, units};

    #[test]
    fn the_largest_is_found() {
        for most in [1, 2, 3, 16, 17, 100, 1023] {
            assert_eq!(largest(&|n| n <= most), most);
        }
    }

    #[test]
    fn steps_keep_cells_cubic() {
        // A cube in tens; twice as long as high: 5 units are 10 cells; long sides go by units.
        for (cells, expected) in [
            ([100, 100, 100], (100, 10)),
            ([64, 32, 32], (32, 5)),
            ([48, 3, 3], (3, 1)),
        ] {
            assert_eq!(units(cells), expected, "{cells:?}");
        }
    }
}
