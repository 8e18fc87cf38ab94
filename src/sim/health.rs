//! Signs that a run no longer computes what its scene describes: solids that collapse, and liquid that is too fast, lost or of the wrong
//! volume. A collapsed solid is an error; the others are notices, each given once while the run goes on.

use crate::Error;
use crate::elastic::Solids;
use crate::output::manifest::{SolidHealth, Tally};
use crate::scene::{Keyframe, LoadKind, Scene, Shape};
use crate::state::{State, StepReport};

/// A solid is sound above this volume, over that at rest, with at most this share of its elements inverted.
const SOUND_VOLUME: f64 = 0.5;
const SOUND_INVERTED: f64 = 0.01;
/// A solid that was sound has failed below this volume, or with more than this share of its elements inverted for so many sub-steps.
const FAILED_VOLUME: f64 = 0.1;
const FAILED_INVERTED: f64 = 0.05;
const FAILED_AFTER: u32 = 10;
/// A solid that starts squashed, stretched or inverted unfolds in some passages of an elastic wave along its length: it counts as sound only
/// after so many passages without a break, and as inverted likewise.
const UNFOLDING: f64 = 20.0;

/// Liquid volume over the volume to hold beyond which a notice is given.
const VOLUME_RANGE: [f64; 2] = [0.8, 1.2];
/// Face speed over [`expected_speed`] beyond which a notice is given: real jets and gaps reach a few times that speed.
const FAST: f64 = 20.0;
/// Share of lost markers from which on a notice is given.
const LOST: f64 = 0.01;

/// The state of one solid: volume over that at rest, share of inverted elements, and its worst element with det F.
#[derive(Clone, Copy, Debug)]
struct Shrinkage {
    volume: f64,
    inverted: f64,
    worst: (usize, f64),
}

impl Shrinkage {
    /// Of a body under `displacement` (m, of all nodes).
    fn of(solids: &Solids, body: usize, displacement: &[[f64; 3]]) -> Shrinkage {
        let elements = solids.bodies[body].elements.clone();
        let n = elements.len() as f64;
        let (mut volume, mut rest, mut inverted) = (0.0, 0.0, 0);
        let mut worst = (elements.start, f64::INFINITY);
        for element in elements {
            let det = solids.deformation(element, displacement).determinant();
            volume += det * solids.volume[element];
            rest += solids.volume[element];
            inverted += usize::from(det <= 0.0);
            if det < worst.1 {
                worst = (element, det);
            }
        }
        Shrinkage {
            volume: volume / rest,
            inverted: inverted as f64 / n,
            worst,
        }
    }

    fn sound(&self) -> bool {
        self.volume > SOUND_VOLUME && self.inverted < SOUND_INVERTED
    }
}

/// Sub-steps of `dt` (s) after which a body counts as sound, and as inverted. A body that starts as it is at rest is sound at once.
fn patience(scene: &Scene, solids: &Solids, body: usize, dt: f64) -> [u32; 2] {
    let solid = &scene.solids[body];
    if solid.initial.scale == glam::DVec3::ONE {
        return [1, FAILED_AFTER];
    }
    let rest = &solids.rest[solids.bodies[body].nodes.clone()];
    let low = rest.iter().copied().reduce(glam::DVec3::min);
    let high = rest.iter().copied().reduce(glam::DVec3::max);
    let length = low
        .zip(high)
        .map_or(0.0, |(low, high)| (high - low).max_element());
    let time = UNFOLDING * length * (solid.density / solid.young).sqrt();
    let steps = ((time / dt).ceil() as u32).max(FAILED_AFTER);
    [steps, steps]
}

/// Follows the solids through a sub-step, of which `min_det` is the least det F and `inverted` the count of inverted elements. The
/// displacements (m) are read only where those numbers cannot decide. `patience`: of each body, as in [`patience`]. Returns the bodies that
/// failed in this sub-step.
fn follow(
    solids: &Solids,
    patience: impl Fn(usize) -> [u32; 2],
    health: &mut [SolidHealth],
    step: u64,
    [min_det, inverted]: [f64; 2],
    displacement: impl FnOnce() -> Result<Vec<[f64; 3]>, Error>,
) -> Result<Vec<(usize, Shrinkage)>, Error> {
    // The volume ratio is a mean of det F.
    let upright = inverted == 0.0;
    let settled = |of: &SolidHealth| of.sound || of.failed_at.is_some();
    if upright && (min_det > SOUND_VOLUME || min_det >= FAILED_VOLUME && health.iter().all(settled))
    {
        for (body, of) in health.iter_mut().enumerate() {
            of.note(min_det > SOUND_VOLUME, patience(body)[0]);
            of.inverted_steps = 0;
        }
        return Ok(Vec::new());
    }
    let displacement = displacement()?;
    let mut failed = Vec::new();
    for (body, of) in health.iter_mut().enumerate() {
        let now = Shrinkage::of(solids, body, &displacement);
        let [sound_after, failed_after] = patience(body);
        of.note(now.sound(), sound_after);
        of.inverted_steps = match now.inverted > FAILED_INVERTED {
            true => of.inverted_steps + 1,
            false => 0,
        };
        let fails = now.volume < FAILED_VOLUME || of.inverted_steps >= failed_after;
        if of.sound && of.failed_at.is_none() && fails {
            of.failed_at = Some(step);
            failed.push((body, now));
        }
    }
    Ok(failed)
}

