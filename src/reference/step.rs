//! A sub-step of the f64 path: the stages of [`schedule::SCHEDULE`] over host arrays.

mod level;
mod solve;
mod stages;

use std::time::Instant;

pub use solve::StepSystem;

use level::LevelResults;

use super::boundary::Boundary;
use super::path::Model;
use super::{
    ActiveCells, Contacts, CoupledSystem, Lost, PatchForces, PressureSystem, Separation, SolidMatrices, SolidSystem,
    TimeStep,
};
use crate::Error;
use crate::elastic::Solids;
use crate::geometry::{ContactField, Running};
use crate::scene::Liquid;
use crate::state::{
    ContactReport, CouplingReport, Exchange, LiquidReport, SolidReport, SolveReport, State, StepReport,
};
use crate::step::{self as schedule, Backend, Stage};

/// A sub-step in progress.
pub(super) struct SubStep<'a> {
    model: &'a Model,
    boundary: &'a mut Boundary,
    /// With solids.
    obstacles: Option<&'a mut ContactField>,
    before: &'a State,
    observer: &'a mut dyn FnMut(StepSystem),
    time_step: TimeStep,
    sources: Running,
    /// The state in the making.
    after: State,
    results: Results,
    start: Instant,
    stage_start: Instant,
    /// Wall-clock seconds of the stages.
    seconds: Vec<(&'static str, f64)>,
}

/// Results of stages for later ones.
#[derive(Default)]
struct Results {
    /// The level set in the making.
    level: LevelResults,
    /// Velocities of the nodes before the sub-step, m/s; with weak coupling alone.
    velocity_before: Vec<[f64; 3]>,
    removed_markers: Lost,
    /// Apertures of the faces for the pressure, 0 on faces of sources, and for fluxes; with sources alone.
    source_apertures: Option<[[Vec<f64>; 3]; 2]>,
    exchange: Exchange,
    /// Liquid volume to hold after the sub-step, m^3, where liquid is exchanged.
    volume_0_next: Option<f64>,
    active: Option<ActiveCells>,
    matrices: Option<SolidMatrices>,
    /// Of all active cells.
    patch_forces: PatchForces,
    /// All active cells as unknowns.
    pressure: Option<PressureSystem>,
    separation: Option<Separation>,
    solid: Option<(SolidSystem, Contacts)>,
    /// The system of both, where they were solved for together.
    coupled: Option<CoupledSystem>,
    /// Reports on the pressure and on the velocities of the nodes.
    solves: [Option<SolveReport>; 2],
    contact: ContactReport,
    coupling: CouplingReport,
    /// Forces of the liquid on the nodes, N.
    node_forces: Vec<[f64; 3]>,
    /// Faces with a velocity of the liquid.
    valid: [Vec<bool>; 3],
    /// Largest divergence after the projection, 1/s.
    divergence: f64,
    liquid_report: Option<LiquidReport>,
    solid_report: Option<SolidReport>,
}

impl Backend for SubStep<'_> {
    fn run(&mut self, stage: Stage) -> Result<(), Error> {
        match stage {
            Stage::MoveSolid => self.move_solid(),
            Stage::Clip => self.clip(),
            Stage::AdvectMarkers => self.advect_markers(),
            Stage::Exchange => self.exchange(),
            Stage::AdvectLevel => self.advect_level(),
            Stage::AdvectVelocity => self.advect_velocity(),
            Stage::Forces => self.forces(),
            Stage::Occupancy => self.occupancy(),
            Stage::BoundLevel => self.bound_level(),
            Stage::Redistance => self.redistance(),
            Stage::FilterLevel => self.filter_level(),
            Stage::LiquidDistance => self.liquid_distance(),
            Stage::LiquidComponents => self.liquid_components(),
            Stage::VolumeShift => self.volume_shift(),
            Stage::Excess => self.excess(),
            Stage::MarkerBand => self.marker_band(),
            Stage::Landing => self.landing(),
            Stage::ActiveCells => self.active_cells(),
            Stage::SolidMatrices => self.solid_matrices(),
            Stage::RightHandSide => self.right_hand_side(),
            Stage::Solve => return self.solve(),
            Stage::WriteBack => self.write_back(),
            Stage::Extrapolate => self.extrapolate(),
            Stage::Spray => self.spray(),
            Stage::Diagnose => return self.diagnose(),
            Stage::TimeStep | Stage::Band | Stage::ClosedComponents | Stage::Probe => {}
        }
        Ok(())
    }

    fn after(&mut self, stage: Stage) -> Result<(), Error> {
        let now = Instant::now();
        let seconds = (now - self.stage_start).as_secs_f64();
        self.seconds.push((stage.name(), seconds));
        self.stage_start = now;
        if stage == Stage::Solve {
            self.observe_systems();
        }
        Ok(())
    }
}

impl<'a> SubStep<'a> {
    pub(super) fn new(
        model: &'a Model,
        (boundary, obstacles): (&'a mut Boundary, Option<&'a mut ContactField>),
        before: &'a State,
        time_step: TimeStep,
        observer: &'a mut dyn FnMut(StepSystem),
    ) -> SubStep<'a> {
        let start = Instant::now();
        let seed = model.scene.liquid.as_ref().map(|liquid| liquid.seed);
        SubStep {
            model,
            boundary,
            obstacles,
            before,
            observer,
            time_step,
            sources: model.taps.running(before, seed.unwrap_or_default()),
            after: before.clone(),
            results: Results::default(),
            start,
            stage_start: start,
            seconds: Vec::new(),
        }
    }

    /// Runs all stages. Returns the state after them, the forces of the liquid on the nodes (N), and the report.
    pub(super) fn complete(mut self) -> Result<(State, Vec<[f64; 3]>, StepReport), Error> {
        let Model { scene, effects, .. } = self.model;
        schedule::run(&mut self, effects, false)?;
        let (mut state, results) = (self.after, self.results);
        let TimeStep { dt, floored, wave_cfl, .. } = self.time_step;
        state.volume_0 = results.volume_0_next.unwrap_or(state.volume_0);
        state.markers_dropped += results.removed_markers.dropped;
        state.advance_clock(dt, scene.time.frames_per_second);
        state.contact_step = results.contact.next_step(dt, state.contact_step);
        let report = StepReport {
            dt,
            dt_floored: floored,
            wave_cfl,
            liquid: results.liquid_report,
            solid: results.solid_report,
            coupling: effects.coupling.then_some(results.coupling),
            seconds_total: self.start.elapsed().as_secs_f64(),
            seconds: self.seconds,
        };
        Ok((state, results.node_forces, report))
    }

    fn liquid(&self) -> Option<&'a Liquid> {
        self.model.scene.liquid.as_ref()
    }

    fn solids(&self) -> Option<&'a Solids> {
        self.model.solids()
    }

    fn ensure_finite(&self, stage: Stage, finite: bool) -> Result<(), Error> {
        if finite {
            return Ok(());
        }
        Err(Error::Stage { stage: stage.name(), step: self.before.step, problem: "a number is not finite".to_string() })
    }
}
