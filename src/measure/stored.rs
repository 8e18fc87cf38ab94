//! The systems of a sub-step as the device stores them, widened: the systems of the step (design section 5).

use std::sync::Arc;

use crate::elastic::Solids;
use crate::geometry::Coupling;
use crate::reference::{BlockPattern, CoupledSystem, PressureSystem, SolidSystem, right_hand_side};
use crate::sim::{
    GpuPath, LiquidSnapshot, Snapshot, SolidSnapshot, coupled_system, stored_coupling,
};

/// The system of the pressure in SI units.
pub(super) fn pressure_system(
    path: &GpuPath,
    liquid: &LiquidSnapshot,
    density: f64,
    dt: f64,
) -> PressureSystem {
    let grid = path.grid();
    let area = grid.dx * grid.dx;
    let active = liquid.active_cells(grid);
    let open = &path.cut_cells().open;
    let mut rhs = right_hand_side(grid, open, &liquid.velocity_next, &active, None);
    rhs.values = liquid.rhs.iter().map(|b| area * b).collect();
    let mut system = PressureSystem::new(active, rhs, dt, density);
    let mut values = std::mem::take(&mut system.rhs);
    // What rounding to f32 left of them, where the device has no f64.
    system.remove_closed_means(&mut values);
    system.rhs = values;
    system
}

/// The pressures that the device has found, Pa; where liquid and solids touch those with which it pushes nodes, whose rate is an f32.
pub(super) fn pressure(path: &GpuPath, liquid: &LiquidSnapshot, density: f64, dt: f64) -> Vec<f64> {
    let grid = path.grid();
    let pascal = match path.clip().filter(|clip| touches(clip.coupling(), liquid)) {
        Some(clip) => {
            let (_, density) = stored_coupling(clip.coupling(), grid.dx, density, dt);
            density * grid.dx / f64::from(dt as f32)
        }
        None => density * grid.dx / dt,
    };
    let potential = liquid.potential.iter();
    potential.map(|phi| pascal * phi).collect()
}

/// Whether a patch lies in a cell that is an unknown.
fn touches(coupling: &Coupling, liquid: &LiquidSnapshot) -> bool {
    let mut joined = coupling.cells();
    joined.any(|(cell, _)| liquid.active[cell])
}

/// The system of the solids, with the numbers that the device has of them.
pub(super) fn solid_system(
    path: &GpuPath,
    solids: &SolidSnapshot,
    dt: f64,
) -> (SolidSystem, Solids) {
    let at_rest = path
        .solids()
        .expect("a snapshot of solids is of a scene with some");
    let all = solids.on_device(at_rest);
    let pattern = Arc::new(BlockPattern::new(&all));
    // As the device has it.
    let system = solids.system(&all, &pattern, f64::from(dt as f32));
    (system, all)
}

/// The system of both; `None` where they do not touch. `inflow`: the right-hand side of the pressure before the solve, which takes from it
/// what the solids take up, m/s.
pub(super) fn system_of_both(
    path: &GpuPath,
    Snapshot { liquid, solids, .. }: &Snapshot,
    inflow: &[f64],
    density: f64,
    dt: f64,
) -> Option<(CoupledSystem, Solids)> {
    let grid = path.grid();
    let both = liquid.as_ref().zip(solids.as_ref());
    let ((liquid, solids), (clip, at_rest)) = both.zip(path.clip().zip(path.solids()))?;
    let (coupling, density) = stored_coupling(clip.coupling(), grid.dx, density, dt);
    let mut active = liquid.active_cells(grid);
    active.seal(&coupling, &at_rest.prescribed);
    if !touches(&coupling, liquid) {
        return None;
    }
    let open = &path.cut_cells().open;
    let mut rhs = right_hand_side(grid, open, &liquid.velocity_next, &active, None);
    rhs.values = inflow.iter().map(|b| grid.dx * grid.dx * b).collect();
    let (solid, all) = solid_system(path, solids, dt);
    Some((coupled_system(active, rhs, solid, &coupling, density), all))
}
