//! Sources and sinks as cells and faces of the grid.
//!
//! A source owns the cells that its shape meets and that static obstacles leave open. While it runs these cells are no
//! unknowns: their faces have the source's velocity v and are closed to the pressure. Outer faces that v enters through are
//! walls. Every other outer face has a prescribed boundary flux. Its aperture is the area fraction within the stream tube, at
//! most the aperture beside obstacles:
//!
//! ```text
//! T = { x + t v : x in the shape and in the domain, t >= 0 }
//! ```
//!
//! The sum of these fluxes is |v| times the projected area of the shape along v, less the part that walls cover. It does not
//! depend on the cells or the direction. Fractions are sampled with rays. Those between 0 and 1 are scaled so that the sum is
//! exact for a shape within the domain.
//!
//! The octants of source cells that lie in the shape are refilled with markers; their number equals the volume of the shape.
//!
//! With keyframes a source has a constant direction and in each sub-step the mean of its velocity. Faces have this velocity;
//! cells and apertures are those of the largest. A source without velocity does not run. A level and its markers move with the
//! velocities of the last sub-step, and so do their inflow and the lattice of new markers.
//!
//! A sink consists of the cells with a centre in its shape and outside static obstacles. Moving bodies change neither cells nor
//! apertures; `exchange` emits no markers in the cells that they cover.

use std::borrow::Cow;

use glam::DVec3;
use rayon::prelude::*;

use super::CutCells;
use super::distance::Solid;
use crate::error::{Error, rounded};
use crate::grid::{Axis, Grid};
use crate::scene::{MAX_VELOCITY, Scene, Shape, Source, VectorKeyframe};
use crate::state::State;

/// Least number of markers in a source cell: one per octant.
pub const MARKERS_PER_CELL: usize = 8;

/// Rays along each side of a face: sides of a shape within a hundredth of a cell of a grid line coincide with it.
const RAYS: usize = 48;
const SAMPLES: usize = 4;
const SCALINGS: usize = 16;
/// Least mean thickness of a source along its velocity, cells, and least volume, cells. Thinner sources emit with gaps.
const MIN_THICKNESS: f64 = 0.5;
/// Relative magnitude below which a component of a velocity is zero.
const NO_COMPONENT: f64 = 1e-12;

/// A face of a source cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SourceFace {
    /// Axis of the normal.
    pub axis: Axis,
    /// Host index among the faces of the axis.
    pub face: usize,
    /// Sources of the cells on the minus and plus side.
    pub sides: [Option<u32>; 2],
    /// Velocities of these sources along the axis in the sub-step, m/s; 0 on sides of the domain.
    pub velocity: [f64; 2],
    /// The same at their largest velocities.
    largest: [f64; 2],
    /// Apertures of these sources towards a cell of no source.
    pub aperture: [f64; 2],
    /// Open area, m^2.
    pub area: f64,
    /// Area of the whole face, m^2.
    whole: f64,
}

/// Prescribed velocity and aperture of a face.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrescribedFace {
    /// m/s
    pub velocity: f64,
    /// Aperture without obstacles.
    pub aperture: f64,
}

impl SourceFace {
    /// Prescribed velocity and aperture while the sources in the bit set `running` run; `None` if neither cell belongs to
    /// one.
    pub fn prescribed(&self, running: u32) -> Option<PrescribedFace> {
        let [minus, plus] = self.sides.map(|side| runs(side, running));
        let (velocity, aperture) = match (minus, plus) {
            (true, true) => (self.velocity[0], 1.0),
            (true, false) => (self.velocity[0].max(0.0), self.aperture[0]),
            (false, true) => (self.velocity[1].min(0.0), self.aperture[1]),
            (false, false) => return None,
        };
        Some(PrescribedFace { velocity, aperture })
    }

    /// Volume flux out of sources, m^3/s, through the open area `area` (m^2).
    fn flux(&self, area: f64, running: u32) -> f64 {
        let inner = self.sides.iter().all(|&side| runs(side, running));
        match self.prescribed(running) {
            Some(prescribed) if !inner => area.min(prescribed.aperture * self.whole) * prescribed.velocity.abs(),
            _ => 0.0,
        }
    }
}

/// Level (cells) to which a running source fills a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fill {
    /// The cell.
    pub cell: usize,
    /// Number of the source.
    pub source: u32,
    /// Largest level, cells.
    pub level: f64,
    /// Index among the source cells; `None` beside them.
    pub index: Option<usize>,
    /// The cell is beside a face of the source that the liquid does not leave through. Air there keeps the level, so that the
    /// liquid leaves with the cross-section of the source.
    pub side: bool,
}

