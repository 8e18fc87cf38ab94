//! `exchange`: sinks take markers away, sources make some; and what both do within other stages.

use crate::Error;
use crate::geometry::{PER_CELL, Running, SourceFace, Taps};
use crate::gpu::{Bound, Buffer, BufferPlan, Gpu, Kernel, Real, Recorder};
use crate::grid::Grid;
use crate::wgsl;

use super::{Forces, LiquidBuffers, WriteBack};

/// The stage's name, of [`Sinks`] and of [`Sources`].
pub const EXCHANGE: &str = "exchange";

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

/// What [`Sinks::new`] and [`Sources::new`] allocate for a scene with these.
pub fn tap_buffers(grid: &Grid, taps: &Taps) -> Vec<BufferPlan> {
    let mut plans = Vec::new();
    if !taps.sink_cells.is_empty() {
        let (regions, map) = sink_boxes(grid, taps);
        plans.extend([
            BufferPlan::of::<Region>("sinks.regions", regions.len()),
            BufferPlan::of::<u32>("sinks.map", map.len()),
            BufferPlan::of::<u32>("sinks.cells", taps.sink_cells.len()),
        ]);
    }
    if !taps.source_cells.is_empty() {
        let (regions, map) = source_boxes(grid, taps);
        let n_cells = taps.source_cells.len();
        plans.extend([
            BufferPlan::of::<SourceStep>("sources.step", 1),
            BufferPlan::of::<Region>("sources.regions", regions.len()),
            BufferPlan::of::<u32>("sources.map", map.len()),
            BufferPlan::of::<[u32; 4]>("sources.cells", n_cells),
            BufferPlan::of::<u32>("sources.counts", n_cells),
            BufferPlan::of::<DeviceSourceFace>("sources.faces", taps.faces.len()),
            BufferPlan::of::<f32>("sources.open", 3 * grid.padded().len()),
        ]);
    }
    plans
}

/// Sinks: markers in their cells are gone, and the cells are air.
#[derive(Debug)]
pub struct Sinks {
    n_markers: usize,
    n_cells: usize,
    sink_markers: Bound,
    empty_sinks: Bound,
}

impl Sinks {
    /// Allocates, compiles and binds; `None` without sinks.
    ///
    /// # Errors
    /// [`Error::Limit`] when the adapter is too small; as [`Kernel::new`] and [`Kernel::bind`].
    pub fn new(gpu: &Gpu, buffers: &LiquidBuffers, taps: &Taps) -> Result<Option<Sinks>, Error> {
        let Some(markers) = buffers
            .markers
            .as_ref()
            .filter(|_| !taps.sink_cells.is_empty())
        else {
            return Ok(None);
        };
        let grid = &buffers.plan.grid;
        let (regions, map) = sink_boxes(grid, taps);
        let index = |&cell: &usize| buffers.padded.index(grid.cell_at(cell)) as u32;
        let cells: Vec<u32> = taps.sink_cells.iter().map(index).collect();
        let regions = gpu.buffer_with("sinks.regions", &regions)?;
        let map = gpu.buffer_with("sinks.map", &map)?;
        let cells = gpu.buffer_with("sinks.cells", &cells)?;
        let step = ("step", (&buffers.step).into());
        Ok(Some(Sinks {
            n_markers: markers.positions.len(),
            n_cells: cells.len(),
            sink_markers: Kernel::new(gpu, &wgsl!("sink_markers"), Real::F32)?.bind(
                gpu,
                &[
                    ("level", (&buffers.level).into()),
                    step,
                    ("regions", (&regions).into()),
                    ("map", (&map).into()),
                    ("markers", (&markers.positions).into()),
                    ("report", (&buffers.report).into()),
                ],
            )?,
            empty_sinks: Kernel::new(gpu, &wgsl!("empty_sinks"), Real::F32)?.bind(
                gpu,
                &[
                    step,
                    ("cells", (&cells).into()),
                    ("liquid_distance", (&buffers.liquid_distance).into()),
                ],
            )?,
        }))
    }

    /// Records what it does to markers, after they have moved.
    pub fn record(&self, recorder: &mut Recorder) {
        recorder.stage(EXCHANGE, |pass| {
            pass.dispatch(&self.sink_markers, self.n_markers)
        });
    }

    /// Within `liquid_distance`, before the volume is measured.
    pub(super) fn empty(&self, pass: &mut crate::gpu::Pass) {
        pass.dispatch(&self.empty_sinks, self.n_cells);
    }
}

/// Sources: their cells are full of liquid that moves as they say.
#[derive(Debug)]
pub struct Sources {
    n_markers: usize,
    n_cells: usize,
    n_faces: usize,
    /// Open fractions for the pressure: those of all faces, 0 where sources hold one.
    pub open: Buffer<f32>,
    step: Buffer<SourceStep>,
    counts: Buffer<u32>,
    count_in_sources: Bound,
    plan_seeds: Bound,
    seed_markers: Bound,
    hold_faces: Bound,
    carry_faces: Bound,
}

