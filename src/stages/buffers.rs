//! The fields of the liquid on the device.

use crate::Error;
use crate::effects::Effects;
use crate::geometry::CutCells;
use crate::gpu::{Buffer, BufferPlan, Compaction, Gpu, Range, Real, RealBuffer, WG_SIZE, groups};
use crate::grid::{Axis, Grid, Layout, Padded};
use crate::state::State;

use super::{Report, Tiles};

/// What a sub-step knows beyond the layout: the doppelganger of `Step` in `shaders/common/step.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Step {
    /// m/s^2
    pub gravity: [f32; 3],
    /// s
    pub dt: f32,
    /// Size of the domain, m.
    pub size: [f32; 3],
    /// m
    pub dx: f32,
    /// 1/m
    pub inv_dx: f32,
    /// Length of a frame, s.
    pub frame: f32,
    /// Liquid volume to hold, m^3.
    pub volume_0: f32,
    /// kg/m^3
    pub density: f32,
    /// Radius of the spheres around markers, cells.
    pub marker_radius: f32,
    /// Smallest theta of the ghost fluid method.
    pub theta_floor: f32,
    /// Markers in the buffer, those that are gone included.
    pub n_markers: u32,
    /// Sides of the domain that are open, [`Sides::bits`](crate::grid::Sides::bits).
    pub open_sides: u32,
}

/// What decides the sizes of [`LiquidBuffers`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LiquidPlan {
    /// The grid.
    pub grid: Grid,
    /// What the scene calls for.
    pub effects: Effects,
    /// Markers that there is room for.
    pub n_markers: usize,
    /// Cells that the fastest point crosses in a sub-step.
    pub cfl: f64,
    /// The scalar type of sums and reports.
    pub real: Real,
}

impl LiquidPlan {
    /// The uniforms that [`LiquidBuffers::new`] and the stages allocate, and the read-back of the report: `len` of each.
    pub fn small_buffers(&self) -> Vec<BufferPlan> {
        vec![
            BufferPlan::of::<Layout>("liquid.level", 1),
            BufferPlan::of::<Step>("liquid.step", 1),
            BufferPlan::of::<Tiles>("liquid.tiles", 1),
            BufferPlan::of::<Range>("compact.range", 1),
            BufferPlan::of::<u32>("liquid.report (read-back)", Report::words(&self.effects)),
        ]
    }

    /// All buffers that [`LiquidBuffers::new`] allocates, uniforms aside.
    pub fn buffers(&self) -> Vec<BufferPlan> {
        let padded = self.grid.padded();
        let tiles = self.tiles();
        let mut plans = vec![
            BufferPlan::of::<f32>("liquid.velocity", 3 * padded.len()),
            BufferPlan::of::<f32>("liquid.velocity_next", 3 * padded.len()),
            BufferPlan::of::<f32>("liquid.open", 3 * padded.len()),
            BufferPlan::of::<f32>("liquid.liquid_distance", padded.len()),
            ObstacleBuffers::plan(&self.grid, self.effects.cuts()),
            BufferPlan::of::<u32>("liquid.valid", padded.quads),
            BufferPlan::of::<u32>("liquid.valid_next", padded.quads),
            BufferPlan::of::<u32>("liquid.marks", tiles.len()),
            BufferPlan::of::<u32>("liquid.dilated", tiles.len()),
            BufferPlan::of::<u32>("liquid.band_flags", padded.quads),
            BufferPlan::of::<u32>("liquid.band_list", padded.quads),
            BufferPlan::of::<u32>("liquid.band_args", 4),
            Compaction::scratch("liquid.band_scratch", padded.quads),
            BufferPlan::of::<u32>("liquid.maxima", 2),
            BufferPlan::of::<u32>("liquid.report", Report::words(&self.effects)),
            RealBuffer::plan("liquid.partials", 4 * self.n_summing(), self.real),
        ];
        if self.effects.sources {
            plans.push(BufferPlan::of::<f32>("liquid.flux_open", 3 * padded.len()));
        }
        if self.effects.moving_obstacles {
            plans.push(BufferPlan::of::<f32>("liquid.obstacle_flux", padded.len()));
        }
        if self.effects.markers {
            plans.extend([
                BufferPlan::of::<[f32; 4]>("liquid.markers", self.n_markers),
                BufferPlan::of::<u32>("liquid.occupied", padded.quads),
                BufferPlan::of::<u32>("liquid.classes", padded.quads),
            ]);
        }
        plans
    }

    /// Threads of a reduction, each with its own share of the band: as many as fill a large device, fewer on small grids.
    pub fn n_summing(&self) -> usize {
        (self.grid.padded().quads / 8)
            .next_multiple_of(WG_SIZE as usize)
            .min(LARGEST_SUMMING)
    }