/// Largest number of markers that a source emits in a cell in a sub-step, with a level: cells of its lattice, as large as octants,
/// that meet a cell.
pub const MOST_SITES: usize = 27;

/// Units of the edge of an octant in which [`Lattice`] counts.
pub const OCTANT_UNITS: i64 = 1 << 16;

/// Lattice of the sites of a source in a sub-step, which moves with its velocity: one marker per cell of the lattice, which is as
/// large as an octant. Integers, so that all backends emit the same markers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lattice {
    /// Displacement since the source started, at the end of the sub-step: whole octants, rounded down.
    pub whole: [i32; 3],
    /// Rest of it, units.
    pub rest: [i32; 3],
    /// Displacement in the sub-step, units.
    pub moved: [i32; 3],
}

/// Activity of the sources in one sub-step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Running {
    /// Bit set of the running sources.
    pub running: u32,
    /// Running sources that did not run in the previous sub-step.
    pub starting: u32,
    /// Seed of the jitter.
    pub seed: u32,
    /// Number of the sub-step.
    pub step: u32,
}

fn runs(source: Option<u32>, running: u32) -> bool {
    source.is_some_and(|source| running >> source & 1 == 1)
}

/// A source without its cells.
#[derive(Clone, Debug)]
struct SourceState {
    /// m/s; with keyframes the largest.
    velocity: DVec3,
    /// Velocity over time; empty if it is constant.
    keyframes: Vec<VectorKeyframe>,
    /// Fractions of the velocity in the last sub-step and in this one.
    parts: [f64; 2],
    /// s
    start: f64,
    /// s
    end: f64,
    /// Mean number of cells along the axis of the largest velocity.
    depth: f64,
    /// Flow rate at the velocity while no other source runs, m^3/s.
    flow_rate: f64,
    /// Flow rate without walls: speed times projected area, m^3/s.
    unobstructed: f64,
}

impl SourceState {
    /// Mean fraction of the velocity between two times (s).
    fn mean_part(&self, times: [f64; 2]) -> f64 {
        match &self.keyframes[..] {
            [] => 1.0,
            keyframes => self.part(VectorKeyframe::mean(keyframes, times)),
        }
    }

    fn part(&self, velocity: DVec3) -> f64 {
        velocity.dot(self.velocity) / self.velocity.length_squared()
    }

    /// Largest fraction of the velocity between two times (s).
    fn largest_part(&self, [from, to]: [f64; 2]) -> f64 {
        if self.keyframes.is_empty() {
            return 1.0;
        }
        let within = self.keyframes.iter().filter(|frame| (from..=to).contains(&frame.time));
        let ends = [from, to].map(|time| VectorKeyframe::at(&self.keyframes, time));
        within.map(|frame| frame.value).chain(ends).map(|velocity| self.part(velocity)).fold(0.0, f64::max)
    }

    /// Whether it emits after a time (s).
    fn runs_after(&self, time: f64) -> bool {
        let next = self.keyframes.partition_point(|frame| frame.time <= time);
        let around = [next.saturating_sub(1), next.min(self.keyframes.len().saturating_sub(1))];
        let some = self.keyframes.is_empty() || around.iter().any(|&at| self.keyframes[at].value != DVec3::ZERO);
        self.start <= time && time < self.end && some
    }

    /// How often it starts at most.
    fn n_starts(&self) -> usize {
        let at_once = self.keyframes.first().is_none_or(|frame| frame.value != DVec3::ZERO);
        let pairs = self.keyframes.windows(2);
        usize::from(at_once) + pairs.filter(|pair| pair[0].value == DVec3::ZERO && pair[1].value != DVec3::ZERO).count()
    }
}

/// Flow of a source on the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SourceFlow {
    /// Velocity of the liquid, m/s; with keyframes the largest, and the following flow rates.
    pub velocity: DVec3,
    /// Flow rate while no other source runs, m^3/s.
    pub flow_rate: f64,
    /// Flow rate without walls: speed times projected area, m^3/s.
    pub unobstructed: f64,
    /// s
    pub start: f64,
    /// s
    pub end: f64,
}

/// The sources and sinks of a scene on its grid.
#[derive(Clone, Debug, Default)]
pub struct SourcesAndSinks {
    sources: Vec<SourceState>,
    /// Cells of sources with the number of their source, ascending. Overlapping cells belong to the first source.
    pub source_cells: Vec<(usize, u32)>,
    /// Octants of each of these cells to refill with markers: bit i + 2 j + 4 k for the upper half along x, y, z.
    pub eighths: Vec<u8>,
    /// Faces of these cells, by axis and index.
    pub faces: Vec<SourceFace>,
    /// Cells of sinks outside sources, ascending.
    pub sink_cells: Vec<usize>,
}

