//! Separation, a part of `solve`: the set of cells that leave walls and bodies (`reference/separation.rs` has the theory).
//!
//! A round solves with the separated cells as air whose surface lies at their centres, then updates the set. Where cells separated in the
//! last sub-step, or closed liquid opens, that set changes a lot: the first rounds are rough until the set is unchanged. The system of a round
//! is that of `active_cells` for the liquid distance with 0 in separated cells; rounds without any use the system at hand.

use crate::Error;
use crate::fields::pressure_system::FOLD_THREADS;
use crate::fields::{CouplingBuffers, LiquidBuffers, SolverBuffers};
use crate::gpu::{Arrays, Bound, Buffer, Dispatches, Gpu, Kernel, Readback, RealBuffer, Recorder};
use crate::scene::Separation as Mode;
use crate::step::Stage;
use crate::wgsl;

use super::{Components, FreeSurface, PressureSystem, Seal};

/// Largest number of rounds, and the first round whose cells, once let back, do not separate again: as in the twin.
pub const MAX_ROUNDS: u32 = 12;
const LOCK_ROUND: u32 = 6;
/// Relative tolerance of a rough solve: its set is mostly the final one.
const ROUGH: f64 = 1e-2;
/// Number of rounds that may be rough. From then on the potential is a good guess, and a solve to the tolerance costs little more.
const ROUGH_ROUNDS: u32 = 2;

/// Settings of the stage.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub struct SeparationSettings {
    /// Whether only cells beside air may separate: 0 or 1.
    pub from_air: u32,
    /// Whether cells beside the separated ones join those that may: 0 or 1.
    pub grows: u32,
    /// Padding.
    pub pad_0: u32,
    /// Padding.
    pub pad_1: u32,
}

/// Settings of a round.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub struct SeparationRound {
    /// Whether cells let back now do not separate again: 0 or 1.
    pub locks: u32,
    /// Least rate of closing that counts, relative to the largest right-hand side: the tolerance of the last solve.
    pub tolerance: f32,
    /// Padding.
    pub pad_0: u32,
    /// Padding.
    pub pad_1: u32,
}

/// Numbers of a round.
#[derive(Clone, Copy, Debug, Default)]
pub struct RoundSums {
    /// Cells that separate after the round.
    pub added: u32,
    /// Cells that are let back after the round.
    pub returned: u32,
    /// Separated cells during the round.
    pub separated: u32,
    /// Least potential in liquid with a free surface, m/s; 0 without any.
    pub least_potential: f64,
    /// Sum of the rates at which the separated cells open, over dx^2, m/s.
    pub opening: f64,
}

impl RoundSums {
    fn from_words(words: &[u32]) -> RoundSums {
        let real = |word: usize| f64::from(f32::from_bits(words[word]));
        let ordered = !words[5];
        let least = match ordered >> 31 {
            0 => f32::from_bits(!ordered),
            _ => f32::from_bits(ordered & !(1 << 31)),
        };
        RoundSums {
            added: words[0],
            returned: words[1],
            separated: words[2],
            least_potential: if words[5] == 0 { 0.0 } else { least.into() },
            opening: real(6) + real(7),
        }
    }
}

/// The kernels.
#[derive(Debug)]
pub struct Separation {
    start: Bound,
    /// With `from_air`.
    grow: Option<Bound>,
    guess: Bound,
    mask: Bound,
    update: [Bound; 4],
    settle: Bound,
    /// The system with the separated cells as air.
    masked: PressureSystem,
    round: Buffer<SeparationRound>,
    sums: Readback<u32>,
}

impl Separation {
    /// Compiles and binds; `None` without the effect.
    pub fn new(
        gpu: &Gpu,
        liquid: &LiquidBuffers,
        solver: &SolverBuffers,
        mode: Mode,
        free_surface: FreeSurface,
    ) -> Result<Option<Separation>, Error> {
        let Some(sums) = &liquid.separation_sums else {
            return Ok(None);
        };
        let gpu = &gpu.at(Stage::Solve.name());
        let from_air = mode == Mode::FromAir;
        let settings = |grows| {
            let settings = SeparationSettings { from_air: from_air.into(), grows, pad_0: 0, pad_1: 0 };
            gpu.uniform("liquid.separation_settings", &settings)
        };
        let first = settings(0)?;
        let growing = from_air.then(|| settings(1)).transpose()?;
        let round: SeparationRound = bytemuck::Zeroable::zeroed();
        let round = gpu.uniform("liquid.separation_round", &round)?;
        let level = gpu.uniform("solver.level", &solver.plan.level(0))?;
        let open = ("open", liquid.solve_open().into());
        let partials = ("partials", (&solver.outer_partials).into());
        let tables: &[&dyn Arrays] = &[liquid, solver];
        let real = solver.variant.real;
        let bound = |source, own: &[_]| Kernel::new(gpu, &source, real)?.bind(gpu, own, tables);
        Ok(Some(Separation {
            start: bound(wgsl!("separation_start"), &[open, ("settings", (&first).into())])?,
            grow: (growing.as_ref())
                .map(|growing| bound(wgsl!("separation_start"), &[open, ("settings", growing.into())]))
                .transpose()?,
            guess: Kernel::new(gpu, &wgsl!("separation_guess"), solver.variant)?.bind(
                gpu,
                &[("level", (&level).into())],
                tables,
            )?,
            mask: bound(wgsl!("separation_mask"), &[])?,
            update: [
                bound(wgsl!("separation_scale"), &[])?,
                bound(wgsl!("separation_openings"), &[open, partials])?,
                bound(wgsl!("separation_report"), &[partials])?,
                bound(wgsl!("separation_update"), &[open, ("separation_round", (&round).into())])?,
            ],
            settle: bound(wgsl!("separation_settle"), &[])?,
            masked: PressureSystem::new(
                gpu,
                solver,
                liquid.solve_open(),
                &liquid.velocity,
                liquid.within(),
                free_surface,
            )?,
            round,
            sums: Readback::new(gpu, "liquid.separation_sums", sums.len())?,
        }))
    }

