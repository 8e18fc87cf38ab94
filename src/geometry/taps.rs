//! Sources and sinks as cells and faces of the grid.
//!
//! A source owns all cells that its shape meets and that obstacles at rest leave open. While it runs they are no unknowns: their faces carry
//! the source's velocity v and are closed for the pressure. Faces that v enters the source through are walls: a source never takes liquid in.
//! Every other outer face has a prescribed boundary flux. Its aperture is the share of the face within the stream tube
//!
//! ```text
//! T = { x + t v : x in the shape and in the domain, t >= 0 }
//! ```
//!
//! and at most what obstacles leave open. The sum of these fluxes is |v| times the area of the shape projected along v, less what walls cover,
//! whatever the cells and the direction; liquid leaves with the speed |v|. Shares are counted by rays, and those between 0 and 1
//! are scaled so that the sum is exact for a shape within the domain.
//!
//! Of each cell, the eighths that lie in the shape are kept full of markers: as many eighths in all as the shape has volume.
//!
//! A sink is all cells whose centre lies in its shape and in no obstacle at rest. Bodies that move do not change which cells and
//! apertures these are. `exchange` makes no markers in the cells that they cover.

use glam::DVec3;
use rayon::prelude::*;

use super::CutCells;
use super::distance::Solid;
use crate::error::{Error, rounded};
use crate::grid::{Axis, Grid};
use crate::scene::{MAX_VELOCITY, Scene, Shape, Source};
use crate::state::State;

/// Markers that a cell within a source has at least, one in each eighth.
pub const PER_CELL: usize = 8;

/// Rays along each side of a face: sides of a shape that lie less than a hundredth of a cell off a line of the grid count as on it. And sample
/// points along each side of an eighth of a cell.
const RAYS: usize = 48;
const SAMPLES: usize = 4;
/// Times that shares of faces are scaled.
const SCALINGS: usize = 16;
/// Least mean thickness of a source along its velocity, cells, and least volume, cells: a thinner one would emit with gaps.
const THINNEST: f64 = 0.5;
/// Share of a velocity below which a component is none.
const NO_COMPONENT: f64 = 1e-12;

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
    /// Shares of the face that they emit through where the other side is no source.
    pub aperture: [f64; 2],
    /// Open area, m^2.
    pub area: f64,
    /// Area of the whole face, m^2.
    whole: f64,
}

/// What a face of sources carries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrescribedFace {
    /// m/s
    pub velocity: f64,
    /// Share of the face that lets it through, before obstacles.
    pub aperture: f64,
}

impl SourceFace {
    /// What it carries while the sources of the set `running` run; `None` where neither of its cells belongs to one.
    pub fn held(&self, running: u32) -> Option<PrescribedFace> {
        let [minus, plus] = self.sides.map(|side| runs(side, running));
        let (velocity, aperture) = match (minus, plus) {
            (true, true) => (self.velocity[0], 1.0),
            (true, false) => (self.velocity[0].max(0.0), self.aperture[0]),
            (false, true) => (self.velocity[1].min(0.0), self.aperture[1]),
            (false, false) => return None,
        };
        Some(PrescribedFace { velocity, aperture })
    }

