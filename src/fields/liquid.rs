//! The fields of the liquid on the device.

use crate::Error;
use crate::arrays;
use crate::effects::Effects;
use crate::geometry::CutCells;
use crate::gpu::{Buffer, Compaction, Gpu, Real, WG_SIZE, groups};
use crate::grid::{Axis, Grid, Layout, Padded};
use crate::scene::SLIVER;
use crate::state::State;

use super::Report;

/// Parameters of a sub-step.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Step {
    /// Gravity, m/s^2.
    pub gravity: [f32; 3],
    /// Length of the sub-step, s.
    pub dt: f32,
    /// Size of the domain, m.
    pub size: [f32; 3],
    /// Cell width, m.
    pub dx: f32,
    /// Inverse of the cell width, 1/m.
    pub inv_dx: f32,
    /// Time over which volume is controlled, s.
    pub control_time: f32,
    /// Controlled liquid volume, m^3.
    pub volume_0: f32,
    /// Density, kg/m^3.
    pub density: f32,
    /// Radius of the spheres around markers, cells.
    pub marker_radius: f32,
    /// Markers in the buffer, including deleted ones.
    pub n_markers: u32,
    /// Open sides of the domain, as [`Sides::bits`](crate::grid::Sides::bits).
    pub open_sides: u32,
    /// Largest slope of the velocity beyond a level, as [`TimeStep::largest_slope`](crate::reference::TimeStep::largest_slope), m/s.
    pub largest_slope: f32,
}

/// Sizes of [`LiquidBuffers`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LiquidPlan {
    /// The grid.
    pub grid: Grid,
    /// Active effects.
    pub effects: Effects,
    /// Capacity for markers.
    pub n_markers: usize,
    /// CFL number: cells that the fastest point crosses in a sub-step.
    pub cfl: f64,
    /// Scalar type of sums and reports.
    pub real: Real,
}

impl LiquidPlan {
    /// Threads of a reduction: enough for a large device, fewer on small grids. Each sums its own share of the band.
    pub fn n_summing(&self) -> usize {
        (self.grid.padded().quads / 8).next_multiple_of(WG_SIZE as usize).min(LARGEST_SUMMING)
    }

    /// The tiles of the grid.
    pub fn tiles(&self) -> Tiles {
        Tiles::new(self.grid.cells, self.cfl, &self.effects)
    }
}

/// First bit of the open faces in `valid`. Also in `common/valid.wgsl`.
const OPEN: usize = 16;
/// Bit of `valid`: the quad has small-aperture faces, open by less than [`SLIVER`].
const SLIVERS: u32 = 1 << 31;
/// Words of [`LiquidBuffers::separation_sums`].
pub(crate) const SEPARATION_SUMS: usize = 8;
/// Largest number of threads of a reduction.
const LARGEST_SUMMING: usize = 16384;

/// Cells along the edge of a tile, two quads. Also in `shaders/common/tiles.wgsl`.
pub(crate) const TILE: usize = 8;

/// Tiles that cover every cell and every face.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Tiles {
    /// Tiles along x, y, z.
    pub n: [u32; 3],
    /// Tiles by which the band extends beyond tiles with liquid.
    pub reach: u32,
    /// Distance of air from the surface outside the band, cells.
    pub air: u32,
    /// Cells by which liquid may move in a sub-step; 0 without a level.
    pub moves: u32,
    /// Padding.
    pub pad_0: u32,
    /// Padding.
    pub pad_1: u32,
}

impl Tiles {
    /// The tiles of a grid. A marker activates cells within one cell of its own; their plus faces are one further,
    /// and extrapolation adds its layers. In a cut grid the extension of the liquid distance adds one more active
    /// cell.
    ///
    /// With a level the tiles are marked where liquid may be after the sub-step: cells within cfl + 0.4 + 1 of liquid
    /// before it, for the velocity, the fall g dt^2 / 2 at the longest sub-step, and the interpolation. A level reaches 5 cells
    /// into the air, which is less than a tile.
    pub fn new(cells: [usize; 3], cfl: f64, effects: &Effects) -> Tiles {
        let reach = extrapolation_layers(cfl) + 2 + usize::from(effects.cuts());
        Tiles {
            n: cells.map(|n| (n / TILE + 1) as u32),
            reach: reach.div_ceil(TILE) as u32,
            air: if effects.level { 5 } else { 1 },
            moves: if effects.level { cfl.ceil() as u32 + 1 } else { 0 },
            pad_0: 0,
            pad_1: 0,
        }
    }

    /// Number of tiles.
    pub fn len(&self) -> usize {
        self.n.iter().map(|&n| n as usize).product()
    }

