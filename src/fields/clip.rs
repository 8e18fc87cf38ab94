//! Cut quads and moving walls.

use crate::Error;
use crate::arrays;
use crate::geometry::{Place, SolidClip};
use crate::gpu::Gpu;
use crate::grid::{Axis, Grid, Padded};

/// Bit of a word of [`ClipBuffers::walls`]: patches lie in the quad. `shaders/common/moving_walls.wgsl` has it too.
const WET: u32 = 16;
/// In place of the nodes of a place that is not on a solid: what follows are bits of its velocity. `wall_velocities.wgsl` has it too.
const NO_NODE: u32 = u32::MAX;
/// First bit of the number of the quad's first place, likewise.
const FIRST_PLACE: u32 = 5;

/// How much of it there is: the doppelganger of `Clipped` in `shaders/common/cut_quad.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Clipped {
    /// Quads whose cells solids cut, or cut in the last sub-step.
    pub n_quads: u32,
    /// Cells near solids, with the nearest place on a surface.
    pub n_places: u32,
    /// First word of the places' velocities in [`ClipBuffers::walls`].
    pub first: u32,
    /// Nothing.
    pub pad: u32,
}

/// A quad as it is cut: the doppelganger of `CutQuad` in `shaders/common/cut_quad.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct CutQuad {
    /// Open fractions of the minus faces across x, y, z.
    pub open: [[f32; 4]; 3],
    /// Distance of the centres from obstacles and solids, m.
    pub distance: [f32; 4],
    /// The quad.
    pub quad: u32,
    /// Its word of [`ClipBuffers::walls`].
    pub walls: u32,
    /// Nothing.
    pub pad_0: u32,
    /// Nothing.
    pub pad_1: u32,
}

/// How much room there is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClipSize {
    /// Quads that differ from what those obstacles leave that stand still, in this sub-step or in the last.
    pub quads: usize,
    /// Cells near what moves.
    pub places: usize,
    /// Whether obstacles move.
    pub moving_obstacles: bool,
}

impl ClipSize {
    /// What a clipping needs when it is written after one with so many quads, or with as many as its own.
    pub fn of(grid: &Grid, clip: &SolidClip, differing: usize) -> ClipSize {
        let now = cut_quads(&grid.padded(), grid, clip).len();
        ClipSize {
            quads: now + differing.max(now),
            places: clip.places().len(),
            moving_obstacles: clip.obstacles().move_at_all(),
        }
    }

    /// Half as much again: bodies cut other cells as they go.
    pub fn ample(self) -> ClipSize {
        let ample = |n: usize| n + n / 2 + 64;
        ClipSize {
            quads: ample(self.quads),
            places: ample(self.places),
            ..self
        }
    }

    /// Enough for both.
    pub fn joined(self, other: ClipSize) -> ClipSize {
        ClipSize {
            quads: self.quads.max(other.quads),
            places: self.places.max(other.places),
            ..self
        }
    }
}

arrays! {
    /// Cut quads on their way to the arrays of the liquid, and surfaces as moving walls.
    pub struct ClipBuffers in "clip" {
        fields {
            /// Room.
            pub size: ClipSize,
            grid: Grid,
            padded: Padded,
            /// Quads that differ on the device.
            differing: Vec<u32>,
        }
        arrays {
            /// Counts of the lists below.
            pub uniform clipped: Clipped [Clipped::default()],
            array entries: CutQuad [size.quads] as "clip.quads",
            /// Per entry: prescribed boundary flux of moving obstacles, J v over dx^2, m/s.
            pub(crate) array fluxes: [f32; 4] [size.quads] if size.moving_obstacles,
            /// Per cell near a solid or moving obstacle: nodes of the nearest triangle, then bits of their weights at its nearest place.
            pub array places: [u32; 4] [2 * size.places],
            /// Per quad: which lanes have a place, and which; then the velocities of the places, m/s (`shaders/common/moving_walls.wgsl`).
            pub array walls: u32 [padded.quads + 3 * size.places],
        }
        views {}
        parts {}
    }
}

impl ClipBuffers {
    /// Allocates.
    ///
    /// # Errors
    /// [`Error::Limit`] where the adapter is too small.
    pub fn new(gpu: &Gpu, grid: &Grid, size: ClipSize) -> Result<ClipBuffers, Error> {
        ClipBuffers::allocate(gpu, size, *grid, grid.padded(), Vec::new())
    }

    /// The same with other room, and what differs on the device as it was.
    ///
    /// # Errors
    /// As [`ClipBuffers::new`].
    pub fn resized(&self, gpu: &Gpu, size: ClipSize) -> Result<ClipBuffers, Error> {
        Ok(ClipBuffers {
            differing: self.differing.clone(),
            ..ClipBuffers::new(gpu, &self.grid, size)?
        })
    }

    /// Quads that differ on the device from what the obstacles leave.
    pub fn n_differing(&self) -> usize {
        self.differing.len()
    }