impl SolidHealth {
    /// Counts a sub-step in which the solid is in order, or is not.
    fn note(&mut self, in_order: bool, sound_after: u32) {
        self.sound_steps = match in_order {
            true => self.sound_steps.saturating_add(1),
            false => 0,
        };
        self.sound |= self.sound_steps >= sound_after;
    }
}

/// Depth of the liquid along gravity, m.
fn depth(scene: &Scene, state: &State) -> f64 {
    let grid = scene.grid();
    let down = scene.domain.gravity.normalize_or_zero();
    let cells = state.liquid_distance.iter().enumerate();
    let wet = cells.filter(|(_, distance)| **distance < 0.0);
    let heights = wet.map(|(cell, _)| down.dot(grid.cell_centre(grid.cell_at(cell))));
    let [low, high] = heights.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| {
        [low.min(x), high.max(x)]
    });
    match high >= low {
        true => high - low + grid.dx,
        false => 0.0,
    }
}

/// The error that a failed solid ends a run with.
fn failure(
    scene: &Scene,
    solids: &Solids,
    state: &State,
    step: u64,
    of: (usize, Shrinkage),
) -> Error {
    let (number, now) = of;
    let body = &solids.bodies[number];
    let (element, det) = now.worst;
    let corners = solids.elements[element].map(|node| node as usize);
    let places =
        corners.map(|node| solids.rest[node] + glam::DVec3::from(state.displacement[node]));
    let at = places.into_iter().sum::<glam::DVec3>() / 4.0;
    let pressure = scene.liquid.as_ref().map_or(0.0, |liquid| {
        2.0 * liquid.density * scene.domain.gravity.length() * depth(scene, state)
    });
    let stiffer = match pressure > scene.solids[number].young {
        true => format!(
            "raise solid[{number}].young above {pressure:.0} Pa: liquid this deep crushes softer solids"
        ),
        false => format!("raise solid[{number}].young, or make what acts on it weaker or slower"),
    };
    Error::Stage {
        stage: "diagnose",
        step,
        problem: format!(
            "solid \"{}\" has collapsed: it has {:.0} % of its volume at rest and {:.0} % of its elements are inverted, the worst is element {} at ({:.4}, {:.4}, {:.4}) m with det F = {det:.2}\n  cure: {stiffer}; `cutwater run --keep-going` continues such a run",
            body.name,
            100.0 * now.volume,
            100.0 * now.inverted,
            element - body.elements.start,
            at.x,
            at.y,
            at.z,
        ),
    }
}

/// The fastest that gravity, initial velocities, prescribed motion, sources and elastic energy can make the liquid of a scene, m/s; `None`
/// where nothing moves it.
fn expected_speed(scene: &Scene) -> Option<f64> {
    let size = scene.grid().size();
    let gravity = scene.domain.gravity;
    let fall = (2.0 * gravity.abs().dot(size)).sqrt();
    let most = |speeds: &mut dyn Iterator<Item = f64>| speeds.fold(0.0, f64::max);
    let path = |keyframes: &[Keyframe]| {
        let speeds = keyframes.windows(2).map(|pair| {
            let turn = |frame: &Keyframe| frame.angle * frame.axis;
            let way = pair[1].translate.distance(pair[0].translate)
                + turn(&pair[1]).distance(turn(&pair[0])) * size.length();
            way / (pair[1].time - pair[0].time)
        });
        speeds.fold(0.0, f64::max)
    };
    let regions = scene.liquid.iter().flat_map(|liquid| &liquid.regions);
    let liquid = most(&mut regions.map(|region| {
        let wave = match &region.shape {
            Shape::Solitary(wave) => (wave.gravity * (wave.depth + wave.height)).sqrt(),
            _ => 0.0,
        };
        region.velocity.length() + wave
    }));
    let sources = most(&mut scene.sources.iter().map(|source| source.velocity.length()));
    let motions = scene.obstacles.iter().filter_map(|of| of.motion.as_ref());
    let obstacles = most(&mut motions.map(|motion| path(&motion.keyframes)));
    let solids = most(&mut scene.solids.iter().map(|solid| {
        let initial = &solid.initial;
        let scripts = most(&mut solid.pins.iter().map(|pin| path(&pin.keyframes)));
        // A stretched or loaded body can move its own sound speed times its strain; loads are bounded by the strain of order one.
        let loaded = solid.loads.iter().any(|load| match load.kind {
            LoadKind::Force(force) | LoadKind::Traction(force) => force != glam::DVec3::ZERO,
        });
        let elastic = match initial.scale != glam::DVec3::ONE || loaded {
            true => (solid.young / solid.density).sqrt(),
            false => 0.0,
        };
        initial.velocity.length() + initial.spin.length() * size.length() + scripts + elastic
    }));
    let speed = fall + liquid + sources + obstacles + solids;
    (speed > 0.0).then_some(speed)
}