impl SourcesAndSinks {
    /// `cut` has the static obstacles. A source or sink without a free cell is an error.
    pub fn new(scene: &Scene, grid: &Grid, cut: &CutCells) -> Result<SourcesAndSinks, Error> {
        const NONE: u32 = u32::MAX;
        if scene.sources.is_empty() && scene.sinks.is_empty() {
            return Ok(SourcesAndSinks::default());
        }
        let mut owner = vec![NONE; grid.n_cells()];
        let mut eighths = vec![0; grid.n_cells()];
        let mut outlets = Vec::new();
        for (number, source) in scene.sources.iter().enumerate() {
            let met = met_cells(grid, &source.shape)?;
            outlets.push(Outlet::new(grid, source, &met));
            let free = |&&(cell, _): &&Met| owner[cell] == NONE && opens(grid, cut, cell);
            let own: Vec<Met> = met.iter().filter(free).copied().collect();
            for (&(cell, _), full) in own.iter().zip(full_eighths(cut, &own)) {
                (owner[cell], eighths[cell]) = (number as u32, full);
            }
            ensure_thick(scene, grid, cut, &own, number)?;
        }
        let mut sink_cells = Vec::new();
        for number in 0..scene.sinks.len() {
            sink_cells.extend(cells_of_sink(scene, grid, cut, number)?);
        }
        sink_cells.retain(|&cell| owner[cell] == NONE);
        sink_cells.sort_unstable();
        sink_cells.dedup();
        let owners = owner.iter().enumerate();
        let source_cells: Vec<(usize, u32)> =
            owners.filter(|(_, owner)| **owner != NONE).map(|(cell, &owner)| (cell, owner)).collect();
        let eighths = source_cells.iter().map(|&(cell, _)| eighths[cell]).collect();
        let face = |axis: Axis, face: usize| {
            let a = axis.index();
            let cells = grid.face_sides(axis, grid.face_at(axis, face));
            let on_side = cells.contains(&None);
            let sides = cells.map(|cell| cell.map(|cell| owner[cell]).filter(|&o| o != NONE));
            let velocity = sides.map(|side| match side {
                Some(source) if !on_side => scene.sources[source as usize].velocity[a],
                _ => 0.0,
            });
            // Apertures of sources with an outward velocity.
            let aperture = [0, 1].map(|side| match sides[side] {
                Some(source) if velocity[side] * [1.0, -1.0][side] > 0.0 => {
                    outlets[source as usize].aperture(grid, axis, face)
                }
                _ => 0.0,
            });
            let whole = grid.dx * grid.dx;
            let area = whole * cut.open[a][face];
            SourceFace { axis, face, sides, velocity, largest: velocity, aperture, area, whole }
        };
        let faces = Axis::ALL.into_iter().flat_map(|axis| {
            let faces = faces_of_cells(grid, axis, &source_cells).into_iter();
            faces.map(move |number| (axis, number))
        });
        let faces = faces.map(|(axis, number)| face(axis, number)).collect();
        let sources = scene.sources.iter().zip(&outlets).map(|(source, outlet)| SourceState {
            velocity: source.velocity,
            keyframes: source.keyframes.clone(),
            parts: [1.0; 2],
            start: source.start,
            end: source.end,
            depth: outlet.depth,
            flow_rate: 0.0,
            unobstructed: outlet.area * source.velocity.length(),
        });
        let mut all = SourcesAndSinks { sources: sources.collect(), source_cells, eighths, faces, sink_cells };
        for (number, source) in scene.sources.iter().enumerate() {
            if let Some(flow_rate) = source.flow_rate {
                all.set_flow_rate(number, flow_rate, &scene.at(&format!("source[{number}]")))?;
            }
            all.sources[number].flow_rate = all.flux(1 << number);
        }
        Ok(all)
    }

    /// Scales the velocity of a source to a flow rate (m^3/s) through the open part of its faces.
    fn set_flow_rate(&mut self, number: usize, flow_rate: f64, what: &str) -> Result<(), Error> {
        // Infinite for a covered source.
        let scale = flow_rate / self.flux(1 << number);
        let source = &mut self.sources[number];
        if scale * source.velocity.length() > MAX_VELOCITY {
            return Err(Error::input(
                what,
                format!("walls leave too little of it open for {flow_rate} m^3/s"),
                "move it out of obstacles and off walls, or turn it so that liquid can leave it",
            ));
        }
        source.velocity *= scale;
        source.keyframes.iter_mut().for_each(|frame| frame.value *= scale);
        source.unobstructed *= scale;
        for face in &mut self.faces {
            for (velocity, side) in face.largest.iter_mut().zip(face.sides) {
                if side == Some(number as u32) {
                    *velocity *= scale;
                }
            }
            face.velocity = face.largest;
        }
        Ok(())
    }

