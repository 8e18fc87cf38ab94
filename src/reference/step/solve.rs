//! `solve`: the pressure and the velocities of the nodes, together where liquid and solids touch.

use glam::DVec3;

use super::SubStep;
use crate::Error;
use crate::reference::contact_rows::{Touching, solve_coupled_in_rows, solve_in_rows};
use crate::reference::path::SolidModel;
use crate::reference::solve_coupled::Together;
use crate::reference::{
    Candidates, CoupledSystem, Formulation, PressureSystem, SQUEEZE, Separation, SolidSystem, solve,
    solve_coupled_in_contact, solve_damping_only, solve_weak, touching_cells,
};
use crate::scene::{CouplingScheme, Separation as Separate};
use crate::state::{SolveReport, SolveStatus};
use crate::step::Stage;

/// A system of a sub-step and its solution.
#[derive(Clone, Copy, Debug)]
pub enum StepSystem<'a> {
    /// The pressure per cell, Pa.
    Pressure(&'a PressureSystem, &'a [f64]),
    /// The velocities of the nodes, m/s.
    Solid(&'a SolidSystem, &'a [[f64; 3]]),
    /// Both, where liquid and solids touch.
    Coupled(&'a CoupledSystem, &'a [f64], &'a [[f64; 3]]),
}