/// Follows a run.
#[derive(Debug)]
pub(super) struct Health {
    keep_going: bool,
    expected_speed: Option<f64>,
}

/// Numbers of a sub-step that decide on notices.
pub(super) struct Now<'a> {
    /// Number of the sub-step, from 0.
    pub(super) step: u64,
    /// Time at its end, s.
    pub(super) time: f64,
    pub(super) report: &'a StepReport,
    pub(super) volume_ratio: Option<f64>,
}

impl Health {
    pub(super) fn new(scene: &Scene, keep_going: bool) -> Health {
        Health {
            keep_going,
            expected_speed: scene.liquid.as_ref().and_then(|_| expected_speed(scene)),
        }
    }

    /// Counts what is wrong with the liquid; a line for each sign seen for the first time.
    pub(super) fn liquid(&self, now: &Now, tally: &mut Tally) -> Vec<String> {
        let Some(liquid) = now.report.liquid else {
            return Vec::new();
        };
        let mut notices = Vec::new();
        let time = now.time;
        let first = |count: &mut u64| {
            *count += 1;
            *count == 1
        };
        if let Some(ratio) = now.volume_ratio
            && !(VOLUME_RANGE[0]..=VOLUME_RANGE[1]).contains(&ratio)
            && first(&mut tally.volume_off)
        {
            notices.push(format!(
                "at {time:.4} s the liquid has {:.0} % of the volume that it should have (steps.csv, volume_ratio): thin sheets, drops and jets below two cells measure too large, and solids or walls that swallow markers make it too small; use more cells (--scale)",
                100.0 * ratio
            ));
        }
        if let Some(expected) = self.expected_speed
            && liquid.diagnosis.max_speed > FAST * expected
            && first(&mut tally.fast)
        {
            notices.push(format!(
                "at {time:.4} s liquid moves at {:.0} m/s, and gravity, inflow and moving bodies explain about {expected:.1} m/s (steps.csv, max_speed): it is squeezed between bodies or out of a collapsing solid; keep bodies apart, make solids stiffer (young), or use more cells (--scale)",
                liquid.diagnosis.max_speed
            ));
        }
        let before = tally.lost_share();
        tally.dropped += liquid.dropped;
        tally.markers = tally.markers.max(liquid.markers as u64 + tally.dropped);
        if before < LOST && tally.lost_share() >= LOST {
            notices.push(format!(
                "at {time:.4} s {:.1} % of all markers are lost in obstacles and solids (steps.csv, markers_dropped): walls thinner than two cells and fast or collapsing solids swallow them; use more cells (--scale) or shorter sub-steps (time.cfl)",
                100.0 * tally.lost_share()
            ));
        }
        notices
    }

    /// Follows the solids of a scene. `state` reads the state where the report does not decide.
    ///
    /// # Errors
    /// [`Error::Stage`] where one has failed and the run is not to keep going; what `displacement` and `state` end with.
    pub(super) fn solids(
        &self,
        (scene, solids): (&Scene, &Solids),
        now: &Now,
        health: &mut [SolidHealth],
        displacement: impl FnOnce() -> Result<Vec<[f64; 3]>, Error>,
        state: impl FnOnce() -> Result<State, Error>,
    ) -> Result<Vec<String>, Error> {
        let Some(report) = now.report.solid else {
            return Ok(Vec::new());
        };
        let worst = [report.diagnosis.min_det, report.diagnosis.inverted as f64];
        let patience = |body| patience(scene, solids, body, now.report.dt);
        let failed = follow(solids, patience, health, now.step, worst, displacement)?;
        let Some(&first) = failed.first() else {
            return Ok(Vec::new());
        };
        if !self.keep_going {
            return Err(failure(scene, solids, &state()?, now.step, first));
        }
        let names = failed.iter().map(|(body, of)| {
            format!(
                "at {:.4} s solid \"{}\" has collapsed: it has {:.0} % of its volume at rest and {:.0} % of its elements are inverted; the run keeps going, and what follows is not the scene's physics",
                now.time,
                solids.bodies[*body].name,
                100.0 * of.volume,
                100.0 * of.inverted
            )
        });
        Ok(names.collect())
    }
}