    /// Records what separated in the last sub-step.
    pub fn record_before(&self, to: &mut Recorder, liquid: &LiquidBuffers) {
        if let Some((now, before)) = liquid.separated.as_ref().zip(liquid.separated_before.as_ref()) {
            to.copy(now, before);
        }
    }

    /// Records the first set: what separated in the last sub-step.
    pub fn record_start(&self, to: &mut Recorder, liquid: &LiquidBuffers, solver: &SolverBuffers) {
        if let Some(now) = &liquid.separated {
            to.clear(now);
        }
        to.stage(Stage::Solve.name(), |pass| {
            pass.dispatch_indirect(&self.start, &solver.args, 0);
        });
    }

    /// Records that the next solve starts from the potential of the last one.
    pub fn record_guess(&self, to: &mut Recorder, liquid: &LiquidBuffers) {
        to.stage(Stage::Solve.name(), |pass| {
            pass.dispatch_indirect(&self.guess, &liquid.band_args, 0);
        });
    }

    /// Records the system of a round, without the next set of separated cells, which becomes the present one. In early rounds more cells
    /// may separate beside it. `None`: the system of all active cells.
    pub fn record_system(
        &self,
        to: &mut Recorder,
        (liquid, solver): (&LiquidBuffers, &SolverBuffers),
        (unmasked, components, seal): (&PressureSystem, &Components, Option<&Seal>),
        round: Option<u32>,
    ) {
        to.stage(Stage::Solve.name(), |pass| {
            if round.is_some() {
                pass.dispatch_indirect(&self.mask, &liquid.band_args, 0);
            }
            let system = if round.is_some() { &self.masked } else { unmasked };
            system.record(pass, solver, liquid.within());
            components.label(pass, solver, seal);
            if let Some(grow) = self.grow.as_ref().filter(|_| round.is_some_and(|round| round <= LOCK_ROUND)) {
                pass.dispatch_indirect(grow, &solver.args, 0);
            }
        });
    }

    /// Sets the number of the next round, from 1, before all work submitted later. Returns the relative tolerance of its solve, rough
    /// or `full`.
    pub fn write_round(&self, gpu: &Gpu, (number, full): (u32, f64), rough: bool) -> f64 {
        let locks = number >= LOCK_ROUND;
        let tolerance = match rough && number <= ROUGH_ROUNDS {
            true => ROUGH.max(full),
            false => full,
        };
        let round = SeparationRound { locks: u32::from(locks), tolerance: full as f32, pad_0: 0, pad_1: 0 };
        gpu.upload(&self.round, &[round]);
        tolerance
    }

    /// Records the next set, for the solution of a round, and the readback of its numbers.
    pub fn record_update(&mut self, to: &mut Recorder, liquid: &LiquidBuffers) {
        let Some(sums) = &liquid.separation_sums else {
            return;
        };
        to.clear(sums);
        to.stage(Stage::Solve.name(), |pass| {
            let [scale, openings, report, update] = &self.update;
            pass.dispatch_indirect(scale, &liquid.band_args, 0);
            pass.dispatch(openings, FOLD_THREADS);
            pass.dispatch(report, 1);
            pass.dispatch_indirect(update, &liquid.band_args, 0);
        });
        to.read(sums, &mut self.sums);
    }

    /// Waits for the numbers of a round.
    pub fn sums(&mut self, gpu: &Gpu) -> Result<RoundSums, Error> {
        Ok(RoundSums::from_words(&self.sums.wait(gpu)?))
    }

    /// Records the potential of separated cells, and the marks for `extrapolate`.
    pub fn record_settle(&self, to: &mut Recorder, liquid: &LiquidBuffers) {
        to.stage(Stage::Solve.name(), |pass| {
            pass.dispatch_indirect(&self.settle, &liquid.band_args, 0);
        });
    }
}

/// After a solve for liquid and solids: the right-hand side of the separated cells less the flux of the nodes, as the other cells have
/// it. `velocity`: of the nodes, m/s. `None` without the effect.
pub fn separated_flux(
    gpu: &Gpu,
    liquid: &LiquidBuffers,
    solver: &SolverBuffers,
    coupling: &CouplingBuffers,
    velocity: &RealBuffer,
) -> Result<Option<Dispatches>, Error> {
    let Some(separated) = &liquid.separated else {
        return Ok(None);
    };
    let gpu = &gpu.at(Stage::Solve.name());
    let own = [("flags", separated.into()), ("x", velocity.into())];
    let tables: &[&dyn Arrays] = &[coupling, solver];
    let kernel = Kernel::new(gpu, &wgsl!("separation_flux"), solver.variant.real)?;
    let bound = kernel.bind(gpu, &own, tables)?;
    let list = vec![bound.threads(coupling.size.quads)];
    Ok(Some(Dispatches::new(Stage::Solve.name(), list)))
}