    /// Whether a clipping fits after the one that is on the device.
    pub fn fits(&self, clip: &SolidClip) -> bool {
        let now = cut_quads(&self.padded, &self.grid, clip).len();
        now + self.differing.len() <= self.size.quads && clip.places().len() <= self.size.places
    }

    /// Writes a clipping, before all work submitted later; `triangles`: nodes of the surface triangles. With `anew` the fields were just
    /// written as the obstacles leave them.
    ///
    /// # Panics
    /// When it does not fit.
    pub fn write(&mut self, gpu: &Gpu, clip: &SolidClip, triangles: &[[u32; 3]], anew: bool) {
        if anew {
            gpu.upload(&self.walls, &vec![0; self.padded.quads]);
        }
        let now = cut_quads(&self.padded, &self.grid, clip);
        let mut listed = std::mem::take(&mut self.differing);
        listed.extend(&now);
        listed.sort_unstable();
        listed.dedup();
        let mut words = vec![0; listed.len()];
        // Which of them, and the lane.
        let at = |cell: usize| {
            let index = self.padded.index(self.grid.cell_at(cell));
            let found = listed.binary_search(&((index / 4) as u32));
            let found = found.expect("cells near solids are among the changed ones");
            (found, index % 4)
        };
        let near = clip.places();
        for (place, nearest) in near.iter().enumerate() {
            let (quad, lane) = at(nearest.cell());
            if words[quad] == 0 {
                words[quad] = (place as u32) << FIRST_PLACE;
            }
            words[quad] |= 1 << lane;
        }
        for (cell, _) in clip.coupling().cells() {
            words[at(cell).0] |= WET;
        }
        let entries: Vec<CutQuad> = listed
            .iter()
            .zip(&words)
            .map(|(&quad, &walls)| self.cut_quad(clip, quad, walls))
            .collect();
        let places: Vec<[u32; 4]> = near
            .iter()
            .flat_map(|place| match place {
                Place::Solid(nearest) => {
                    let [a, b, c] = triangles[nearest.triangle];
                    let [u, v, w] = nearest.weights.map(|weight| (weight as f32).to_bits());
                    [[a, b, c, 0], [u, v, w, 0]]
                }
                Place::Obstacle { velocity, .. } => {
                    let [u, v, w] = velocity.as_vec3().to_array().map(f32::to_bits);
                    [[NO_NODE; 4], [u, v, w, 0]]
                }
            })
            .collect();
        let clipped = Clipped {
            n_quads: entries.len() as u32,
            n_places: near.len() as u32,
            first: self.padded.quads as u32,
            pad: 0,
        };
        gpu.upload(&self.clipped, &[clipped]);
        gpu.upload(&self.entries, &entries);
        gpu.upload(&self.places, &places);
        if let Some(fluxes) = &self.fluxes {
            let mut of_quads = vec![[0.0; 4]; listed.len()];
            for &(cell, flux) in clip.obstacles().flux() {
                let (quad, lane) = at(cell);
                of_quads[quad][lane] = (flux / self.grid.dx.powi(2)) as f32;
            }
            gpu.upload(fluxes, &of_quads);
        }
        self.differing = now;
    }

    fn cut_quad(&self, clip: &SolidClip, quad: u32, walls: u32) -> CutQuad {
        let (grid, cut) = (&self.grid, clip.cut_cells());
        let first = self.padded.cell_of(quad as usize);
        let lanes = |n: [usize; 3], value: &dyn Fn([usize; 3]) -> f64| {
            [0, 1, 2, 3].map(|lane| {
                let at = [first[0] + lane, first[1], first[2]];
                let exists = (0..3).all(|axis| at[axis] < n[axis]);
                if exists { value(at) as f32 } else { 0.0 }
            })
        };
        CutQuad {
            open: Axis::ALL.map(|axis| {
                let fractions = &cut.open[axis.index()];
                lanes(grid.faces(axis), &|at| fractions[grid.face(axis, at)])
            }),
            distance: lanes(grid.cells, &|at| cut.solid_distance[grid.cell(at)]),
            quad,
            walls,
            pad_0: 0,
            pad_1: 0,
        }
    }
}

/// Quads with cells or faces that need not be as the obstacles leave them, ascending.
fn cut_quads(padded: &Padded, grid: &Grid, clip: &SolidClip) -> Vec<u32> {
    let (faces, cells) = clip.changed();
    let cells = cells.iter().map(|&cell| grid.cell_at(cell));
    let faces = Axis::ALL.into_iter().zip(&faces);
    let faces = faces.flat_map(|(axis, faces)| faces.iter().map(move |&f| grid.face_at(axis, f)));
    let of_solids = clip.coupling().cells().map(|(cell, _)| cell);
    let of_obstacles = clip.obstacles().flux().iter().map(|&(cell, _)| cell);
    let patches = of_solids.chain(of_obstacles).map(|cell| grid.cell_at(cell));
    let all = cells.chain(faces).chain(patches);
    let mut quads: Vec<u32> = all.map(|at| (padded.index(at) / 4) as u32).collect();
    quads.sort_unstable();
    quads.dedup();
    quads
}