    /// What comes out of sources through it, m^3/s; `area`: its open area, m^2.
    fn flux(&self, area: f64, running: u32) -> f64 {
        let inner = self.sides.iter().all(|&side| runs(side, running));
        match self.held(running) {
            Some(held) if !inner => area.min(held.aperture * self.whole) * held.velocity.abs(),
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
    /// Speed times projected area, m^3/s.
    unobstructed: f64,
}

/// What a source emits on the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SourceFlow {
    /// Velocity of the liquid, m/s.
    pub velocity: DVec3,
    /// Volume per second, m^3/s, while no other source runs.
    pub flow_rate: f64,
    /// The same without walls: speed times the projected area of the shape, m^3/s.
    pub unobstructed: f64,
    /// s
    pub start: f64,
    /// s
    pub end: f64,
}

/// The sources and sinks of a scene on its grid.
#[derive(Clone, Debug, Default)]
pub struct Taps {
    taps: Vec<Tap>,
    /// Cells of sources with the number of theirs, ascending. Where sources overlap, the first has the cell.
    pub source_cells: Vec<(usize, u32)>,
    /// Of each of them, the eighths to keep full of markers: bit i + 2 j + 4 k for the upper half along x, y, z.
    pub eighths: Vec<u8>,
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
        let eighths = source_cells
            .iter()
            .map(|&(cell, _)| eighths[cell])
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
                // Of the sources whose velocity leaves through the face.
                let aperture = [0, 1].map(|side| match sides[side] {
                    Some(source) if velocity[side] * [1.0, -1.0][side] > 0.0 => {
                        outlets[source as usize].aperture(grid, axis, face)
                    }
                    _ => 0.0,
                });
                let whole = grid.dx * grid.dx;
                SourceFace {
                    axis,
                    face,
                    sides,
                    velocity,
                    aperture,
                    area: whole * cut.open[a][face],
                    whole,
                }
            }));
        }
        let taps = scene
            .sources
            .iter()
            .zip(&outlets)
            .map(|(source, outlet)| Tap {
                velocity: source.velocity,
                start: source.start,
                end: source.end,
                depth: outlet.depth,
                unobstructed: outlet.area * source.velocity.length(),
            });
        let mut all = Taps {
            taps: taps.collect(),
            source_cells,
            eighths,
            faces,
            sink_cells,
        };
        for (number, source) in scene.sources.iter().enumerate() {
            if let Some(flow_rate) = source.flow_rate {
                all.set_flow_rate(number, flow_rate, &scene.at(&format!("source[{number}]")))?;
            }
        }
        Ok(all)
    }

    /// Scales the velocity of a source so that it emits a flow rate (m^3/s) through what walls leave.
    fn set_flow_rate(&mut self, number: usize, flow_rate: f64, what: &str) -> Result<(), Error> {
        // Infinite where walls cover all of it.
        let scale = flow_rate / self.flux(1 << number);
        let tap = &mut self.taps[number];
        if scale * tap.velocity.length() > MAX_VELOCITY {
            return Err(Error::input(
                what,
                format!("walls leave too little of it open for {flow_rate} m^3/s"),
                "move it out of obstacles and off walls, or turn it so that liquid can leave it",
            ));
        }
        tap.velocity *= scale;
        tap.unobstructed *= scale;
        for face in &mut self.faces {
            for (velocity, side) in face.velocity.iter_mut().zip(face.sides) {
                if side == Some(number as u32) {
                    *velocity *= scale;
                }
            }
        }
        Ok(())
    }

    /// What each source emits.
    pub fn flows(&self) -> impl Iterator<Item = SourceFlow> {
        self.taps
            .iter()
            .enumerate()
            .map(|(number, tap)| SourceFlow {
                velocity: tap.velocity,
                flow_rate: self.flux(1 << number),
                unobstructed: tap.unobstructed,
                start: tap.start,
                end: tap.end,
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
        let faces = self.faces.iter();
        faces.map(|face| face.flux(face.area, running)).sum()
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
            let flux = face.flux(area, running);
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

    /// Open fractions with the apertures of the faces that carry the velocity of sources: those of the fluxes.
    pub fn flux_open(&self, open: &[Vec<f64>; 3], running: u32) -> [Vec<f64>; 3] {
        let mut open = open.clone();
        for face in &self.faces {
            if let Some(held) = face.held(running) {
                let open = &mut open[face.axis.index()][face.face];
                *open = open.min(held.aperture);
            }
        }
        open
    }
}

/// A cell that a shape meets, with the share of each of its eighths that lies in the shape.
type Met = (usize, [f64; 8]);

/// The cells that a shape meets, ascending.
fn met_cells(grid: &Grid, shape: &Shape) -> Result<Vec<Met>, Error> {
    let solid = Solid::new(shape)?;
    // From the centre to a corner.
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
    Ok((0..grid.n_cells())
        .into_par_iter()
        .filter_map(shares)
        .collect())
}

/// Whether obstacles leave some of a cell's faces open.
fn opens(grid: &Grid, cut: &CutCells, cell: usize) -> bool {
    let minus = grid.cell_at(cell);
    Axis::ALL.into_iter().any(|axis| {
        let mut plus = minus;
        plus[axis.index()] += 1;
        let open = &cut.open[axis.index()];
        [minus, plus]
            .into_iter()
            .any(|at| open[grid.face(axis, at)] > 0.0)
    })
}

/// The eighths of a source's cells to keep full of markers: none where the centre of a cell is in an obstacle; elsewhere those with the largest
/// shares, as many as all shares add up to. Among equals a hash decides, so that no side is preferred.
fn full_eighths(cut: &CutCells, cells: &[Met]) -> Vec<u8> {
    let free = |cell: usize| cut.solid_distance[cell] >= 0.0;
    let mut shares: Vec<(f64, u64, usize, usize)> = Vec::new();
    for (index, &(cell, of_eighths)) in cells.iter().enumerate() {
        if free(cell) {
            let hash = |eighth: usize| (8 * cell + eighth) as u64 * 0x9e37_79b9_7f4a_7c15;
            let eighths = of_eighths.into_iter().enumerate();
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
fn ensure_thick(
    scene: &Scene,
    grid: &Grid,
    cut: &CutCells,
    own: &[Met],
    number: usize,
) -> Result<(), Error> {
    let source = &scene.sources[number];
    let free = own
        .iter()
        .filter(|(cell, _)| cut.solid_distance[*cell] >= 0.0);
    let volume: f64 = free.flat_map(|(_, shares)| shares).sum::<f64>() / 8.0;
    let area = source.shape.projected_area(source.velocity.normalize()) / grid.dx.powi(2);
    if volume >= THINNEST * area.min(1.0) && volume > 0.0 {
        return Ok(());
    }
    Err(Error::input(
        scene.at(&format!("source[{number}]")),
        format!(
            "outside obstacles it has less than half a cell of {} m",
            rounded(grid.dx)
        ),
        "make it at least a cell thick, use more cells (domain.cells, --scale), or move it out of obstacles",
    ))
}

/// How a source emits.
struct Outlet<'a> {
    shape: &'a Shape,
    /// Against its velocity, a unit vector.
    back: DVec3,
    size: DVec3,
    /// Of the shape, projected along the velocity, m^2.
    area: f64,
    /// By how much shares between 0 and 1 are scaled.
    scale: f64,
    /// Mean number of cells along the axis of the largest velocity.
    depth: f64,
}

impl<'a> Outlet<'a> {
    fn new(grid: &Grid, source: &'a Source, met: &[Met]) -> Outlet<'a> {
        let way = source.velocity.normalize();
        let mut outlet = Outlet {
            shape: &source.shape,
            back: -way,
            size: grid.size(),
            area: source.shape.projected_area(way),
            scale: 1.0,
            depth: 1.0,
        };
        let inner = |cell: usize| met.binary_search_by_key(&cell, |met| met.0).is_ok();
        let largest = way.abs().max_position();
        // Shares of the outer faces that the velocity leaves through, times its part normal to them.
        let (mut whole, mut parts, mut front) = (0.0, Vec::new(), 0.0);
        for &(cell, _) in met {
            for axis in Axis::ALL {
                let a = axis.index();
                if way[a].abs() <= NO_COMPONENT {
                    continue;
                }
                let mut at = grid.cell_at(cell);
                at[a] += usize::from(way[a] > 0.0);
                let sides = grid.face_sides(axis, at);
                let next = sides[usize::from(way[a] > 0.0)];
                if next.is_some_and(inner) {
                    continue;
                }
                let share = outlet.share(grid, axis, at);
                if a == largest {
                    front += share;
                }
                match share == 1.0 {
                    true => whole += way[a].abs(),
                    false => parts.push((share, way[a].abs())),
                }
            }
        }
        let volume: f64 = met.iter().flat_map(|(_, shares)| shares).sum::<f64>() / 8.0;
        outlet.depth = volume / front.max(f64::MIN_POSITIVE);
        if outlet.shape.lies_in(grid.size()) {
            let rest = outlet.area / grid.dx.powi(2) - whole;
            // Shares that reach 1 on the way stay there.
            for _ in 0..SCALINGS {
                let scaled = parts
                    .iter()
                    .map(|(share, part)| (outlet.scale * share, part));
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

    /// The share of a face within the stream tube.
    fn share(&self, grid: &Grid, axis: Axis, at: [usize; 3]) -> f64 {
        let a = axis.index();
        let [b, c] = [(a + 1) % 3, (a + 2) % 3];
        let inside = |ray: usize| {
            let mut x = at.map(|n| n as f64);
            x[b] += (0.5 + (ray % RAYS) as f64) / RAYS as f64;
            x[c] += (0.5 + (ray / RAYS) as f64) / RAYS as f64;
            let x = grid.dx * DVec3::from(x);
            let domain = Shape::Box {
                min: DVec3::ZERO,
                max: self.size,
            };
            let chords = [self.shape, &domain].map(|shape| chord(shape, x, self.back));
            match chords {
                [Some([from, to]), Some([enters, leaves])] => {
                    from.max(enters).max(0.0) < to.min(leaves)
                }
                _ => false,
            }
        };
        let n = RAYS * RAYS;
        (0..n).filter(|&ray| inside(ray)).count() as f64 / n as f64
    }

    /// The share of a face that it emits through, a number of single precision, as on the device.
    fn aperture(&self, grid: &Grid, axis: Axis, face: usize) -> f64 {
        let share = self.share(grid, axis, grid.face_at(axis, face));
        match share == 1.0 {
            true => 1.0,
            false => f64::from((self.scale * share).min(1.0) as f32),
        }
    }
}

/// Where a line from x along a unit vector enters and leaves a box, ball or cylinder, m; `None` where it misses it.
fn chord(shape: &Shape, x: DVec3, way: DVec3) -> Option<[f64; 2]> {
    // Between two planes at these heights.
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
    // Nearer than the radius to a point or an axis.
    let round = |x: DVec3, way: DVec3, radius: f64| {
        let (square, product) = (way.length_squared(), x.dot(way));
        let rest = x.length_squared() - radius * radius;
        if square < NO_COMPONENT {
            return (rest < 0.0).then_some([f64::NEG_INFINITY, f64::INFINITY]);
        }
        let root = product * product - square * rest;
        let root = (root > 0.0).then(|| root.sqrt())?;
        Some([(-product - root) / square, (-product + root) / square])
    };
    let both = |a: Option<[f64; 2]>, b: Option<[f64; 2]>| {
        let ([a, b], [c, d]) = (a?, b?);
        let [from, to] = [a.max(c), b.min(d)];
        (from < to).then_some([from, to])
    };
    match *shape {
        Shape::Box { min, max } => [0, 1, 2]
            .map(|a| between(x[a], way[a], [min[a], max[a]]))
            .into_iter()
            .reduce(both)
            .flatten(),
        Shape::Sphere { centre, radius } => round(x - centre, way, radius),
        Shape::Cylinder {
            base,
            axis,
            radius,
            height,
        } => {
            let [over, along] = [(x - base).dot(axis), way.dot(axis)];
            let flat = between(over, along, [0.0, height]);
            let across = round(x - base - over * axis, way - along * axis, radius);
            both(flat, across)
        }
        _ => None,
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