    /// The tiles of the grid.
    pub fn tiles(&self) -> Tiles {
        Tiles::new(self.grid.cells, self.cfl, self.effects.cuts())
    }
}

/// First bit of the open faces in `valid`; `common/valid.wgsl` has it too.
const OPEN: usize = 16;
/// There: slivers are in the quad, faces that are open but by less than [`SLIVER`].
const SLIVERS: u32 = 1 << 31;
/// Open fraction below which a face is one; likewise.
const SLIVER: f32 = 0.2;
/// Threads of a reduction, at most.
const LARGEST_SUMMING: usize = 16384;

/// The fields of the liquid, device layout ([`Padded`]). Made once per grid; owns no kernels.
#[derive(Debug)]
pub struct LiquidBuffers {
    /// What they were made for.
    pub plan: LiquidPlan,
    /// The layout of every field.
    pub padded: Padded,
    /// The same, for kernels.
    pub level: Buffer<Layout>,
    /// The sub-step's numbers.
    pub step: Buffer<Step>,
    /// The tiles, for kernels.
    pub tiles: Buffer<Tiles>,
    /// Face velocities after the last projection and extrapolation: x, y, z faces one after another, m/s; 0 outside the band.
    /// From `advect_velocity`, which leaves there what slivers show, to `write_back` its contents are not needed, and `liquid_distance`
    /// computes in it with obstacles.
    pub velocity: Buffer<f32>,
    /// u*: face velocities before the projection, m/s; defined on the band only. In `advect_markers` its first third is how far the surface is,
    /// m.
    pub velocity_next: Buffer<f32>,
    /// Open fractions of the faces.
    pub open: Buffer<f32>,
    /// Liquid distance at cell centres, m; + dx outside the band.
    pub liquid_distance: Buffer<f32>,
    /// Per quad, what is known of its faces: which have a velocity, which are open (`common/valid.wgsl`).
    pub valid: Buffer<u32>,
    /// The same before or after a layer of the extrapolation.
    pub valid_next: Buffer<u32>,
    /// Per tile: holds liquid. With markers zero between two runs of the stage `band`.
    pub marks: Buffer<u32>,
    /// Per tile: within reach of liquid now, and before (`common/tiles.wgsl`).
    pub dilated: Buffer<u32>,
    /// Per quad: in the band.
    pub band_flags: Buffer<u32>,
    /// Quads of the band, ascending.
    pub band_list: Buffer<u32>,
    /// Workgroups x, y, z and length of the list.
    pub band_args: Buffer<u32>,
    /// Scratch of the compaction.
    pub band_scratch: Buffer<u32>,
    /// What each thread of a reduction found, four values each.
    pub partials: RealBuffer,
    /// Largest speed and divergence, as bits of f32.
    pub maxima: Buffer<u32>,
    /// What the host reads once per step: see [`Report`].
    pub report: Buffer<u32>,
    /// The distance to the obstacles, and to solids.
    pub obstacles: ObstacleBuffers,
    /// With sources: open fractions of the fluxes, which have the apertures of sources on the faces that these hold.
    flux_open: Option<Buffer<f32>>,
    /// Where obstacles move: what they take up, J v over dx^2 per cell, m/s.
    pub obstacle_flux: Option<Buffer<f32>>,
    /// With markers only.
    pub markers: Option<MarkerBuffers>,
}

/// What the markers add.
#[derive(Debug)]
pub struct MarkerBuffers {
    /// x, y, z in m, and 1 for alive or 0 for gone: dropped, or out of the domain.
    pub positions: Buffer<[f32; 4]>,
    /// Per quad: lanes without room for liquid, lanes that hold a marker (`common/classes.wgsl`).
    pub occupied: Buffer<u32>,
    /// Per quad: what the liquid distance does with its cells (`common/classes.wgsl`).
    pub classes: Buffer<u32>,
}