    /// With the velocities of a sub-step, see [`set_velocities`](Self::set_velocities).
    pub fn with_velocities(&self, time: f64, dts: [f64; 2]) -> Cow<'_, SourcesAndSinks> {
        if self.sources.iter().all(|source| source.keyframes.is_empty()) {
            return Cow::Borrowed(self);
        }
        let mut own = self.clone();
        own.set_velocities(time, dts);
        Cow::Owned(own)
    }

    /// Sets the velocities of a sub-step of dt (s) after a time (s); the last one had `dt_last` (s). Returns whether any changes over time.
    pub fn set_velocities(&mut self, time: f64, [dt_last, dt]: [f64; 2]) -> bool {
        let timed = self.sources.iter().any(|source| !source.keyframes.is_empty());
        if timed {
            for source in &mut self.sources {
                source.parts = [[time - dt_last, time], [time, time + dt]].map(|times| source.mean_part(times));
            }
            for face in &mut self.faces {
                for ((velocity, largest), side) in face.velocity.iter_mut().zip(face.largest).zip(face.sides) {
                    *velocity = side.map_or(1.0, |source| self.sources[source as usize].parts[1]) * largest;
                }
            }
        }
        timed
    }

    /// Flow of each source.
    pub fn flows(&self) -> impl Iterator<Item = SourceFlow> {
        self.sources.iter().map(|source| SourceFlow {
            velocity: source.velocity,
            flow_rate: source.flow_rate,
            unobstructed: source.unobstructed,
            start: source.start,
            end: source.end,
        })
    }

    /// Activity in the sub-step after a state; `seed` is that of the scene's markers.
    pub fn running(&self, state: &State, seed: u64) -> Running {
        let sources = self.sources.iter().enumerate();
        let runs = sources.filter(|(_, source)| source.runs_after(state.time));
        let running = runs.fold(0, |set, (number, _)| set | 1 << number);
        // Folds 64 bits into 32.
        let fold = |x: u64| (x ^ (x >> 32)) as u32;
        Running {
            running,
            starting: running & !(state.sources_running as u32),
            seed: fold(seed),
            step: fold(state.step),
        }
    }

    /// Whether a source fills an octant (twice the resolution of the cells) with markers.
    pub fn fills_octant(&self, grid: &Grid, source: u32, octant: [i64; 3]) -> bool {
        let at = octant.map(|n| n.div_euclid(2));
        let inside = (0..3).all(|a| (0..grid.cells[a] as i64).contains(&at[a]));
        let cell = |at: [i64; 3]| grid.cell(at.map(|n| n as usize));
        let found = inside.then(|| self.source_cells.binary_search(&(cell(at), source)));
        found.and_then(Result::ok).is_some_and(|found| {
            let bit: usize = (0..3).map(|a| (octant[a].rem_euclid(2) as usize) << a).sum();
            self.eighths[found] >> bit & 1 == 1
        })
    }

    /// Lattice of each source in the sub-step of dt (s) after a time (s).
    pub fn lattices(&self, grid: &Grid, time: f64, dt: f64) -> Vec<Lattice> {
        let lattice = |source: &SourceState| {
            // Counted from the start, so that one sub-step ends where the next begins.
            let units = |seconds: f64| {
                let octants = seconds * source.velocity / (0.5 * grid.dx);
                (octants * OCTANT_UNITS as f64).to_array().map(|x| x.round() as i64)
            };
            let since_start = |time: f64| (time - source.start) * source.mean_part([source.start, time]);
            let after = units(since_start(time + dt));
            let moved = match source.keyframes.is_empty() {
                true => {
                    let before = units(since_start(time));
                    std::array::from_fn(|a| after[a] - before[a])
                }
                // The liquid that is there has moved with the velocity of the last sub-step.
                false => units(dt * source.parts[0]),
            };
            Lattice {
                whole: after.map(|x| x.div_euclid(OCTANT_UNITS) as i32),
                rest: after.map(|x| x.rem_euclid(OCTANT_UNITS) as i32),
                moved: moved.map(|x| x as i32),
            }
        };
        self.sources.iter().map(lattice).collect()
    }

    /// Volume flux out of a set of sources, m^3/s.
    pub fn flux(&self, running: u32) -> f64 {
        let faces = self.faces.iter();
        faces.map(|face| face.flux(face.area, running)).sum()
    }

    /// Number of sources.
    pub fn n_sources(&self) -> usize {
        self.sources.len()
    }

    /// Part of [`flux`](Self::flux) out of one source, m^3/s; 0 where it is not among the running ones.
    pub fn flux_of(&self, source: u32, running: u32) -> f64 {
        let own = |face: &&SourceFace| face.sides.contains(&Some(source));
        let faces = self.faces.iter().filter(own);
        let faces = faces.filter(|_| runs(Some(source), running));
        faces.map(|face| face.flux(face.area, running)).sum()
    }

    /// Volume that a source emits beyond its own cells in a sub-step of dt (s), m^3, with a level: it moves with the velocity of
    /// the last sub-step, so a source that starts emits in the next one.
    pub fn inflow(&self, sources: Running, source: u32, dt: f64) -> f64 {
        let flux = self.flux_of(source, sources.running & !sources.starting);
        match self.sources[source as usize].parts {
            [before, now] if before != now && now > 0.0 => dt * flux * (before / now),
            _ => dt * flux,
        }
    }

    /// [`inflow`](Self::inflow) of each source, m^3.
    pub fn inflows(&self, sources: Running, dt: f64) -> impl Iterator<Item = f64> {
        (0..self.n_sources() as u32).map(move |source| self.inflow(sources, source, dt))
    }

    /// Cells of a level that sources fill, ascending. A cell of a source has the level of its full octants, and its neighbours
    /// at most the distance to it; see [`Fill::side`].
    pub fn fills(&self, grid: &Grid) -> Vec<Fill> {
        let cells = self.source_cells.iter().zip(&self.eighths).enumerate();
        let mut fills = Vec::new();
        for (index, (&(cell, source), eighths)) in cells {
            let full = f64::from(eighths.count_ones()) / 8.0;
            fills.push(Fill { cell, source, level: 0.5 - full, index: Some(index), side: false });
            if full < 0.5 {
                continue;
            }
            let search = |cell: usize| {
                let cells = &self.source_cells;
                cells.binary_search_by_key(&cell, |&(cell, _)| cell)
            };
            let beside = around(grid, cell).filter(|&(neighbour, _)| search(neighbour).is_err());
            let velocity = self.sources[source as usize].velocity;
            let at = DVec3::from(grid.cell_at(cell).map(|n| n as f64));
            let side = |other: usize| {
                let out = DVec3::from(grid.cell_at(other).map(|n| n as f64)) - at;
                out.length_squared() == 1.0 && velocity.dot(out) <= 0.0
            };
            fills.extend(beside.map(|(cell, level)| Fill { cell, source, level, index: None, side: side(cell) }));
        }
        fills.sort_by(|a, b| {
            let key = |fill: &Fill| (fill.cell, fill.source);
            let of_level = a.level.total_cmp(&b.level);
            key(a).cmp(&key(b)).then(of_level).then(a.side.cmp(&b.side))
        });
        fills.dedup_by_key(|fill| (fill.cell, fill.source));
        fills
    }

    /// Prescribed boundary flux out of the cells beside a set of sources, m^3/s; negative, an inflow. `open`: apertures
    /// with moving bodies.
    pub fn boundary_flux(&self, grid: &Grid, open: Option<&[Vec<f64>; 3]>, running: u32) -> Vec<(usize, f64)> {
        let faces = self.faces.iter().filter_map(|face| {
            let area = open.map_or(face.area, |open| grid.dx * grid.dx * open[face.axis.index()][face.face]);
            let flux = face.flux(area, running);
            let outer = face.sides.iter().position(|&side| !runs(side, running))?;
            let cell = grid.face_sides(face.axis, grid.face_at(face.axis, face.face))[outer]?;
            (flux > 0.0).then_some((cell, -flux))
        });
        faces.collect()
    }

    /// Speed limit of the CFL condition with `cfl` cells for sources that run at a time (s) or later, m/s; for those with keyframes
    /// from the beginning of the last sub-step, `dt_last` (s) earlier, to the end of the frame, `left` (s) later.
    ///
    /// A source thinner than `cfl` cells has a proportionally larger speed: a sub-step must not empty it, else the emitted
    /// liquid has gaps.
    pub fn speed(&self, time: f64, [dt_last, left]: [f64; 2], cfl: f64) -> f64 {
        let sources = self.sources.iter().filter(|source| time < source.end);
        let speed = |source: &SourceState| {
            let part = source.largest_part([time - dt_last, time + left]);
            part * source.velocity.abs().max_element() * (cfl / source.depth).max(1.0)
        };
        sources.map(speed).fold(0.0, f64::max)
    }

    /// Upper bound of the markers emitted up to a time (s): the fillings at each start, the slots of a sub-step and 1.25 times the flux.
    pub fn max_markers(&self, level: bool, duration: f64, grid: &Grid) -> usize {
        let flux = self.sources.iter().map(|source| {
            let (start, end) = (source.start, source.end.min(duration));
            source.flow_rate * (end - start).max(0.0) * source.mean_part([start, end])
        });
        let flowed = 1.25 * flux.sum::<f64>() / grid.cell_volume();
        let slots = if level { MOST_SITES } else { MARKERS_PER_CELL };
        let cells = self.source_cells.iter();
        let filled: usize = cells.map(|&(_, source)| self.sources[source as usize].n_starts()).sum();
        MARKERS_PER_CELL * (filled + flowed.ceil() as usize) + slots * self.source_cells.len()
    }

    /// Apertures for the pressure: faces with a prescribed velocity are closed.
    pub fn pressure_apertures(&self, open: &[Vec<f64>; 3], running: u32) -> [Vec<f64>; 3] {
        let mut open = open.clone();
        for face in self.faces.iter().filter(|face| face.prescribed(running).is_some()) {
            open[face.axis.index()][face.face] = 0.0;
        }
        open
    }

    /// Apertures for fluxes: faces with a prescribed velocity have its aperture.
    pub fn flux_apertures(&self, open: &[Vec<f64>; 3], running: u32) -> [Vec<f64>; 3] {
        let mut open = open.clone();
        for face in &self.faces {
            if let Some(prescribed) = face.prescribed(running) {
                let open = &mut open[face.axis.index()][face.face];
                *open = open.min(prescribed.aperture);
            }
        }
        open
    }
}

