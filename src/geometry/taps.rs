//! Sources and sinks as cells and faces of the grid: those whose centre lies in a shape and in no obstacle that
//! stands still.
//!
//! The cells of a source that runs are full of liquid that moves with its velocity. They are no unknowns: their faces carry that
//! velocity, are closed for the pressure and let the flux through to the neighbours. Faces through which it would flow into the
//! source are walls, so a source never takes liquid in, wherever it lies: what comes out per second is its velocity times the area
//! that it shows in that direction.
//!
//! Bodies that move do not change which cells and areas these are. `exchange` makes no markers in the cells that they cover.

use glam::DVec3;

use super::CutCells;
use super::distance::Solid;
use crate::error::{Error, rounded};
use crate::grid::{Axis, Grid};
use crate::scene::{Scene, Shape};
use crate::state::State;

/// Markers that a cell of a source has at least.
pub const PER_CELL: usize = 8;

/// A face between a cell of a source and another cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SourceFace {
    /// What it is normal to.
    pub axis: Axis,
    /// Host index among the faces of the axis.
    pub face: usize,
    /// The sources of the cells on its minus and plus side.
    pub sides: [Option<u32>; 2],
    /// Their velocities along the axis, m/s; 0 on sides of the domain.
    pub velocity: [f64; 2],
    /// Open area, m^2.
    pub area: f64,
}

impl SourceFace {
    /// The velocity that it carries while the sources of the set `running` run, m/s; `None` where neither of its cells belongs to one.
    pub fn held(&self, running: u32) -> Option<f64> {
        let [minus, plus] = self.sides.map(|side| runs(side, running));
        match (minus, plus) {
            (true, true) => Some(self.velocity[0]),
            (true, false) => Some(self.velocity[0].max(0.0)),
            (false, true) => Some(self.velocity[1].min(0.0)),
            (false, false) => None,
        }
    }

    /// What comes out of sources through it, m^3/s.
    fn flux(&self, running: u32) -> f64 {
        let inner = self.sides.iter().all(|&side| runs(side, running));
        match self.held(running) {
            Some(velocity) if !inner => self.area * velocity.abs(),
            _ => 0.0,
        }
    }
}

/// What the sources of a scene do in one sub-step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Running {
    /// The set of those that run, a bit for each.
    pub running: u32,
    /// Those of them that did not in the sub-step before.
    pub starting: u32,
    /// Of the jitter.
    pub seed: u32,
    /// Number of the sub-step.
    pub step: u32,
}

fn runs(source: Option<u32>, running: u32) -> bool {
    source.is_some_and(|source| running >> source & 1 == 1)
}

/// A source without its cells.
#[derive(Clone, Copy, Debug)]
struct Tap {
    /// m/s
    velocity: DVec3,
    /// s
    start: f64,
    /// s
    end: f64,
    /// Mean number of cells along the axis of the largest velocity.
    depth: f64,
}

/// The sources and sinks of a scene on its grid.
#[derive(Clone, Debug, Default)]
pub struct Taps {
    taps: Vec<Tap>,
    /// Cells of sources with the number of theirs, ascending. Where sources overlap, the first has the cell.
    pub source_cells: Vec<(usize, u32)>,
    /// Faces of those cells, by axis and index.
    pub faces: Vec<SourceFace>,
    /// Cells of sinks that are not of sources, ascending, each once.
    pub sink_cells: Vec<usize>,
}

impl Taps {
    /// Those of a scene; `cut`: what obstacles leave that stand still.
    ///
    /// # Errors
    /// [`Error::Input`] for one in which no free cell has its centre.
    pub fn new(scene: &Scene, grid: &Grid, cut: &CutCells) -> Result<Taps, Error> {
        const NONE: u32 = u32::MAX;
        if scene.sources.is_empty() && scene.sinks.is_empty() {
            return Ok(Taps::default());
        }
        let mut owner = vec![NONE; grid.n_cells()];
        for (number, source) in scene.sources.iter().enumerate() {
            let cells = cells(
                scene,
                grid,
                cut,
                &source.shape,
                &format!("source[{number}]"),
            )?;
            for cell in cells {
                if owner[cell] == NONE {
                    owner[cell] = number as u32;
                }
            }
        }
        let mut sink_cells = Vec::new();
        for (number, sink) in scene.sinks.iter().enumerate() {
            sink_cells.extend(cells(
                scene,
                grid,
                cut,
                &sink.shape,
                &format!("sink[{number}]"),
            )?);
        }
        sink_cells.retain(|&cell| owner[cell] == NONE);
        sink_cells.sort_unstable();
        sink_cells.dedup();
        let owners = owner.iter().enumerate();
        let source_cells: Vec<(usize, u32)> = owners
            .filter(|(_, owner)| **owner != NONE)
            .map(|(cell, &owner)| (cell, owner))
            .collect();
        let mut faces = Vec::new();
        for axis in Axis::ALL {
            let a = axis.index();
            let mut of_axis: Vec<usize> = source_cells
                .iter()
                .flat_map(|&(cell, _)| {
                    let minus = grid.cell_at(cell);
                    let mut plus = minus;
                    plus[a] += 1;
                    [minus, plus].map(|at| grid.face(axis, at))
                })
                .collect();
            of_axis.sort_unstable();
            of_axis.dedup();
            faces.extend(of_axis.into_iter().map(|face| {
                let cells = grid.face_sides(axis, grid.face_at(axis, face));
                let on_side = cells.contains(&None);
                let sides = cells.map(|cell| cell.map(|cell| owner[cell]).filter(|&o| o != NONE));
                let velocity = sides.map(|side| match side {
                    Some(source) if !on_side => scene.sources[source as usize].velocity[a],
                    _ => 0.0,
                });
                SourceFace {
                    axis,
                    face,
                    sides,
                    velocity,
                    area: grid.dx * grid.dx * cut.open[a][face],
                }
            }));
        }
        let taps = scene.sources.iter().enumerate().map(|(number, source)| {
            let number = number as u32;
            let axis = source.velocity.abs().max_position();
            let cells = source_cells.iter().filter(|(_, owner)| *owner == number);
            let front = faces.iter().filter(|face| {
                let [minus, plus] = face.sides.map(|side| side == Some(number));
                let forwards = source.velocity[axis] > 0.0;
                face.axis.index() == axis && minus != plus && minus == forwards
            });
            Tap {
                velocity: source.velocity,
                start: source.start,
                end: source.end,
                depth: cells.count() as f64 / front.count().max(1) as f64,
            }
        });
        Ok(Taps {
            taps: taps.collect(),
            source_cells,
            faces,
            sink_cells,
        })
    }