impl LiquidBuffers {
    /// Allocates everything that `plan` lists.
    ///
    /// # Errors
    /// [`Error::Limit`] when the adapter does not allow a size.
    pub fn new(gpu: &Gpu, plan: LiquidPlan) -> Result<LiquidBuffers, Error> {
        let plans = plan.buffers();
        let maker = Maker { gpu, plans: &plans };
        let padded = plan.grid.padded();
        let zero: Step = bytemuck::Zeroable::zeroed();
        Ok(LiquidBuffers {
            plan,
            padded,
            level: gpu.uniform("liquid.level", &padded.layout())?,
            step: gpu.uniform("liquid.step", &zero)?,
            tiles: gpu.uniform("liquid.tiles", &plan.tiles())?,
            velocity: maker.make("liquid.velocity")?,
            velocity_next: maker.make("liquid.velocity_next")?,
            open: maker.make("liquid.open")?,
            liquid_distance: maker.make("liquid.liquid_distance")?,
            valid: maker.make("liquid.valid")?,
            valid_next: maker.make("liquid.valid_next")?,
            marks: maker.make("liquid.marks")?,
            dilated: maker.make("liquid.dilated")?,
            band_flags: maker.make("liquid.band_flags")?,
            band_list: maker.make("liquid.band_list")?,
            band_args: maker.make("liquid.band_args")?,
            band_scratch: maker.make("liquid.band_scratch")?,
            partials: maker.make_real("liquid.partials", plan.real)?,
            maxima: maker.make("liquid.maxima")?,
            report: maker.make("liquid.report")?,
            obstacles: ObstacleBuffers::new(gpu, &plan.grid, plan.effects.cuts())?,
            flux_open: plan
                .effects
                .sources
                .then(|| maker.make("liquid.flux_open"))
                .transpose()?,
            obstacle_flux: plan
                .effects
                .moving_obstacles
                .then(|| maker.make("liquid.obstacle_flux"))
                .transpose()?,
            markers: plan
                .effects
                .markers
                .then(|| {
                    Ok::<_, Error>(MarkerBuffers {
                        positions: maker.make("liquid.markers")?,
                        occupied: maker.make("liquid.occupied")?,
                        classes: maker.make("liquid.classes")?,
                    })
                })
                .transpose()?,
        })
    }
}

impl LiquidBuffers {
    /// Open fractions of the fluxes: those of all faces, with the apertures of sources on faces that these hold.
    pub fn flux_open(&self) -> &Buffer<f32> {
        self.flux_open.as_ref().unwrap_or(&self.open)
    }
}

/// Where obstacles are: for solids; for liquid, where solids are too.
#[derive(Debug)]
pub struct ObstacleBuffers {
    grid: Grid,
    present: bool,
    /// Signed distance of cell centres to the obstacles, m; negative inside, device layout. Without obstacles one quad, far from
    /// any.
    pub solid_distance: Buffer<f32>,
}

impl ObstacleBuffers {
    /// What [`ObstacleBuffers::new`] allocates. `present`: whether there are obstacles.
    pub fn plan(grid: &Grid, present: bool) -> BufferPlan {
        let len = if present { grid.padded().len() } else { 4 };
        BufferPlan::of::<f32>("obstacles.solid_distance", len)
    }

    /// Allocates.
    ///
    /// # Errors
    /// [`Error::Limit`] when the adapter does not allow the size.
    pub fn new(gpu: &Gpu, grid: &Grid, present: bool) -> Result<ObstacleBuffers, Error> {
        let plan = ObstacleBuffers::plan(grid, present);
        Ok(ObstacleBuffers {
            grid: *grid,
            present,
            solid_distance: gpu.buffer(plan.label, plan.len)?,
        })
    }

    /// Writes the distance, before all work submitted later. Also due without obstacles.
    pub fn write(&self, gpu: &Gpu, cut: &CutCells) {
        let Grid { cells, dx } = self.grid;
        let distance = match self.present {
            true => self
                .grid
                .padded()
                .pad(cells, &cut.solid_distance, |d| d as f32),
            false => vec![3.0 * dx as f32; 4],
        };
        gpu.upload(&self.solid_distance, &distance);
    }
}

/// Makes buffers with the sizes of the plan.
pub(super) struct Maker<'a> {
    pub(super) gpu: &'a Gpu,
    pub(super) plans: &'a [BufferPlan],
}

impl Maker<'_> {
    fn plan(&self, label: &str, element: usize) -> &BufferPlan {
        let plan = self
            .plans
            .iter()
            .find(|plan| plan.label == label)
            .unwrap_or_else(|| panic!("{label} is not planned"));
        assert_eq!(plan.element, element, "{label}: element size");
        plan
    }

    pub(super) fn make<T: bytemuck::Pod>(&self, label: &str) -> Result<Buffer<T>, Error> {
        self.gpu.buffer(label, self.plan(label, size_of::<T>()).len)
    }

    pub(super) fn make_real(&self, label: &str, real: Real) -> Result<RealBuffer, Error> {
        RealBuffer::new(self.gpu, label, self.plan(label, real.bytes()).len, real)
    }
}