/// The 26 cells around a cell, and the distances of their centres from its surface, cells.
fn around(grid: &Grid, cell: usize) -> impl Iterator<Item = (usize, f64)> + use<'_> {
    let ijk = grid.cell_at(cell);
    let ranges: [_; 3] = std::array::from_fn(|b| ijk[b].saturating_sub(1)..(ijk[b] + 2).min(grid.cells[b]));
    let [is, js, ks] = ranges;
    let rows = ks.flat_map(move |k| js.clone().map(move |j| (j, k)));
    let all = rows.flat_map(move |(j, k)| is.clone().map(move |i| [i, j, k]));
    all.filter(move |&at| at != ijk).map(move |at| {
        let apart = (0..3).filter(|&b| at[b] != ijk[b]).count();
        (grid.cell(at), 0.5 * (apart as f64).sqrt())
    })
}

/// A cell that a shape meets, with the volume fraction of each octant in the shape.
type Met = (usize, [f64; 8]);

/// The cells that a shape meets, ascending.
fn met_cells(grid: &Grid, shape: &Shape) -> Result<Vec<Met>, Error> {
    let solid = Solid::new(shape)?;
    // Distance from the centre to a corner.
    let reach = 0.75_f64.sqrt() * grid.dx;
    let n = 2 * SAMPLES;
    let shares = |cell: usize| {
        let at = grid.cell_at(cell);
        let distance = solid.distance(grid.cell_centre(at));
        if distance.abs() >= reach {
            return (distance < 0.0).then_some((cell, [1.0; 8]));
        }
        let mut shares = [0.0; 8];
        for sample in 0..n.pow(3) {
            let within = [sample % n, sample / n % n, sample / (n * n)];
            let x = [0, 1, 2].map(|a| at[a] as f64 + (within[a] as f64 + 0.5) / n as f64);
            if solid.distance(grid.dx * DVec3::from(x)) <= 0.0 {
                let eighth: usize = (0..3).map(|a| (within[a] / SAMPLES) << a).sum();
                shares[eighth] += 1.0 / SAMPLES.pow(3) as f64;
            }
        }
        (shares != [0.0; 8]).then_some((cell, shares))
    };
    Ok((0..grid.n_cells()).into_par_iter().filter_map(shares).collect())
}