    /// What they do in the sub-step after a state; `seed`: that of the scene's markers.
    pub fn running(&self, state: &State, seed: u64) -> Running {
        let taps = self.taps.iter().enumerate();
        let runs = taps.filter(|(_, tap)| tap.start <= state.time && state.time < tap.end);
        let running = runs.fold(0, |set, (number, _)| set | 1 << number);
        // 64 bits in 32.
        let fold = |x: u64| (x ^ (x >> 32)) as u32;
        Running {
            running,
            starting: running & !(state.sources_running as u32),
            seed: fold(seed),
            step: fold(state.step),
        }
    }

    /// What comes out of the sources of a set, m^3/s.
    pub fn flux(&self, running: u32) -> f64 {
        self.faces.iter().map(|face| face.flux(running)).sum()
    }

    /// What sources of a set take of cells beside them, m^3/s: negative, for they give. `open`: fractions of faces, as bodies that move leave
    /// them.
    pub fn taken(
        &self,
        grid: &Grid,
        open: Option<&[Vec<f64>; 3]>,
        running: u32,
    ) -> Vec<(usize, f64)> {
        let faces = self.faces.iter().filter_map(|face| {
            let area = open.map_or(face.area, |open| {
                grid.dx * grid.dx * open[face.axis.index()][face.face]
            });
            let flux = SourceFace { area, ..*face }.flux(running);
            let outer = face.sides.iter().position(|&side| !runs(side, running))?;
            let cell = grid.face_sides(face.axis, grid.face_at(face.axis, face.face))[outer]?;
            (flux > 0.0).then_some((cell, -flux))
        });
        faces.collect()
    }

    /// The speed that limits sub-steps in which something may cross `cfl` cells, for sources that run at a time (s) or later, m/s:
    /// theirs or, where one is thinner than that, as much more as keeps a sub-step from emptying it: what it emits would have gaps.
    pub fn speed(&self, time: f64, cfl: f64) -> f64 {
        let taps = self.taps.iter().filter(|tap| time < tap.end);
        taps.map(|tap| tap.velocity.abs().max_element() * (cfl / tap.depth).max(1.0))
            .fold(0.0, f64::max)
    }

    /// Markers that the sources emit up to a time (s), at most: they fill their cells, and a quarter more than their flux.
    pub fn room(&self, duration: f64, grid: &Grid) -> usize {
        let flux = (0..self.taps.len()).map(|number| {
            let Tap { start, end, .. } = self.taps[number];
            self.flux(1 << number) * (end.min(duration) - start).max(0.0)
        });
        let flowed = 1.25 * flux.sum::<f64>() / grid.cell_volume();
        PER_CELL * (2 * self.source_cells.len() + flowed.ceil() as usize)
    }

    /// Open fractions with the faces closed that carry the velocity of sources: those for the pressure.
    pub fn held_open(&self, open: &[Vec<f64>; 3], running: u32) -> [Vec<f64>; 3] {
        let mut open = open.clone();
        for face in self
            .faces
            .iter()
            .filter(|face| face.held(running).is_some())
        {
            open[face.axis.index()][face.face] = 0.0;
        }
        open
    }
}

/// The cells with their centres in a shape and in no obstacle.
fn cells(
    scene: &Scene,
    grid: &Grid,
    cut: &CutCells,
    shape: &Shape,
    what: &str,
) -> Result<Vec<usize>, Error> {
    let solid = Solid::new(shape)?;
    let holds = |cell: usize| {
        let free = cut.solid_distance[cell] >= 0.0;
        free && solid.distance(grid.cell_centre(grid.cell_at(cell))) <= 0.0
    };
    let cells: Vec<usize> = (0..grid.n_cells()).filter(|&cell| holds(cell)).collect();
    if cells.is_empty() {
        return Err(Error::input(
            scene.at(what),
            format!(
                "no cell of {} m outside obstacles has its centre in it",
                rounded(grid.dx)
            ),
            "make it at least a cell thick, use more cells (domain.cells, --scale), or move it out of obstacles",
        ));
    }
    Ok(cells)
}