    /// Always false; the pair of [`Tiles::len`].
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The tile of a cell.
    pub fn of(&self, [i, j, k]: [usize; 3]) -> usize {
        let [nx, ny, _] = self.n.map(|n| n as usize);
        i / TILE + nx * (j / TILE + ny * (k / TILE))
    }
}

/// Layers of the extrapolation, each one cell wide along axes and diagonals. The count is one cell more than the CFL
/// number along each axis. Markers near the surface use half a cell of it, and trilinear sampling one.
pub fn extrapolation_layers(cfl: f64) -> usize {
    cfl.ceil() as usize + 2
}

arrays! {
    /// Arrays of the liquid in the device layout ([`Padded`]), allocated once per grid.
    pub struct LiquidBuffers in "liquid" {
        fields {
            /// Sizes and effects.
            pub plan: LiquidPlan,
            /// Layout of all arrays.
            pub padded: Padded,
            /// Signed distance to obstacles and, in liquid, to solids.
            pub obstacles: ObstacleBuffers,
        }
        arrays {
            /// The layout, for kernels.
            pub uniform level: Layout [padded.layout()],
            /// Parameters of the sub-step.
            pub uniform step: Step [bytemuck::Zeroable::zeroed()],
            /// The tiles, for kernels.
            pub uniform tiles: Tiles [plan.tiles()],
            /// Face velocities after the last projection and extrapolation: sections of x, y, z faces, m/s; 0 outside
            /// the band. `advect_velocity` writes blended velocities of small-aperture faces. Free until
            /// `write_back`.
            pub array velocity: f32 [3 * padded.len()],
            /// u*: face velocities before the projection, m/s; defined on the band. Free until `advect_velocity`, which with MacCormack's
            /// method first stores the departure points (`common/departure_words.wgsl`).
            pub array velocity_next: f32 [3 * padded.len()],
            /// Face apertures.
            pub array open: f32 [3 * padded.len()],
            /// Liquid distance at cell centres, m; + dx outside the band, with a level + 5 dx.
            pub array liquid_distance: f32 [padded.len()],
            /// Per quad: flags of faces with a velocity, and of open faces (`common/valid.wgsl`).
            pub array valid: u32 [padded.quads],
            /// `valid` before or after a layer of the extrapolation.
            pub array valid_next: u32 [padded.quads],
            /// Per tile: whether it contains liquid. With markers it is zero outside the stage `band`.
            pub array marks: u32 [plan.tiles().len()],
            /// Per tile: in the band now, and in the last sub-step (`common/tiles.wgsl`).
            pub array dilated: u32 [plan.tiles().len()],
            /// Per quad: 1 in the band.
            pub array band_flags: u32 [padded.quads],
            /// Quads of the band, ascending.
            pub array band_list: u32 [padded.quads],
            /// Workgroups x, y, z and length of the list.
            pub array band_args: u32 [4],
            /// Scratch memory of the compaction.
            pub array band_scratch: u32 [Compaction::scratch(padded.quads)],
            /// Largest speed, m/s, and divergence, 1/s, as bits of f32.
            pub array maxima: u32 [2],
            /// Diagnostics that the host reads back once per step: see [`Report`].
            pub array report: u32 [Report::words(&plan.effects)],
            /// Partial sums of a reduction, four per thread.
            pub real partials: (plan.real) [4 * plan.n_summing()],
            /// Apertures for the solve: see [`LiquidBuffers::solve_open`].
            array solve_open: f32 [3 * padded.len()] as "sources.open" if plan.effects.sources,
            /// Prescribed boundary flux of moving obstacles, J v over dx^2 per cell, m/s.
            pub array obstacle_flux: f32 [padded.len()] if plan.effects.moving_obstacles,
            /// Per quad: separated lanes, and those that may separate (`common/separation.wgsl`).
            pub array separated: u32 [padded.quads] if plan.effects.separation,
            /// Per quad: active lanes that did not separate in the last solve.
            pub(crate) array projected: u32 [padded.quads] if plan.effects.separation,
            /// The same of the last sub-step, during the solve.
            pub array separated_before: u32 [padded.quads] if plan.effects.separation,
            /// Numbers of a round of separation (`common/separation.wgsl`).
            pub array separation_sums: u32 [SEPARATION_SUMS] if plan.effects.separation,
            /// Markers: x, y, z in m, and 1 for alive or 0 for deleted.
            pub array markers: [f32; 4] [plan.n_markers] if plan.effects.markers,
            /// Per quad: lanes without room for liquid, and without a level lanes that contain a marker (`common/classes.wgsl`).
            pub array occupied: u32 [padded.quads] if plan.effects.markers,
            /// Per quad: classes of its cells in the stage `liquid_distance` (`common/classes.wgsl`).
            pub array classes: u32 [padded.quads] if plan.effects.markers,
        }
        views {
            // The velocities, four per quad.
            velocity_quads = velocity,
            // Distance to the surface, m.
            surface = velocity_next while AdvectMarkers..=AdvectMarkers, free Extrapolate..=AdvectMarkers,
            // Squared distance to the nearest marker, cells^2.
            squares = liquid_distance while LiquidDistance..=LiquidDistance, free AdvectVelocity..=LiquidDistance,
            // Distance during its extension into solids, m.
            extended_distance = velocity while LiquidDistance..=LiquidDistance, free Forces..=Solve,
            // Sums of the momenta of markers that land, per face; with a level.
            landing_momentum = velocity while Landing..=Landing, free Forces..=Solve,
            // Liquid distance with 0 in separated cells, m.
            masked_distance = velocity while Solve..=Solve, free Forces..=Solve,
            // In `right_hand_side`.
            flux = obstacle_flux,
        }
        parts { obstacles }
    }
}