/// Whether obstacles leave a face of a cell open.
fn opens(grid: &Grid, cut: &CutCells, cell: usize) -> bool {
    let minus = grid.cell_at(cell);
    Axis::ALL.into_iter().any(|axis| {
        let mut plus = minus;
        plus[axis.index()] += 1;
        let open = &cut.open[axis.index()];
        [minus, plus].into_iter().any(|at| open[grid.face(axis, at)] > 0.0)
    })
}

/// Octants of source cells to refill, none in cells with a centre in an obstacle: those with the largest fractions, as many as
/// the sum of all fractions. A hash orders equal fractions, so that no side is preferred.
fn full_eighths(cut: &CutCells, cells: &[Met]) -> Vec<u8> {
    let free = |cell: usize| cut.solid_distance[cell] >= 0.0;
    let mut shares: Vec<(f64, u64, usize, usize)> = Vec::new();
    for (index, &(cell, fractions)) in cells.iter().enumerate() {
        if free(cell) {
            let hash = |eighth: usize| (8 * cell + eighth) as u64 * 0x9e37_79b9_7f4a_7c15;
            let eighths = fractions.into_iter().enumerate();
            let some = eighths.filter(|(_, share)| *share > 0.0);
            shares.extend(some.map(|(e, share)| (share, hash(e).rotate_left(32), index, e)));
        }
    }
    shares.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let n = shares.iter().map(|(share, ..)| share).sum::<f64>().round() as usize;
    let mut full = vec![0; cells.len()];
    for &(.., index, eighth) in &shares[..n] {
        full[index] |= 1 << eighth;
    }
    full
}

