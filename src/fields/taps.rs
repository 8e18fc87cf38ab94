//! Sources and sinks.

use crate::Error;
use crate::arrays;
use crate::geometry::{Lattice, MARKERS_PER_CELL, MOST_SITES, Running, SourceFace, SourcesAndSinks};
use crate::gpu::Gpu;
use crate::grid::Grid;

use super::LiquidBuffers;

/// A box of cells around a source or a sink.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Region {
    /// Low corner, cells.
    pub low: [u32; 3],
    /// Index of the box's first word.
    pub first: u32,
    /// Cells along x, y, z.
    pub n: [u32; 3],
    /// Number of the source.
    pub number: u32,
}

/// State of the sources in a sub-step.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct SourceStep {
    /// Bits of the running sources.
    pub running: u32,
    /// Bits of the running sources that did not run in the last sub-step.
    pub starting: u32,
    /// First slot for new markers.
    pub first: u32,
    /// Seed of the jitter.
    pub seed: u32,
    /// Number of the sub-step.
    pub number: u32,
    /// Padding.
    pub pad_0: u32,
    /// Padding.
    pub pad_1: u32,
    /// Padding.
    pub pad_2: u32,
}

impl SourceStep {
    /// The state of running sources; their new markers start at slot `first`.
    pub fn new(sources: Running, first: usize) -> SourceStep {
        let Running { running, starting, seed, step } = sources;
        SourceStep { running, starting, first: first as u32, seed, number: step, ..SourceStep::default() }
    }
}

/// A face of a source cell.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct DeviceSourceFace {
    /// Index among the faces of all axes, device layout.
    pub face: u32,
    /// Sources of the cells on the minus side (low byte) and on the plus side; 255 for none.
    pub sides: u32,
    /// Velocity of the minus-side source along the axis, m/s.
    pub minus: f32,
    /// Velocity of the plus-side source along the axis, m/s.
    pub plus: f32,
    /// Aperture through which the minus-side source emits where the plus side is no source.
    pub minus_aperture: f32,
    /// Aperture through which the plus-side source emits where the minus side is no source.
    pub plus_aperture: f32,
    /// Padding.
    pub pad_0: u32,
    /// Padding.
    pub pad_1: u32,
}

impl DeviceSourceFace {
    fn new(grid: &Grid, face: &SourceFace) -> DeviceSourceFace {
        let padded = grid.padded();
        let at = padded.index(grid.face_at(face.axis, face.face));
        let [minus, plus] = face.sides.map(|side| side.unwrap_or(255));
        DeviceSourceFace {
            face: (face.axis.index() * padded.len() + at) as u32,
            sides: minus | plus << 8,
            minus: face.velocity[0] as f32,
            plus: face.velocity[1] as f32,
            minus_aperture: face.aperture[0] as f32,
            plus_aperture: face.aperture[1] as f32,
            ..DeviceSourceFace::default()
        }
    }
}

/// Boxes around sets of cells. Each cell of a box has a word: the value of a cell in the set, else 0.
fn boxes(grid: &Grid, sets: &[(u32, Vec<(usize, u32)>)]) -> (Vec<Region>, Vec<u32>) {
    let (mut regions, mut map) = (Vec::new(), Vec::new());
    for (number, cells) in sets.iter().filter(|(_, cells)| !cells.is_empty()) {
        let at = || cells.iter().map(|&(cell, _)| grid.cell_at(cell));
        let low: [usize; 3] = [0, 1, 2].map(|a| at().map(|at| at[a]).min().unwrap_or(0));
        let n = [0, 1, 2].map(|a| at().map(|at| at[a] + 1 - low[a]).max().unwrap_or(0));
        let first = map.len();
        map.resize(first + n.iter().product::<usize>(), 0);
        for &(cell, value) in cells {
            let [i, j, k] = std::array::from_fn(|a| grid.cell_at(cell)[a] - low[a]);
            map[first + i + n[0] * (j + n[1] * k)] = value;
        }
        regions.push(Region {
            low: low.map(|n| n as u32),
            first: first as u32,
            n: n.map(|n| n as u32),
            number: *number,
        });
    }
    (regions, map)
}

fn device_faces(grid: &Grid, taps: &SourcesAndSinks) -> Vec<DeviceSourceFace> {
    taps.faces.iter().map(|face| DeviceSourceFace::new(grid, face)).collect()
}

/// One box around the cells of all sinks.
fn sink_boxes(grid: &Grid, taps: &SourcesAndSinks) -> (Vec<Region>, Vec<u32>) {
    let cells = taps.sink_cells.iter().map(|&cell| (cell, 1));
    boxes(grid, &[(0, cells.collect())])
}

/// One box per source. The words number its cells from 1.
fn source_boxes(grid: &Grid, taps: &SourcesAndSinks) -> (Vec<Region>, Vec<u32>) {
    let mut sets: Vec<(u32, Vec<(usize, u32)>)> = Vec::new();
    for (&(cell, source), number) in taps.source_cells.iter().zip(1..) {
        match sets.iter_mut().find(|(number, _)| *number == source) {
            Some((_, cells)) => cells.push((cell, number)),
            None => sets.push((source, vec![(cell, number)])),
        }
    }
    sets.sort_by_key(|(source, _)| *source);
    boxes(grid, &sets)
}

