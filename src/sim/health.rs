//! Checks of a run against the physics of its scene. A collapsed solid is an error. Liquid that is too fast, lost or of
//! the wrong volume causes one notice each per run.

use crate::Error;
use crate::elastic::Solids;
use crate::output::manifest::{SolidHealth, Tally};
use crate::scene::{Keyframe, LoadKind, Scene, Shape, Surface};
use crate::state::{State, StepReport};

/// A solid is sound above this fraction of its rest volume, with at most this fraction of its elements inverted.
const SOUND_VOLUME: f64 = 0.5;
const SOUND_INVERTED: f64 = 0.01;
/// A sound solid fails below this fraction of its rest volume, or after this many sub-steps with a larger fraction of
/// inverted elements.
const FAILED_VOLUME: f64 = 0.1;
const FAILED_INVERTED: f64 = 0.05;
const FAILED_AFTER: u32 = 10;
/// Passages of an elastic wave along a solid after which it counts as sound, or as inverted, if it starts deformed.
/// Such a solid unfolds within some of them.
const UNFOLDING: f64 = 20.0;

/// Range of the liquid volume over the controlled volume without a notice.
const VOLUME_RANGE: [f64; 2] = [0.8, 1.2];
/// Face speed over [`expected_speed`] above which a notice is given. Jets and gaps reach a few times that speed.
const FAST: f64 = 20.0;
/// Pressure below that of the air around it at which a liquid boils: that of the atmosphere, Pa.
const ATMOSPHERE: f64 = 101_325.0;
/// Fraction of lost markers that causes a notice.
const LOST: f64 = 0.01;

/// State of a solid: volume over rest volume, fraction of inverted elements, and the worst element with its det F.
#[derive(Clone, Copy, Debug)]
struct Shrinkage {
    volume: f64,
    inverted: f64,
    worst: (usize, f64),
}

impl Shrinkage {
    /// Evaluates a body; `displacement` of all nodes in m.
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
        Shrinkage { volume: volume / rest, inverted: inverted as f64 / n, worst }
    }

    fn sound(&self) -> bool {
        self.volume > SOUND_VOLUME && self.inverted < SOUND_INVERTED
    }
}

/// Sub-steps of `dt` (s) until a body counts as sound, and as inverted. A body that starts undeformed is sound at
/// once.
fn patience(scene: &Scene, solids: &Solids, body: usize, dt: f64) -> [u32; 2] {
    let solid = &scene.solids[body];
    if solid.initial.scale == glam::DVec3::ONE {
        return [1, FAILED_AFTER];
    }
    let rest = &solids.rest[solids.bodies[body].nodes.clone()];
    let low = rest.iter().copied().reduce(glam::DVec3::min);
    let high = rest.iter().copied().reduce(glam::DVec3::max);
    let length = low.zip(high).map_or(0.0, |(low, high)| (high - low).max_element());
    let time = UNFOLDING * length * (solid.density / solid.young).sqrt();
    let steps = ((time / dt).ceil() as u32).max(FAILED_AFTER);
    [steps, steps]
}

/// Updates the state of the solids after a sub-step with the least det F `min_det` and the number of `inverted`
/// elements. Reads displacements (m) only where these numbers do not decide. `patience` is that of each body. Returns
/// the bodies that failed in this sub-step.
fn update(
    solids: &Solids,
    patience: impl Fn(usize) -> [u32; 2],
    health: &mut [SolidHealth],
    step: u64,
    [min_det, inverted]: [f64; 2],
    displacement: impl FnOnce() -> Result<Vec<[f64; 3]>, Error>,
) -> Result<Vec<(usize, Shrinkage)>, Error> {
    // The volume ratio is the mean of det F.
    let upright = inverted == 0.0;
    let settled = |of: &SolidHealth| of.sound || of.failed_at.is_some();
    if upright && (min_det > SOUND_VOLUME || min_det >= FAILED_VOLUME && health.iter().all(settled)) {
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
    /// Counts a sub-step in which the solid is in order, or not.
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
    let [low, high] = heights.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)]);
    match high >= low {
        true => high - low + grid.dx,
        false => 0.0,
    }
}