/// Refuses a source that walls cover, or that is too thin for markers.
fn ensure_thick(scene: &Scene, grid: &Grid, cut: &CutCells, own: &[Met], number: usize) -> Result<(), Error> {
    let source = &scene.sources[number];
    let free = own.iter().filter(|(cell, _)| cut.solid_distance[*cell] >= 0.0);
    let volume: f64 = free.flat_map(|(_, shares)| shares).sum::<f64>() / 8.0;
    let area = source.shape.projected_area(source.velocity.normalize()) / grid.dx.powi(2);
    if volume >= MIN_THICKNESS * area.min(1.0) && volume > 0.0 {
        return Ok(());
    }
    Err(Error::input(
        scene.at(&format!("source[{number}]")),
        format!("outside obstacles it has less than half a cell of {} m", rounded(grid.dx)),
        "make it at least a cell thick, use more cells (domain.cells, --scale), or move it out of obstacles",
    ))
}

/// Stream tube of a source.
struct Outlet<'a> {
    shape: &'a Shape,
    /// Unit vector against the velocity.
    back: DVec3,
    size: DVec3,
    /// Projected area of the shape, m^2.
    area: f64,
    /// Scale of area fractions between 0 and 1.
    scale: f64,
    /// Mean number of cells along the axis of the largest velocity.
    depth: f64,
}

