//! Sources and sinks.

use crate::Error;
use crate::arrays;
use crate::geometry::{PER_CELL, Running, SourceFace, Taps};
use crate::gpu::Gpu;
use crate::grid::Grid;

use super::LiquidBuffers;

/// A box of cells around a source or a sink: the doppelganger of `Region` in `shaders/common/region.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Region {
    /// Its low corner.
    pub low: [u32; 3],
    /// Its first word.
    pub first: u32,
    /// Cells along x, y, z.
    pub n: [u32; 3],
    /// Number of the source.
    pub number: u32,
}

/// What the sources do in a sub-step: the doppelganger of `SourceStep` in `shaders/common/source_step.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct SourceStep {
    /// Those that run.
    pub running: u32,
    /// Those of them that did not in the sub-step before.
    pub starting: u32,
    /// First slot for new markers.
    pub first: u32,
    /// Of the jitter.
    pub seed: u32,
    /// Of the sub-step.
    pub number: u32,
    /// Nothing.
    pub pad_0: u32,
    /// Nothing.
    pub pad_1: u32,
    /// Nothing.
    pub pad_2: u32,
}

impl SourceStep {
    /// With new markers from a slot on.
    pub fn new(of: Running, first: usize) -> SourceStep {
        let Running {
            running,
            starting,
            seed,
            step,
        } = of;
        SourceStep {
            running,
            starting,
            first: first as u32,
            seed,
            number: step,
            ..SourceStep::default()
        }
    }
}

/// A face of a cell of a source: the doppelganger of `SourceFace` in `shaders/common/source_face.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct DeviceSourceFace {
    /// Index among the faces of all axes, device layout.
    pub face: u32,
    /// Sources of the cells on its minus side (low byte) and on its plus side; 255 for none.
    pub sides: u32,
    /// Velocity of the first along the axis, m/s.
    pub minus: f32,
    /// Of the second.
    pub plus: f32,
    /// Share of the face that the first emits through where the second is no source.
    pub minus_aperture: f32,
    /// The second where the first is none.
    pub plus_aperture: f32,
    /// Nothing.
    pub pad_0: u32,
    /// Nothing.
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

/// Boxes around sets of cells, and a word for each of their cells: the value of those in the set, else 0.
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

/// The cells of sinks in one box.
fn sink_boxes(grid: &Grid, taps: &Taps) -> (Vec<Region>, Vec<u32>) {
    let cells = taps.sink_cells.iter().map(|&cell| (cell, 1));
    boxes(grid, &[(0, cells.collect())])
}

/// The cells of each source in a box, with their numbers from 1.
fn source_boxes(grid: &Grid, taps: &Taps) -> (Vec<Region>, Vec<u32>) {
    let mut sets: Vec<(u32, Vec<(usize, u32)>)> = Vec::new();
    for (&(cell, source), number) in taps.source_cells.iter().zip(1..) {
        match sets.iter_mut().find(|(of, _)| *of == source) {
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
        fields {
            boxes: (Vec<Region>, Vec<u32>),
            cells_of_sinks: Vec<u32>,
        }
        arrays {
            /// Boxes around the sinks.
            array regions: Region [boxes.0.len()],
            /// Per cell of the boxes: 1 in a sink.
            array map: u32 [boxes.1.len()],
            /// Cells of the sinks, padded indices.
            pub(crate) array cells: u32 [cells_of_sinks.len()],
        }
        views {}
        parts {}
    }
}

impl Sinks {
    /// Allocates and writes the cells; `None` without sinks.
    ///
    /// # Errors
    /// [`Error::Limit`] when the adapter is too small.
    pub fn new(gpu: &Gpu, liquid: &LiquidBuffers, taps: &Taps) -> Result<Option<Sinks>, Error> {
        if liquid.markers.is_none() || taps.sink_cells.is_empty() {
            return Ok(None);
        }
        let grid = &liquid.plan.grid;
        let index = |&cell: &usize| liquid.padded.index(grid.cell_at(cell)) as u32;
        let cells = taps.sink_cells.iter().map(index).collect();
        let sinks = Sinks::allocate(gpu, sink_boxes(grid, taps), cells)?;
        gpu.upload(&sinks.regions, &sinks.boxes.0);
        gpu.upload(&sinks.map, &sinks.boxes.1);
        gpu.upload(&sinks.cells, &sinks.cells_of_sinks);
        Ok(Some(sinks))
    }
}

arrays! {
    /// Sources: their cells are full of liquid that moves with the prescribed velocity.
    pub struct Sources in "sources" {
        fields {
            boxes: (Vec<Region>, Vec<u32>),
            n_cells: usize,
            pub(crate) n_faces: usize,
        }
        arrays {
            /// Parameters of the sub-step.
            uniform source_step: SourceStep [SourceStep::default()] as "sources.step",
            /// Boxes around the sources.
            array regions: Region [boxes.0.len()],
            /// Per cell of the boxes: number of the source's cell from 1, 0 outside.
            array map: u32 [boxes.1.len()],
            /// Cells of the sources: i, j, k, and the source with the eighths to seed.
            array cells: [u32; 4] [n_cells],
            /// Markers per cell of the sources, then the first new slot of each.
            pub(crate) array counts: u32 [n_cells],
            /// Faces with prescribed flux.
            array faces: DeviceSourceFace [n_faces],
        }
        views {
            // In the scan.
            chunks = counts,
            // After it.
            starts = counts,
        }
        parts {}
    }
}

impl Sources {
    /// Allocates and writes cells and faces; `None` without sources.
    ///
    /// # Errors
    /// [`Error::Limit`] when the adapter is too small.
    pub fn new(gpu: &Gpu, liquid: &LiquidBuffers, taps: &Taps) -> Result<Option<Sources>, Error> {
        if liquid.markers.is_none() || taps.source_cells.is_empty() {
            return Ok(None);
        }
        let grid = &liquid.plan.grid;
        let cells = taps.source_cells.iter().zip(&taps.eighths);
        let cells = cells.map(|(&(cell, source), &eighths)| {
            let [i, j, k] = grid.cell_at(cell).map(|n| n as u32);
            [i, j, k, source | u32::from(eighths) << 8]
        });
        let faces = taps
            .faces
            .iter()
            .map(|face| DeviceSourceFace::new(grid, face));
        let boxes = source_boxes(grid, taps);
        let sources = Sources::allocate(gpu, boxes, taps.source_cells.len(), taps.faces.len())?;
        gpu.upload(&sources.regions, &sources.boxes.0);
        gpu.upload(&sources.map, &sources.boxes.1);
        gpu.upload(&sources.cells, &cells.collect::<Vec<_>>());
        gpu.upload(&sources.faces, &faces.collect::<Vec<_>>());
        Ok(Some(sources))
    }

    /// Slots that a sub-step reserves for new markers.
    pub fn slots(&self) -> usize {
        PER_CELL * self.n_cells
    }

    /// Writes the parameters of a sub-step.
    pub fn write_step(&self, gpu: &Gpu, step: SourceStep) {
        gpu.upload(&self.source_step, &[step]);
    }
}