/// The error of a run with a failed solid.
fn failure(scene: &Scene, solids: &Solids, state: &State, step: u64, of: (usize, Shrinkage)) -> Error {
    let (number, now) = of;
    let body = &solids.bodies[number];
    let (element, det) = now.worst;
    let corners = solids.elements[element].map(|node| node as usize);
    let places = corners.map(|node| solids.rest[node] + glam::DVec3::from(state.displacement[node]));
    let at = places.into_iter().sum::<glam::DVec3>() / 4.0;
    let pressure = scene.liquid.as_ref().map_or(0.0, |liquid| {
        let gravity = scene.domain.largest_gravity().length();
        2.0 * liquid.density * gravity * depth(scene, state)
    });
    let stiffer = match pressure > scene.solids[number].young {
        true => format!("raise solid[{number}].young above {pressure:.0} Pa, twice the pressure at this depth"),
        false => format!("raise solid[{number}].young, or reduce loads and speeds"),
    };
    Error::Stage {
        stage: "diagnose",
        step,
        problem: format!(
            "solid \"{}\" has collapsed: {:.0} % of its rest volume, {:.0} % of its elements inverted, the worst is element {} at ({:.4}, {:.4}, {:.4}) m with det F = {det:.2}\n  cure: {stiffer}; `cutwater run --keep-going` continues anyway",
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

/// Upper estimate of the liquid's speed from gravity, initial velocities, prescribed motion, sources and elastic
/// energy, m/s. `None` if nothing moves it.
fn expected_speed(scene: &Scene) -> Option<f64> {
    let size = scene.grid().size();
    let fall = (2.0 * scene.domain.largest_gravity().dot(size)).sqrt();
    let most = |speeds: &mut dyn Iterator<Item = f64>| speeds.fold(0.0, f64::max);
    let path = |keyframes: &[Keyframe]| {
        let speeds = keyframes.windows(2).map(|pair| {
            let turn = |frame: &Keyframe| frame.angle * frame.axis;
            let way =
                pair[1].translate.distance(pair[0].translate) + turn(&pair[1]).distance(turn(&pair[0])) * size.length();
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
        // A deformed or loaded body can move at its sound speed times its strain; a strain of order one bounds loads.
        let loaded = solid.loads.iter().any(|load| match load.kind {
            LoadKind::Force(force) | LoadKind::Traction(force) => {
                force != glam::DVec3::ZERO || !load.keyframes.is_empty()
            }
        });
        let elastic = match initial.scale != glam::DVec3::ONE || loaded {
            true => (solid.young / solid.density).sqrt(),
            false => 0.0,
        };
        let rows = initial.velocity_gradient.iter().map(|row| row.length());
        let gradient = initial.spin.length() + rows.sum::<f64>();
        initial.velocity.length() + gradient * size.length() + scripts + elastic
    }));
    let speed = fall + liquid + sources + obstacles + solids;
    (speed > 0.0).then_some(speed)
}

/// Health checks of a run.
#[derive(Debug)]
pub(super) struct Health {
    keep_going: bool,
    expected_speed: Option<f64>,
    /// Whether the surface is that of the markers. Beside a level, markers that bodies push out are replaced.
    surface_of_markers: bool,
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
        let liquid = scene.liquid.as_ref();
        Health {
            keep_going,
            expected_speed: liquid.and_then(|_| expected_speed(scene)),
            surface_of_markers: liquid.is_some_and(|liquid| liquid.surface == Surface::Markers),
        }
    }

    /// Counts signs of failure in the liquid. Returns a line for each sign that occurs for the first time.
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
                "at {time:.4} s the liquid has {:.0} % of its expected volume (steps.csv, volume_ratio): sheets, drops and jets below two cells measure too large, and markers lost in solids or walls reduce it. Use more cells (--scale)",
                100.0 * ratio
            ));
        }
        if let Some(expected) = self.expected_speed
            && liquid.diagnosis.max_speed > FAST * expected
            && first(&mut tally.fast)
        {
            notices.push(format!(
                "at {time:.4} s the liquid's speed is {:.0} m/s, while gravity, inflow and moving bodies explain about {expected:.1} m/s (steps.csv, max_speed): bodies or a collapsing solid squeeze it. Keep bodies apart, use stiffer solids (young), or use more cells (--scale)",
                liquid.diagnosis.max_speed
            ));
        }
        if let Some(separation) = liquid.separation
            && separation.least_pressure < -ATMOSPHERE
            && first(&mut tally.tension)
        {
            notices.push(format!(
                "at {time:.4} s the pressure is {:.0} Pa below that of the air (steps.csv, least_pressure); a real liquid boils at {ATMOSPHERE} Pa below it. Let it leave walls anywhere (liquid.separation = \"walls\"), or slow what pulls at it",
                -separation.least_pressure
            ));
        }
        let before = tally.lost_share();
        tally.dropped += liquid.dropped;
        tally.markers = tally.markers.max(liquid.markers as u64 + tally.dropped);
        if self.surface_of_markers && before < LOST && tally.lost_share() >= LOST {
            notices.push(format!(
                "at {time:.4} s {:.1} % of all markers are lost in obstacles and solids (steps.csv, markers_dropped): they enter walls thinner than two cells and fast or collapsing solids. Use more cells (--scale) or shorter sub-steps (time.cfl)",
                100.0 * tally.lost_share()
            ));
        }
        notices
    }

    /// Checks the solids. `state` reads the state if the report does not decide.
    ///
    /// # Errors
    /// [`Error::Stage`] when a solid has failed and the run does not keep going; errors of `displacement` and
    /// `state`.
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
        let failed = update(solids, patience, health, now.step, worst, displacement)?;
        let Some(&first) = failed.first() else {
            return Ok(Vec::new());
        };
        if !self.keep_going {
            return Err(failure(scene, solids, &state()?, now.step, first));
        }
        let names = failed.iter().map(|(body, of)| {
            format!(
                "at {:.4} s solid \"{}\" has collapsed: {:.0} % of its rest volume, {:.0} % of its elements inverted. The run continues, but later results are not physical",
                now.time,
                solids.bodies[*body].name,
                100.0 * of.volume,
                100.0 * of.inverted
            )
        });
        Ok(names.collect())
    }
}