impl<'a> Outlet<'a> {
    fn new(grid: &Grid, source: &'a Source, met: &[Met]) -> Outlet<'a> {
        let direction = source.velocity.normalize();
        let mut outlet = Outlet {
            shape: &source.shape,
            back: -direction,
            size: grid.size(),
            area: source.shape.projected_area(direction),
            scale: 1.0,
            depth: 1.0,
        };
        let inner = |cell: usize| met.binary_search_by_key(&cell, |met| met.0).is_ok();
        let largest = direction.abs().max_position();
        // Area fractions of the outer faces with an outward velocity, times its normal component.
        let (mut whole, mut parts, mut front) = (0.0, Vec::new(), 0.0);
        for &(cell, _) in met {
            for axis in Axis::ALL {
                let a = axis.index();
                if direction[a].abs() <= NO_COMPONENT {
                    continue;
                }
                let mut at = grid.cell_at(cell);
                at[a] += usize::from(direction[a] > 0.0);
                let sides = grid.face_sides(axis, at);
                let next = sides[usize::from(direction[a] > 0.0)];
                if next.is_some_and(inner) {
                    continue;
                }
                let share = outlet.share(grid, axis, at);
                if a == largest {
                    front += share;
                }
                match share == 1.0 {
                    true => whole += direction[a].abs(),
                    false => parts.push((share, direction[a].abs())),
                }
            }
        }
        let volume: f64 = met.iter().flat_map(|(_, shares)| shares).sum::<f64>() / 8.0;
        outlet.depth = volume / front.max(f64::MIN_POSITIVE);
        if outlet.shape.lies_in(grid.size()) {
            let rest = outlet.area / grid.dx.powi(2) - whole;
            // Fractions that reach 1 remain there.
            for _ in 0..SCALINGS {
                let scaled = parts.iter().map(|(share, part)| (outlet.scale * share, part));
                let (full, some): (Vec<_>, Vec<_>) = scaled.partition(|(share, _)| *share >= 1.0);
                let full: f64 = full.iter().map(|(_, part)| *part).sum();
                let sum: f64 = some.iter().map(|(share, part)| share * *part).sum();
                if sum > 0.0 {
                    outlet.scale *= ((rest - full) / sum).max(0.0);
                }
            }
        }
        outlet
    }

    /// Area fraction of a face within the stream tube.
    fn share(&self, grid: &Grid, axis: Axis, at: [usize; 3]) -> f64 {
        let a = axis.index();
        let [b, c] = [(a + 1) % 3, (a + 2) % 3];
        let inside = |ray: usize| {
            let mut x = at.map(|n| n as f64);
            x[b] += (0.5 + (ray % RAYS) as f64) / RAYS as f64;
            x[c] += (0.5 + (ray / RAYS) as f64) / RAYS as f64;
            let x = grid.dx * DVec3::from(x);
            let domain = Shape::Box { min: DVec3::ZERO, max: self.size };
            let chords = [self.shape, &domain].map(|shape| chord(shape, x, self.back));
            match chords {
                [Some([from, to]), Some([enters, leaves])] => from.max(enters).max(0.0) < to.min(leaves),
                _ => false,
            }
        };
        let n = RAYS * RAYS;
        (0..n).filter(|&ray| inside(ray)).count() as f64 / n as f64
    }

    /// Aperture of a face, in single precision as on the device.
    fn aperture(&self, grid: &Grid, axis: Axis, face: usize) -> f64 {
        let share = self.share(grid, axis, grid.face_at(axis, face));
        match share == 1.0 {
            true => 1.0,
            false => f64::from((self.scale * share).min(1.0) as f32),
        }
    }
}

/// Entry and exit of a line from x along a unit vector through a box, ball or cylinder, m.
fn chord(shape: &Shape, x: DVec3, direction: DVec3) -> Option<[f64; 2]> {
    // Intersection with a slab.
    let between = |height: f64, slope: f64, [low, high]: [f64; 2]| match slope == 0.0 {
        true => {
            let inside = low < height && height < high;
            inside.then_some([f64::NEG_INFINITY, f64::INFINITY])
        }
        false => {
            let [a, b] = [low, high].map(|plane| (plane - height) / slope);
            Some([a.min(b), a.max(b)])
        }
    };
    // Intersection with a ball or an infinite cylinder.
    let round = |x: DVec3, direction: DVec3, radius: f64| {
        let (square, product) = (direction.length_squared(), x.dot(direction));
        let rest = x.length_squared() - radius * radius;
        if square < NO_COMPONENT {
            return (rest < 0.0).then_some([f64::NEG_INFINITY, f64::INFINITY]);
        }
        let root = product * product - square * rest;
        let root = (root > 0.0).then(|| root.sqrt())?;
        Some([(-product - root) / square, (-product + root) / square])
    };
    let intersection = |a: Option<[f64; 2]>, b: Option<[f64; 2]>| {
        let ([a, b], [c, d]) = (a?, b?);
        let [from, to] = [a.max(c), b.min(d)];
        (from < to).then_some([from, to])
    };
    match *shape {
        Shape::Box { min, max } => {
            [0, 1, 2].map(|a| between(x[a], direction[a], [min[a], max[a]])).into_iter().reduce(intersection).flatten()
        }
        Shape::Sphere { centre, radius } => round(x - centre, direction, radius),
        Shape::Cylinder { base, axis, radius, height } => {
            let [over, along] = [(x - base).dot(axis), direction.dot(axis)];
            let flat = between(over, along, [0.0, height]);
            let across = round(x - base - over * axis, direction - along * axis, radius);
            intersection(flat, across)
        }
        _ => None,
    }
}

/// Faces of source cells normal to an axis, ascending.
fn faces_of_cells(grid: &Grid, axis: Axis, cells: &[(usize, u32)]) -> Vec<usize> {
    let faces = cells.iter().flat_map(|&(cell, _)| {
        let minus = grid.cell_at(cell);
        let mut plus = minus;
        plus[axis.index()] += 1;
        [minus, plus].map(|at| grid.face(axis, at))
    });
    let mut faces: Vec<usize> = faces.collect();
    faces.sort_unstable();
    faces.dedup();
    faces
}

/// Cells with a centre in a sink and in no obstacle.
fn cells_of_sink(scene: &Scene, grid: &Grid, cut: &CutCells, number: usize) -> Result<Vec<usize>, Error> {
    let solid = Solid::new(&scene.sinks[number].shape)?;
    let inside = |&cell: &usize| {
        let free = cut.solid_distance[cell] >= 0.0;
        free && solid.distance(grid.cell_centre(grid.cell_at(cell))) <= 0.0
    };
    let cells: Vec<usize> = (0..grid.n_cells()).filter(inside).collect();
    if cells.is_empty() {
        return Err(Error::input(
            scene.at(&format!("sink[{number}]")),
            format!("no cell of {} m outside obstacles has its centre in it", rounded(grid.dx)),
            "make it at least a cell thick, use more cells (domain.cells, --scale), or move it out of obstacles",
        ));
    }
    Ok(cells)
}