arrays! {
    /// Sinks: their cells are air, and markers in them are deleted.
    pub struct Sinks in "sinks" {
        fields {}
        sizes {
            n_regions: usize,
            n_words: usize,
            n_cells: usize,
        }
        arrays {
            /// Box around the sinks.
            array regions: Region [n_regions],
            /// Per cell of the boxes: 1 in a sink.
            array map: u32 [n_words],
            /// Cells of the sinks, padded indices.
            pub(crate) array cells: u32 [n_cells],
        }
        views {}
        parts {}
    }
}

impl Sinks {
    /// Allocates and writes the cells. Returns `None` without sinks.
    pub fn new(gpu: &Gpu, liquid: &LiquidBuffers, taps: &SourcesAndSinks) -> Result<Option<Sinks>, Error> {
        if liquid.markers.is_none() || taps.sink_cells.is_empty() {
            return Ok(None);
        }
        let grid = &liquid.plan.grid;
        let index = |&cell: &usize| liquid.padded.index(grid.cell_at(cell)) as u32;
        let cells: Vec<u32> = taps.sink_cells.iter().map(index).collect();
        let (regions, map) = sink_boxes(grid, taps);
        let sinks = Sinks::allocate(gpu, regions.len(), map.len(), cells.len())?;
        gpu.upload(&sinks.regions, &regions);
        gpu.upload(&sinks.map, &map);
        gpu.upload(&sinks.cells, &cells);
        Ok(Some(sinks))
    }
}

arrays! {
    /// Sources: their cells are full of liquid at the prescribed velocity.
    pub struct Sources in "sources" {
        fields {
            n_cells: usize,
            pub(crate) n_faces: usize,
        }
        sizes {
            n_regions: usize,
            n_words: usize,
            n_lattices: usize,
        }
        arrays {
            /// Parameters of the sub-step.
            uniform source_step: SourceStep [SourceStep::default()] as "sources.step",
            /// Boxes around the sources.
            array regions: Region [n_regions],
            /// Per cell of the boxes: index of the source cell from 1, 0 outside.
            array map: u32 [n_words],
            /// Source cells: i, j, k, and the source with bits of the eighths to seed.
            array cells: [u32; 4] [n_cells],
            /// With a level: the lattice of each source ([`Lattice`]), its displacement in whole octants, the rest, and that of the sub-step.
            array lattices: [[i32; 4]; 3] [n_lattices] if n_lattices > 0,
            /// Markers per source cell, with a level new ones, then the first new slot of each.
            pub(crate) array counts: u32 [n_cells],
            /// Faces with prescribed flux.
            array faces: DeviceSourceFace [n_faces],
        }
        views {
            // During the scan.
            chunks = counts,
            // After the scan.
            starts = counts,
        }
        parts {}
    }
}

impl Sources {
    /// Allocates and writes cells and faces. Returns `None` without sources.
    pub fn new(gpu: &Gpu, liquid: &LiquidBuffers, taps: &SourcesAndSinks) -> Result<Option<Sources>, Error> {
        if liquid.markers.is_none() || taps.source_cells.is_empty() {
            return Ok(None);
        }
        let grid = &liquid.plan.grid;
        let cells = taps.source_cells.iter().zip(&taps.eighths);
        let cells = cells.map(|(&(cell, source), &eighths)| {
            let [i, j, k] = grid.cell_at(cell).map(|n| n as u32);
            [i, j, k, source | u32::from(eighths) << 8]
        });
        let (regions, map) = source_boxes(grid, taps);
        let (n_cells, n_faces) = (taps.source_cells.len(), taps.faces.len());
        let n_lattices = match liquid.plan.effects.level {
            true => taps.n_sources(),
            false => 0,
        };
        let sources = Sources::allocate(gpu, n_cells, n_faces, regions.len(), map.len(), n_lattices)?;
        gpu.upload(&sources.regions, &regions);
        gpu.upload(&sources.map, &map);
        gpu.upload(&sources.cells, &cells.collect::<Vec<_>>());
        gpu.upload(&sources.faces, &device_faces(grid, taps));
        Ok(Some(sources))
    }

    /// Writes the velocities of a sub-step.
    pub fn write_velocities(&self, gpu: &Gpu, grid: &Grid, taps: &SourcesAndSinks) {
        gpu.upload(&self.faces, &device_faces(grid, taps));
    }

    /// Number of source cells.
    pub fn n_cells(&self) -> usize {
        self.n_cells
    }

    /// Slots that a sub-step reserves for new markers.
    pub fn slots(&self) -> usize {
        match self.lattices {
            Some(_) => MOST_SITES * self.n_cells,
            None => MARKERS_PER_CELL * self.n_cells,
        }
    }

    /// Writes the parameters of a sub-step. `lattices`: of each source, with a level.
    pub fn write_step(&self, gpu: &Gpu, step: SourceStep, lattices: &[Lattice]) {
        gpu.upload(&self.source_step, &[step]);
        if let Some(array) = &self.lattices {
            let words = |[x, y, z]: [i32; 3]| [x, y, z, 0];
            let lattice = |of: &Lattice| [of.whole, of.rest, of.moved].map(words);
            gpu.upload(array, &lattices.iter().map(lattice).collect::<Vec<_>>());
        }
    }
}