impl LiquidBuffers {
    /// Allocates all arrays.
    pub fn new(gpu: &Gpu, plan: LiquidPlan) -> Result<LiquidBuffers, Error> {
        let obstacles = ObstacleBuffers::new(gpu, &plan.grid, plan.effects.cuts())?;
        LiquidBuffers::allocate(gpu, plan, plan.grid.padded(), obstacles)
    }

    /// Face apertures for the solve. Faces of sources are closed for the pressure: the array stores minus the
    /// aperture of their flux.
    pub fn solve_open(&self) -> &Buffer<f32> {
        self.solve_open.as_ref().unwrap_or(&self.open)
    }

    /// Capacity for markers.
    pub fn n_markers(&self) -> usize {
        self.markers.as_ref().map_or(0, Buffer::len)
    }
}

arrays! {
    /// Distance to the obstacles, and in liquid to the solids.
    pub struct ObstacleBuffers in "obstacles" {
        fields {
            grid: Grid,
            present: bool,
        }
        arrays {
            /// Signed distance of cell centres to the obstacles, m; negative inside; device layout. Without obstacles
            /// the array is one quad far outside.
            pub array solid_distance: f32 [if present { grid.padded().len() } else { 4 }],
        }
        views {}
        parts {}
    }
}

impl ObstacleBuffers {
    /// Allocates. `present`: whether there are obstacles.
    pub fn new(gpu: &Gpu, grid: &Grid, present: bool) -> Result<ObstacleBuffers, Error> {
        ObstacleBuffers::allocate(gpu, *grid, present)
    }

    /// Writes the distance of the cell centres (m), before all work submitted later. Required without obstacles too.
    pub fn write(&self, gpu: &Gpu, distance: &[f64]) {
        let Grid { cells, dx } = self.grid;
        let distance = match self.present {
            true => self.grid.padded().pad(cells, distance, |d| d as f32),
            false => vec![3.0 * dx as f32; 4],
        };
        gpu.upload(&self.solid_distance, &distance);
    }
}

impl LiquidBuffers {
    /// Writes face apertures and distances of the cut cells, before all work submitted later. Required without
    /// obstacles too.
    pub fn write_cut_cells(&self, gpu: &Gpu, cut: &CutCells) {
        let open = self.pad_faces(&cut.open);
        gpu.upload(&self.open, &open);
        let mut valid = vec![0; self.padded.quads];
        for (quad, word) in valid.iter_mut().enumerate() {
            for bit in 0..12 {
                let face = 4 * (bit / 4 * self.padded.quads + quad) + bit % 4;
                *word |= u32::from(open[face] > 0.0) << (OPEN + bit);
                if open[face] > 0.0 && f64::from(open[face]) < SLIVER {
                    *word |= SLIVERS;
                }
            }
        }
        gpu.upload(&self.valid, &valid);
        self.obstacles.write(gpu, &cut.solid_distance);
        let grid = &self.plan.grid;
        if let Some(occupied) = &self.occupied {
            // A lane has room where its cell exists and its centre is outside all solids.
            let room = self.padded.pad(grid.cells, &cut.solid_distance, |d| d >= 0.0);
            let no_room = |lanes: &[bool]| (0..4).fold(0, |bits, lane| bits | u32::from(!lanes[lane]) << lane);
            let words: Vec<u32> = room.chunks_exact(4).map(no_room).collect();
            gpu.upload(occupied, &words);
        }
    }

