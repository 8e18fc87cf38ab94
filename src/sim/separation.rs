//! Rounds of separation: repeats a solve until the set of separated cells is unchanged (`stages/separation.rs`).

use crate::Error;
use crate::fields::{LiquidBuffers, SolverBuffers};
use crate::gpu::{Dispatches, Gpu, Recorder};
use crate::stages::{Components, MAX_ROUNDS, PatchPressure, PressureSystem, Seal, Separation};
use crate::state::{SeparationReport, SolveStatus};
use crate::step::Stage;

/// The search for the separated cells of a sub-step.
#[derive(Debug)]
pub(super) struct Rounds<'a> {
    pub(super) gpu: &'a Gpu,
    pub(super) fields: (&'a LiquidBuffers, &'a SolverBuffers),
    /// The system of all active cells, and what labels its components.
    pub(super) unmasked: (&'a PressureSystem, &'a Components, Option<&'a Seal>),
    pub(super) stage: &'a mut Separation,
    /// Flux of solids out of the separated cells, where they are solved for with the liquid.
    pub(super) flux: Option<&'a Dispatches>,
    /// Forces of the pressure's variation within cells, which separated cells do not exert.
    pub(super) patches: Option<&'a PatchPressure>,
    /// Tolerance of the last solve.
    pub(super) tolerance: f64,
    /// Pressure of a potential of 1 m/s, Pa.
    pub(super) pascal: f64,
    /// Length of the sub-step, s.
    pub(super) dt: f64,
    /// Separated cells, rounds and openings so far.
    pub(super) report: SeparationReport,
    /// Whether the last search ended with the conditions of its set fulfilled.
    pub(super) settled: bool,
}

/// A round.
#[derive(Clone, Copy, Debug)]
pub(super) struct Round {
    pub(super) number: u32,
    /// Relative tolerance of its solve.
    pub(super) tolerance: f64,
}

impl Rounds<'_> {
    /// Status of a search whose last solve has a status.
    pub(super) fn status(&self, status: SolveStatus) -> SolveStatus {
        match status {
            SolveStatus::Converged if !self.settled => SolveStatus::Unsettled,
            status => status,
        }
    }

    /// Whether the solve is repeated for closed liquid that opens.
    fn opens(&self) -> bool {
        let (_, components, _) = self.unmasked;
        components.opens()
    }

    /// Records the first set: what separated in the last sub-step, and the cells at which closed liquid opens.
    pub(super) fn record_start(&self, to: &mut Recorder) {
        let (liquid, solver) = self.fields;
        if !self.opens() {
            self.stage.record_before(to, liquid);
        }
        self.stage.record_start(to, liquid, solver);
    }

    /// Repeats a solve until the set is unchanged. A round waits as often as a solve, and starts from the solution of the last one. Where no
    /// cell is separated before and no closed liquid opens, mostly none will be, and no round is rough.
    /// `solve` gets work for the end of each of its submissions, and returns whether that work has read the solution.
    ///
    /// The recording that is returned restores the system of all active cells.
    pub(super) fn search<Solution>(
        &mut self,
        mut recorder: Recorder,
        mut solve: impl FnMut(Recorder, Round, &mut dyn FnMut(&mut Recorder)) -> Result<(Solution, bool), Error>,
    ) -> Result<(Solution, Recorder), Error> {
        let Rounds { gpu, fields: (liquid, solver), unmasked, flux, patches, .. } = *self;
        let mut masks = self.report.cells > 0 || self.opens();
        let (mut changed, mut rough) = (masks, masks);
        for number in 1.. {
            if number > 1 {
                self.stage.record_guess(&mut recorder, liquid);
            }
            if changed {
                let fields = (liquid, solver);
                self.stage.record_system(&mut recorder, fields, unmasked, Some(number));
                if let Some(patches) = patches {
                    recorder.stage(Stage::Solve.name(), |pass| patches.record(pass));
                }
            }
            let tolerance = self.stage.write_round(gpu, (number, self.tolerance), rough);
            let mut update = |to: &mut Recorder| {
                if let Some(flux) = flux {
                    flux.record(to);
                }
                self.stage.record_update(to, liquid);
            };
            let round = Round { number, tolerance };
            let (solution, updated) = solve(recorder, round, &mut update)?;
            if !updated {
                let mut to = Recorder::new(gpu);
                update(&mut to);
                to.submit();
            }
            let sums = self.stage.sums(gpu)?;
            recorder = Recorder::timed(gpu);
            changed = sums.added + sums.returned > 0;
            self.report.rounds += 1;
            self.report.cells = sums.separated as usize;
            if (!changed && tolerance <= self.tolerance) || number == MAX_ROUNDS {
                self.settled = !changed;
                let dx = liquid.plan.grid.dx;
                self.report.least_pressure = self.pascal * sums.least_potential;
                self.report.opened = dx * dx * self.dt * sums.opening;
                if masks {
                    let fields = (liquid, solver);
                    self.stage.record_system(&mut recorder, fields, unmasked, None);
                }
                self.stage.record_settle(&mut recorder, liquid);
                return Ok((solution, recorder));
            }
            self.report.returned += sums.returned as usize;
            masks |= changed;
            rough &= changed;
        }
        unreachable!("the last round returns")
    }
}