impl Sources {
    /// Allocates, compiles and binds; `None` without sources.
    ///
    /// # Errors
    /// [`Error::Limit`] when the adapter is too small; as [`Kernel::new`] and [`Kernel::bind`].
    pub fn new(gpu: &Gpu, buffers: &LiquidBuffers, taps: &Taps) -> Result<Option<Sources>, Error> {
        let with_sources = buffers
            .markers
            .as_ref()
            .filter(|_| !taps.source_cells.is_empty());
        let Some(markers) = with_sources else {
            return Ok(None);
        };
        let grid = &buffers.plan.grid;
        let (regions, map) = source_boxes(grid, taps);
        let cells = taps.source_cells.iter().zip(&taps.eighths);
        let cells = cells.map(|(&(cell, source), &eighths)| {
            let [i, j, k] = grid.cell_at(cell).map(|n| n as u32);
            [i, j, k, source | u32::from(eighths) << 8]
        });
        let faces = taps
            .faces
            .iter()
            .map(|face| DeviceSourceFace::new(grid, face));
        let step = gpu.uniform("sources.step", &SourceStep::default())?;
        let regions = gpu.buffer_with("sources.regions", &regions)?;
        let map = gpu.buffer_with("sources.map", &map)?;
        let cells = gpu.buffer_with("sources.cells", &cells.collect::<Vec<[u32; 4]>>())?;
        let counts = gpu.buffer("sources.counts", cells.len())?;
        let faces = gpu.buffer_with("sources.faces", &faces.collect::<Vec<DeviceSourceFace>>())?;
        let open = gpu.buffer("sources.open", 3 * buffers.padded.len())?;
        let kernel = |source| Kernel::new(gpu, &source, Real::F32);
        let level = ("level", (&buffers.level).into());
        let of_step = ("step", (&buffers.step).into());
        let source_step = ("source_step", (&step).into());
        let positions = ("markers", (&markers.positions).into());
        let report = ("report", (&buffers.report).into());
        let of_faces = ("faces", (&faces).into());
        let of_open = ("open", (&buffers.open).into());
        let valid = ("valid", (&buffers.valid).into());
        Ok(Some(Sources {
            n_markers: markers.positions.len(),
            n_cells: cells.len(),
            n_faces: faces.len(),
            count_in_sources: kernel(wgsl!("count_in_sources"))?.bind(
                gpu,
                &[
                    level,
                    of_step,
                    source_step,
                    ("regions", (&regions).into()),
                    ("map", (&map).into()),
                    ("cells", (&cells).into()),
                    positions,
                    ("counts", (&counts).into()),
                ],
            )?,
            plan_seeds: kernel(wgsl!("plan_seeds"))?.bind(
                gpu,
                &[
                    level,
                    source_step,
                    ("cells", (&cells).into()),
                    ("solid_distance", (&buffers.obstacles.solid_distance).into()),
                    ("chunks", (&counts).into()),
                    report,
                ],
            )?,
            seed_markers: kernel(wgsl!("seed_markers"))?.bind(
                gpu,
                &[
                    level,
                    of_step,
                    source_step,
                    ("cells", (&cells).into()),
                    ("starts", (&counts).into()),
                    report,
                    positions,
                ],
            )?,
            hold_faces: kernel(wgsl!("hold_faces"))?.bind(
                gpu,
                &[
                    level,
                    source_step,
                    of_faces,
                    of_open,
                    ("held_open", (&open).into()),
                    ("flux_open", buffers.flux_open().into()),
                    valid,
                    ("velocity_next", (&buffers.velocity_next).into()),
                ],
            )?,
            carry_faces: kernel(wgsl!("carry_faces"))?.bind(
                gpu,
                &[
                    level,
                    source_step,
                    of_faces,
                    of_open,
                    valid,
                    ("velocity", (&buffers.velocity).into()),
                ],
            )?,
            open,
            step,
            counts,
        }))
    }

    /// Slots that a sub-step keeps for new markers.
    pub fn slots(&self) -> usize {
        PER_CELL * self.n_cells
    }

    /// Tells the kernels what the sources do in a sub-step.
    pub fn write_step(&self, gpu: &Gpu, step: SourceStep) {
        gpu.upload(&self.step, &[step]);
    }

    /// Records the new markers, once all others have moved or are gone.
    pub fn record(&self, recorder: &mut Recorder) {
        recorder.clear(&self.counts);
        recorder.stage(EXCHANGE, |pass| {
            pass.dispatch(&self.count_in_sources, self.n_markers);
            pass.dispatch(&self.plan_seeds, 1);
            pass.dispatch(&self.seed_markers, PER_CELL * self.n_cells);
        });
    }

    /// Records the faces that sources hold, once all forces have acted.
    pub fn record_hold(&self, recorder: &mut Recorder, buffers: &LiquidBuffers) {
        recorder.copy(&buffers.open, &self.open);
        recorder.copy(&buffers.open, buffers.flux_open());
        recorder.stage(Forces::NAME, |pass| {
            pass.dispatch(&self.hold_faces, self.n_faces)
        });
    }

    /// Records the velocities of those faces, after `write_back`.
    pub fn record_carry(&self, recorder: &mut Recorder) {
        recorder.stage(WriteBack::NAME, |pass| {
            pass.dispatch(&self.carry_faces, self.n_faces)
        });
    }
}