    /// Writes velocities, markers and liquid distance of a state, before all work submitted later.
    ///
    /// # Panics
    /// When the state contains more markers than the capacity.
    pub fn write_state(&self, gpu: &Gpu, state: &State) {
        let grid = &self.plan.grid;
        gpu.upload(&self.velocity, &self.pad_faces(&state.velocity));
        let air = self.plan.tiles().air as f32 * grid.dx as f32;
        let mut distance = vec![air; self.padded.len()];
        for (cell, &phi) in state.liquid_distance.iter().enumerate() {
            distance[self.padded.index(grid.cell_at(cell))] = phi as f32;
        }
        gpu.upload(&self.liquid_distance, &distance);
        // Mark all tiles as in the band, so that the next band resets every tile outside it to air.
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
            let alive = state.markers.iter().map(|x| [x[0] as f32, x[1] as f32, x[2] as f32, 1.0]);
            let mut positions: Vec<[f32; 4]> = alive.collect();
            positions.resize(positions.len().max(markers.len()), [0.0; 4]);
            gpu.upload(markers, &positions);
        } else {
            // A fixed surface does not move: the tiles with liquid are known.
            let tiles = self.plan.tiles();
            let mut marks = vec![0; tiles.len()];
            for (cell, _) in state.liquid_distance.iter().enumerate().filter(|(_, phi)| **phi < 0.0) {
                marks[tiles.of(grid.cell_at(cell))] = 1;
            }
            gpu.upload(&self.marks, &marks);
        }
        gpu.upload(&self.report, &vec![0; self.report.len()]);
    }

    /// Waits for all submitted work and reads velocities, live markers and liquid distance into a state. Returns which of the
    /// first `n_markers` slots are alive.
    pub fn read_state(&self, gpu: &Gpu, n_markers: usize, state: &mut State) -> Result<Vec<bool>, Error> {
        state.velocity = self.read_faces(gpu, &self.velocity)?;
        state.liquid_distance =
            self.padded.unpad(self.plan.grid.cells, &gpu.download(&self.liquid_distance)?, f64::from);
        let Some(markers) = &self.markers else {
            return Ok(Vec::new());
        };
        let positions = gpu.download(markers)?;
        let used = &positions[..n_markers];
        state.markers =
            used.iter().filter(|marker| marker[3] != 0.0).map(|&[x, y, z, _]| [x, y, z].map(f64::from)).collect();
        Ok(used.iter().map(|marker| marker[3] != 0.0).collect())
    }

    /// Writes which cells separated in a state, before all work submitted later.
    pub fn write_separated(&self, gpu: &Gpu, state: &State) {
        if let Some(separated) = &self.separated {
            let grid = &self.plan.grid;
            let mut words = vec![0; separated.len()];
            for (cell, _) in state.separated.iter().enumerate().filter(|(_, on)| **on) {
                let index = self.padded.index(grid.cell_at(cell));
                words[index / 4] |= 1 << (index % 4);
            }
            gpu.upload(separated, &words);
        }
    }

    /// Waits for all submitted work and reads which cells separated; empty without separation.
    pub fn read_separated(&self, gpu: &Gpu) -> Result<Vec<bool>, Error> {
        let Some(separated) = &self.separated else {
            return Ok(Vec::new());
        };
        let words = gpu.download(separated)?;
        let lanes = (0..self.padded.len()).map(|at| words[at / 4] >> (at % 4) & 1 == 1);
        let lanes: Vec<bool> = lanes.collect();
        Ok(self.padded.unpad(self.plan.grid.cells, &lanes, |on| on))
    }

    /// Removes deleted markers from the first `used` slots. The others keep their order. Returns which of the slots were
    /// alive; [`LevelBuffers::compact`](super::LevelBuffers::compact) then does the same.
    pub fn compact(&self, gpu: &Gpu, used: usize) -> Result<Vec<bool>, Error> {
        let Some(markers) = &self.markers else {
            return Ok(Vec::new());
        };
        let mut positions = gpu.download(markers)?;
        positions.truncate(used);
        let alive = positions.iter().map(|marker| marker[3] != 0.0).collect();
        positions.retain(|marker| marker[3] != 0.0);
        positions.resize(markers.len(), [0.0; 4]);
        gpu.upload(markers, &positions);
        Ok(alive)
    }

    /// Waits for all submitted work and reads a face field as host arrays per axis.
    pub fn read_faces(&self, gpu: &Gpu, faces: &Buffer<f32>) -> Result<[Vec<f64>; 3], Error> {
        let device = gpu.download(faces)?;
        let len = self.padded.len();
        Ok(Axis::ALL.map(|axis| {
            let field = &device[axis.index() * len..][..len];
            self.padded.unpad(self.plan.grid.faces(axis), field, f64::from)
        }))
    }

    /// A face field in the device layout.
    pub fn pad_faces(&self, faces: &[Vec<f64>; 3]) -> Vec<f32> {
        Axis::ALL
            .iter()
            .flat_map(|&axis| {
                let values = &faces[axis.index()];
                self.padded.pad(self.plan.grid.faces(axis), values, |v| v as f32)
            })
            .collect()
    }
}