impl LiquidBuffers {
    /// Writes what obstacles and solids leave of the grid, before all work submitted later. Also due without any.
    pub fn write_cut_cells(&self, gpu: &Gpu, cut: &CutCells) {
        let open = self.pad_faces(&cut.open);
        gpu.upload(&self.open, &open);
        let mut valid = vec![0; self.padded.quads];
        for (quad, word) in valid.iter_mut().enumerate() {
            for bit in 0..12 {
                let face = 4 * (bit / 4 * self.padded.quads + quad) + bit % 4;
                *word |= u32::from(open[face] > 0.0) << (OPEN + bit);
                if open[face] > 0.0 && open[face] < SLIVER {
                    *word |= SLIVERS;
                }
            }
        }
        gpu.upload(&self.valid, &valid);
        self.obstacles.write(gpu, cut);
        let grid = &self.plan.grid;
        if let Some(markers) = &self.markers {
            // A lane has room where its cell exists and its centre is outside every solid.
            let room = self
                .padded
                .pad(grid.cells, &cut.solid_distance, |d| d >= 0.0);
            let no_room = |lanes: &[bool]| {
                (0..4).fold(0, |bits, lane| bits | u32::from(!lanes[lane]) << lane)
            };
            let occupied: Vec<u32> = room.chunks_exact(4).map(no_room).collect();
            gpu.upload(&markers.occupied, &occupied);
        }
    }

    /// Writes velocities, markers and liquid distance of a state, before all work submitted later.
    ///
    /// # Panics
    /// When the state holds more markers than were planned.
    pub fn write_state(&self, gpu: &Gpu, state: &State) {
        let grid = &self.plan.grid;
        gpu.upload(&self.velocity, &self.pad_faces(&state.velocity));
        let mut distance = vec![grid.dx as f32; self.padded.len()];
        for (cell, &phi) in state.liquid_distance.iter().enumerate() {
            distance[self.padded.index(grid.cell_at(cell))] = phi as f32;
        }
        gpu.upload(&self.liquid_distance, &distance);
        // As if all tiles had been in the band: what is not in the next one is put back to air.
        gpu.upload(&self.dilated, &vec![1; self.dilated.len()]);
        let slab = self.padded.stride_z;
        let mut flags = vec![0; self.padded.quads];
        let quads = slab..slab * (grid.cells[2] + 2);
        flags[quads.clone()].fill(1);
        gpu.upload(&self.band_flags, &flags);
        let list: Vec<u32> = quads.map(|quad| quad as u32).collect();
        let n = list.len() as u32;
        let [x, y, z] = groups(n.div_ceil(WG_SIZE));
        gpu.upload(&self.band_list, &list);
        gpu.upload(&self.band_args, &[x, y, z, n]);
        if let Some(markers) = &self.markers {
            let alive = state
                .markers
                .iter()
                .map(|x| [x[0] as f32, x[1] as f32, x[2] as f32, 1.0]);
            let mut positions: Vec<[f32; 4]> = alive.collect();
            positions.resize(positions.len().max(markers.positions.len()), [0.0; 4]);
            gpu.upload(&markers.positions, &positions);
        } else {
            // The liquid stays where it is, so the tiles that hold it are known.
            let tiles = self.plan.tiles();
            let mut marks = vec![0; tiles.len()];
            for (cell, _) in state
                .liquid_distance
                .iter()
                .enumerate()
                .filter(|(_, phi)| **phi < 0.0)
            {
                marks[tiles.of(grid.cell_at(cell))] = 1;
            }
            gpu.upload(&self.marks, &marks);
        }
        gpu.upload(&self.report, &vec![0; self.report.len()]);
    }

    /// Waits for all submitted work and reads velocities, markers (those that are gone left out) and liquid distance into a state.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails.
    pub fn read_state(&self, gpu: &Gpu, n_markers: usize, state: &mut State) -> Result<(), Error> {
        state.velocity = self.read_faces(gpu, &self.velocity)?;
        state.liquid_distance = self.padded.unpad(
            self.plan.grid.cells,
            &gpu.download(&self.liquid_distance)?,
            f64::from,
        );
        if let Some(markers) = &self.markers {
            let positions = gpu.download(&markers.positions)?;
            state.markers = positions[..n_markers]
                .iter()
                .filter(|marker| marker[3] != 0.0)
                .map(|&[x, y, z, _]| [x, y, z].map(f64::from))
                .collect();
        }
        Ok(())
    }

    /// Waits for all submitted work and reads a face field as host arrays per axis.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails.
    pub fn read_faces(&self, gpu: &Gpu, faces: &Buffer<f32>) -> Result<[Vec<f64>; 3], Error> {
        let device = gpu.download(faces)?;
        let len = self.padded.len();
        Ok(Axis::ALL.map(|axis| {
            let field = &device[axis.index() * len..][..len];
            self.padded
                .unpad(self.plan.grid.faces(axis), field, f64::from)
        }))
    }

    /// A face field in the device layout.
    pub fn pad_faces(&self, faces: &[Vec<f64>; 3]) -> Vec<f32> {
        Axis::ALL
            .iter()
            .flat_map(|&axis| {
                let values = &faces[axis.index()];
                self.padded
                    .pad(self.plan.grid.faces(axis), values, |v| v as f32)
            })
            .collect()
    }
}
