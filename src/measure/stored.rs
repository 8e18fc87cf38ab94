//! The systems of a sub-step as stored on the device, widened to f64.

use std::sync::Arc;

use crate::elastic::Solids;
use crate::geometry::Coupling;
use crate::reference::{
    ActiveCells, BlockPattern, CoupledSystem, PressureSystem, RightHandSide, SolidSystem, remove_means, right_hand_side,
};
use crate::sim::{GpuPath, LiquidSnapshot, Snapshot, SolidSnapshot, coupled_system, stored_coupling};

/// The system of the pressure in SI units.
pub(super) fn pressure_system(path: &GpuPath, liquid: &LiquidSnapshot, density: f64, dt: f64) -> PressureSystem {
    let active = liquid.active_cells(path.grid());
    let mut rhs = inflow_of(path, liquid, &active, &liquid.rhs);
    // Remainders of rounding to f32 on devices without f64.
    remove_means(&active.closed, &mut rhs.values);
    PressureSystem::new(active, rhs, dt, density)
}

/// E u* in m^3/s, from values in m/s.
fn inflow_of(path: &GpuPath, liquid: &LiquidSnapshot, active: &ActiveCells, values: &[f64]) -> RightHandSide {
    let grid = path.grid();
    let rhs = right_hand_side(grid, &path.cut_cells().open, &liquid.velocity_next, active, None);
    RightHandSide { values: values.iter().map(|b| grid.dx * grid.dx * b).collect(), ..rhs }
}

/// Pressures computed by the device, Pa. If liquid and solids touch: the pressures on the nodes, with a factor in f32.
pub(super) fn pressure(path: &GpuPath, liquid: &LiquidSnapshot, density: f64, dt: f64) -> Vec<f64> {
    let grid = path.grid();
    let pascal = match path.clip().filter(|clip| touches(clip.coupling(), liquid)) {
        Some(clip) => {
            let (_, density) = stored_coupling(clip.coupling(), grid.dx, density, dt);
            density * grid.dx / f64::from(dt as f32)
        }
        None => density * grid.dx / dt,
    };
    liquid.potential.iter().map(|phi| pascal * phi).collect()
}

/// Whether a patch lies in a cell that is an unknown.
pub(super) fn touches(coupling: &Coupling, liquid: &LiquidSnapshot) -> bool {
    coupling.cells().any(|(cell, _)| liquid.active[cell])
}

/// The system of the solids, and the solids as stored on the device.
pub(super) fn solid_system(path: &GpuPath, solids: &SolidSnapshot, dt: f64) -> (SolidSystem, Solids) {
    let all = solids.on_device(path.solids().expect("the snapshot has solids"));
    let pattern = Arc::new(BlockPattern::new(&all));
    // The device stores it in f32.
    let system = solids.system(&all, &pattern, f64::from(dt as f32));
    (system, all)
}

/// The coupled system; `None` if liquid and solids do not touch. `inflow`: right-hand side of the pressure before the solve, which subtracts the flux of
/// the solids, m/s.
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
    let rhs = inflow_of(path, liquid, &active, inflow);
    let (solid, all) = solid_system(path, solids, dt);
    Some((coupled_system((active, &*liquid.separated), rhs, solid, &coupling, density), all))
}
