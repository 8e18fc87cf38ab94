//! The systems of a sub-step as stored on the device, widened to f64.

use std::sync::Arc;

use crate::Error;
use crate::elastic::Solids;
use crate::geometry::Coupling;
use crate::reference::{
    ActiveCells, BlockPattern, CoupledSystem, PressureSystem, RightHandSide, SolidSystem, StepSystem, remove_means,
    right_hand_side,
};
use crate::sim::{GpuPath, LiquidSnapshot, Snapshot, SolidSnapshot, coupled_system, stored_coupling};
use crate::state::StepReport;
use crate::step::Stage;

/// Receives a system and its solution, with the fields after the solve.
pub(super) type Observer<'a> = &'a mut dyn FnMut(&GpuPath, &Snapshot, StepSystem) -> Result<(), Error>;

/// Computes a sub-step and calls the observer with each of its systems and its solution, as [`crate::reference::Reference::step_observed`] does.
pub(super) fn step_observed(path: &mut GpuPath, observer: Observer) -> Result<StepReport, Error> {
    let dt = path.next_time_step().dt;
    // Right-hand side of the pressure, m/s. The solve subtracts the flux of the solids from it.
    let mut inflow = Vec::new();
    path.step_observed(&mut |stage, path| {
        match stage {
            Stage::RightHandSide => inflow = path.snapshot()?.liquid.map_or_else(Vec::new, |liquid| liquid.rhs),
            Stage::Solve => observe(path, &path.snapshot()?, &inflow, dt, observer)?,
            _ => {}
        }
        Ok(())
    })
}

fn observe(path: &GpuPath, snapshot: &Snapshot, inflow: &[f64], dt: f64, observer: Observer) -> Result<(), Error> {
    let both = snapshot.liquid.as_ref().zip(snapshot.solids.as_ref());
    if let Some((liquid, solids)) = both
        && let Some(system) = system_of_both(path, liquid, solids, inflow, dt)
    {
        let pressure = pressure(path, liquid, dt);
        return observer(path, snapshot, StepSystem::Coupled(&system, &pressure, &solids.velocity));
    }
    if let Some(liquid) = &snapshot.liquid {
        let active = liquid.active_cells(path.grid());
        let mut rhs = inflow_of(path, liquid, &active, &liquid.rhs);
        // Remainders of rounding to f32 on devices without f64.
        remove_means(&active.closed, &mut rhs.values);
        let system = PressureSystem::new(active, rhs, dt, density(path)).masked(&liquid.separated);
        observer(path, snapshot, StepSystem::Pressure(&system, &pressure(path, liquid, dt)))?;
    }
    if let Some(solids) = &snapshot.solids {
        observer(path, snapshot, StepSystem::Solid(&solid_system(path, solids, dt), &solids.velocity))?;
    }
    Ok(())
}

/// Density of the liquid, kg/m^3; 0 without liquid.
fn density(path: &GpuPath) -> f64 {
    path.scene().liquid.as_ref().map_or(0.0, |liquid| liquid.density)
}

/// E u* in m^3/s, from values in m/s.
fn inflow_of(path: &GpuPath, liquid: &LiquidSnapshot, active: &ActiveCells, values: &[f64]) -> RightHandSide {
    let grid = path.grid();
    let rhs = right_hand_side(grid, &path.cut_cells().open, &liquid.velocity_next, active, None);
    RightHandSide { values: values.iter().map(|b| grid.dx * grid.dx * b).collect(), ..rhs }
}

/// Pressures computed by the device, Pa. If liquid and solids touch: the pressures on the nodes, with a factor in f32.
pub(super) fn pressure(path: &GpuPath, liquid: &LiquidSnapshot, dt: f64) -> Vec<f64> {
    let (grid, density) = (path.grid(), density(path));
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

/// The solids as stored on the device.
pub(super) fn on_device(path: &GpuPath, solids: &SolidSnapshot) -> Solids {
    solids.on_device(path.solids().expect("the snapshot has solids"))
}

fn solid_system(path: &GpuPath, solids: &SolidSnapshot, dt: f64) -> SolidSystem {
    let all = on_device(path, solids);
    let pattern = Arc::new(BlockPattern::new(&all));
    // The device stores it in f32.
    solids.system(&all, &pattern, f64::from(dt as f32))
}

/// The coupled system; `None` if liquid and solids do not touch.
fn system_of_both(
    path: &GpuPath,
    liquid: &LiquidSnapshot,
    solids: &SolidSnapshot,
    inflow: &[f64],
    dt: f64,
) -> Option<CoupledSystem> {
    let grid = path.grid();
    let (clip, at_rest) = path.clip().zip(path.solids())?;
    let (coupling, density) = stored_coupling(clip.coupling(), grid.dx, density(path), dt);
    if !touches(&coupling, liquid) {
        return None;
    }
    let mut active = liquid.active_cells(grid);
    active.seal(&coupling, &at_rest.prescribed);
    let rhs = inflow_of(path, liquid, &active, inflow);
    let solid = solid_system(path, solids, dt);
    Some(coupled_system((active, &*liquid.separated), rhs, solid, &coupling, density))
}