impl SubStep<'_> {
    pub(super) fn solve(&mut self) -> Result<(), Error> {
        let liquid = self.boundary.clip().zip(self.results.pressure.as_ref());
        self.results.coupling.touching = liquid.is_some_and(|(clip, pressure)| {
            let mut cells = clip.coupling().cells();
            cells.any(|(cell, _)| pressure.stencil.active(cell))
        });
        self.results.separation = self.separation();
        match self.results.coupling.touching {
            true => self.solve_together()?,
            false => self.solve_separately()?,
        }
        if let Some(separation) = &self.results.separation {
            let [liquid, _] = &mut self.results.solves;
            *liquid = liquid.map(|report| separation.flagged(report));
            separation.cells().clone_into(&mut self.after.separated);
            self.lift_enclosed_pressures();
        }
        let finite = |solve: &SolveReport| solve.status != SolveStatus::NonFinite;
        let finite = self.results.solves.iter().flatten().all(finite);
        self.ensure_finite(Stage::Solve, finite)?;
        self.sum_patch_forces();
        if let Some((_, contacts)) = self.results.solid.as_ref().filter(|_| !self.model.effects.solid_contact) {
            self.results.contact.closing_rate = contacts.closing_rate(&self.after.node_velocity);
        }
        if let Some(clip) = self.boundary.clip() {
            let mut forces = vec![[0.0; 3]; self.results.node_forces.len()];
            let pressure = &self.after.pressure;
            clip.coupling().add_transposed(pressure, forces.as_flattened_mut());
            let sum: DVec3 = forces.iter().copied().map(DVec3::from).sum();
            self.results.coupling.force = sum.to_array();
            let sums = self.results.node_forces.as_flattened_mut().iter_mut();
            sums.zip(forces.as_flattened()).for_each(|(sum, force)| *sum += force);
        }
        Ok(())
    }

    /// The forces by the variation of the pressure within cells, for the report and probes.
    fn sum_patch_forces(&mut self) {
        let forces = match &self.results.separation {
            Some(separation) => separation.patch_forces(),
            None => self.results.patch_forces.sum_over(|_| true),
        };
        self.results.coupling.correction = forces.iter().copied().sum::<DVec3>().to_array();
        self.results.node_forces = forces.iter().map(DVec3::to_array).collect();
        let n_nodes = self.solids().map_or(0, |solids| solids.rest.len());
        self.results.node_forces.resize(n_nodes, [0.0; 3]);
    }

    /// The cells that may leave walls and bodies, with that effect.
    fn separation(&mut self) -> Option<Separation> {
        let model = self.model;
        let pressure = self.results.pressure.as_mut()?;
        if !model.effects.separation {
            return None;
        }
        let open = match &self.results.source_apertures {
            Some([pressure, _]) => pressure,
            None => &self.boundary.cut_cells().open,
        };
        let clip = self.boundary.clip();
        let touching = touching_cells(&model.grid, open, clip);
        let solids = clip.zip(self.results.solid.as_ref());
        let flux = solids.map(|(clip, (solid, _))| {
            let prescribed = solid.velocity(&vec![0.0; solid.rhs.len()]);
            let mut flux = vec![0.0; touching.len()];
            let coupling = clip.coupling();
            coupling.add_product(prescribed.as_flattened(), &mut flux);
            flux
        });
        // The weaker couplings do not constrain the volume of closed liquid in the same solve.
        let opens = !model.effects.coupling || model.scene.solver.coupling == CouplingScheme::Strong;
        let receding = match opens {
            true => pressure.take_growing(&touching, flux.as_deref(), SQUEEZE),
            false => Vec::new(),
        };
        let from_air = self.liquid()?.separation == Separate::FromAir;
        let candidates =
            Candidates { touching: &touching, from_air: from_air.then_some(open), before: &self.before.separated };
        let pressure = self.results.pressure.as_ref()?;
        Some(Separation::new(pressure, candidates, &receding).beside_solids(&self.results.patch_forces))
    }

    /// Makes the least pressure of enclosed components 0: their pressure has no level, and walls do not pull.
    fn lift_enclosed_pressures(&mut self) {
        let closed: Vec<&Vec<usize>> = match (&self.results.coupled, &self.results.pressure) {
            (Some(system), _) => system.level_free().collect(),
            (None, Some(system)) => system.closed.iter().collect(),
            (None, None) => Vec::new(),
        };
        let pressure = &mut self.after.pressure;
        for component in closed {
            let least = component.iter().map(|&cell| pressure[cell]);
            let least = least.fold(f64::INFINITY, f64::min);
            (component.iter()).for_each(|&cell| pressure[cell] -= least);
        }
    }

    fn solve_separately(&mut self) -> Result<(), Error> {
        let settings = &self.model.scene.solver;
        if let Some(system) = &self.results.pressure {
            let (pressure, report) = match &mut self.results.separation {
                Some(separation) => separation.solve(system, settings)?,
                None => solve(system, settings)?,
            };
            self.after.pressure = pressure;
            let share = system.squeezed(&system.closed, None);
            self.results.solves[0] = Some(or_incompatible(report, share));
        }
        if let Some(((system, contacts), part)) = self.results.solid.as_mut().zip(self.model.solid.as_ref()) {
            let SolidModel { solids, solver, .. } = part;
            let (velocity, report, contact) = match self.model.effects.solid_contact {
                false => solver.solve_in_contact(solids, system, contacts, settings)?,
                true => {
                    let moved = solids.moved(&self.after.displacement);
                    let touching = Touching {
                        solids,
                        contacts,
                        positions: &moved.nodes,
                        dt: self.time_step.dt,
                        dx: self.model.grid.dx,
                    };
                    solve_in_rows(solver, system, touching, settings)?
                }
            };
            self.after.node_velocity = velocity;
            (self.results.solves[1], self.results.contact) = (Some(report), contact);
        }
        Ok(())
    }

    fn solve_together(&mut self) -> Result<(), Error> {
        let settings = &self.model.scene.solver;
        let liquid = self.boundary.clip().zip(self.results.pressure.as_mut());
        let solid = self.results.solid.as_mut().zip(self.model.solid.as_ref());
        let Some(((clip, pressure), ((solid, contacts), part))) = liquid.zip(solid) else {
            return Ok(());
        };
        let SolidModel { solids, solver, .. } = part;
        let coupling = clip.coupling();
        let separation = self.results.separation.as_mut();
        let solution = if settings.coupling == CouplingScheme::Weak {
            let solve_solid = |solid: &mut SolidSystem| {
                let (velocity, report, contact) = solver.solve_in_contact(solids, solid, contacts, settings)?;
                self.results.contact = contact;
                Ok((velocity, report))
            };
            let before = &self.results.velocity_before;
            let mut solution = solve_weak((pressure, separation), solid, coupling, before, settings, solve_solid)?;
            let share = pressure.squeezed(&pressure.closed, None);
            solution.reports[0] = or_incompatible(solution.reports[0], share);
            solution
        } else {
            let solved = if self.model.effects.solid_contact {
                let moved = solids.moved(&self.after.displacement);
                let touching = Touching {
                    solids,
                    contacts,
                    positions: &moved.nodes,
                    dt: self.time_step.dt,
                    dx: self.model.grid.dx,
                };
                let together = Together { pressure, separation, coupling, solver, solids, settings, iterations: 0 };
                solve_coupled_in_rows(together, solid, touching)
            } else {
                let solve = match settings.coupling {
                    CouplingScheme::DampingOnly => solve_damping_only,
                    _ => solve_coupled_in_contact,
                };
                solve((pressure, separation), solid, coupling, contacts, solver, solids, settings)
            };
            let (system, mut solution, contact) = solved?;
            let flagged = |report| or_incompatible(report, system.squeezed);
            solution.reports = solution.reports.map(flagged);
            self.results.coupling.condensed = Formulation::of(&system) == Formulation::Condensed;
            (self.results.coupled, self.results.contact) = (Some(system), contact);
            solution
        };
        (self.after.pressure, self.after.node_velocity) = (solution.pressure, solution.velocity);
        self.results.solves = solution.reports.map(Some);
        Ok(())
    }

    /// Calls the observer with the systems as solved at last.
    pub(super) fn observe_systems(&mut self) {
        let (pressure, velocity) = (&self.after.pressure, &self.after.node_velocity);
        if let Some(system) = &self.results.coupled {
            return (self.observer)(StepSystem::Coupled(system, pressure, velocity));
        }
        if let Some(system) = &self.results.pressure {
            match &self.results.separation {
                Some(separation) => {
                    let masked = system.masked(separation.cells());
                    (self.observer)(StepSystem::Pressure(&masked, pressure));
                }
                None => (self.observer)(StepSystem::Pressure(system, pressure)),
            }
        }
        if let Some((system, _)) = &self.results.solid {
            (self.observer)(StepSystem::Solid(system, velocity));
        }
    }
}

/// The report, with the status `Incompatible` where the incompatible share of the prescribed boundary flux is too large.
fn or_incompatible(report: SolveReport, share: f64) -> SolveReport {
    let status = match report.status {
        SolveStatus::Converged if share > SQUEEZE => SolveStatus::Incompatible,
        status => status,
    };
    SolveReport { status, ..report }
}
