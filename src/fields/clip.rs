//! Cut quads and moving walls.

use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;

use crate::Error;
use crate::arrays;
use crate::geometry::{MovingWall, SolidClip};
use crate::gpu::Gpu;
use crate::grid::{Axis, Grid, Padded};

/// Bit of a word of [`ClipBuffers::walls`]: the quad contains patches. Also in `shaders/common/moving_walls.wgsl`.
const WET: u32 = 16;
/// Replaces the first node of a closest point on an obstacle. The next words contain the bits of its velocity. Also
/// in `wall_velocities.wgsl`.
const NO_NODE: u32 = u32::MAX;
/// First bit of the index of the quad's first closest point. Also in `shaders/common/moving_walls.wgsl`.
const FIRST_PLACE: u32 = 5;

/// Lengths of the lists of a clipping.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Clipped {
    /// Quads that solids cut in this sub-step or in the last.
    pub n_quads: u32,
    /// Cells near solids, each with the closest point on a surface.
    pub n_places: u32,
    /// Index of the first velocity in [`ClipBuffers::walls`].
    pub first: u32,
    /// Padding.
    pub pad: u32,
}

/// Apertures and distances of a cut quad.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct CutQuad {
    /// Face apertures of the minus faces across x, y, z.
    pub open: [[f32; 4]; 3],
    /// Signed distance of the cell centres from obstacles and solids, m.
    pub distance: [f32; 4],
    /// Index of the quad.
    pub quad: u32,
    /// Word of the quad in [`ClipBuffers::walls`].
    pub walls: u32,
    /// Padding.
    pub pad_0: u32,
    /// Padding.
    pub pad_1: u32,
}

/// Capacity of [`ClipBuffers`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClipSize {
    /// Quads that moving geometry cuts in this sub-step or cut in the last.
    pub quads: usize,
    /// Cells near moving geometry.
    pub places: usize,
    /// Whether obstacles move.
    pub moving_obstacles: bool,
}

impl ClipSize {
    /// The capacity for a clipping that is written after one with `differing` cut quads, or with as many as its own.
    pub fn of(grid: &Grid, clip: &SolidClip, differing: usize) -> ClipSize {
        let now = cut_quads(&grid.padded(), grid, clip).len;
        ClipSize {
            quads: now + differing.max(now),
            places: clip.moving_walls().len(),
            moving_obstacles: clip.obstacles().has_moving(),
        }
    }

    /// 1.5 times the capacity, because moving bodies cut other cells in later sub-steps.
    pub fn ample(self) -> ClipSize {
        let ample = |n: usize| n + n / 2 + 64;
        ClipSize { quads: ample(self.quads), places: ample(self.places), ..self }
    }

    /// The larger of both, per list.
    pub fn joined(self, other: ClipSize) -> ClipSize {
        ClipSize { quads: self.quads.max(other.quads), places: self.places.max(other.places), ..self }
    }
}

/// A set of quads, one bit each.
#[derive(Clone, Debug, Default)]
pub(crate) struct QuadSet {
    bits: Vec<u64>,
    /// Number of members below each word.
    below: Vec<u32>,
    /// Number of members.
    len: usize,
}

impl QuadSet {
    fn new(bits: Vec<u64>) -> QuadSet {
        let mut len = 0;
        let below = bits.iter().map(|word| {
            let below = len as u32;
            len += word.count_ones() as usize;
            below
        });
        let below = below.collect();
        QuadSet { bits, below, len }
    }

    fn union(&self, other: &QuadSet) -> QuadSet {
        if other.len == 0 {
            return self.clone();
        }
        QuadSet::new(self.bits.iter().zip(&other.bits).map(|(a, b)| a | b).collect())
    }

    /// The members, ascending.
    fn members(&self) -> Vec<u32> {
        let mut members = Vec::with_capacity(self.len);
        for (first, &word) in (0..).step_by(64).zip(&self.bits) {
            let mut rest = word;
            while rest != 0 {
                members.push(first + rest.trailing_zeros());
                rest &= rest - 1;
            }
        }
        members
    }

    /// Position of a member among all.
    fn position(&self, quad: usize) -> usize {
        let (word, bit) = (quad / 64, quad % 64);
        debug_assert!(self.bits[word] >> bit & 1 == 1, "quad {quad} is not cut");
        self.below[word] as usize + (self.bits[word] & ((1 << bit) - 1)).count_ones() as usize
    }
}

/// A clipping as [`ClipBuffers::write`] writes it.
#[derive(Debug)]
pub struct CutQuads {
    quads: QuadSet,
    walls: Vec<MovingWall>,
}

arrays! {
    /// Cut quads before their copy to the arrays of the liquid, and surfaces as moving walls.
    pub struct ClipBuffers in "clip" {
        fields {
            /// Capacity.
            pub size: ClipSize,
            grid: Grid,
            padded: Padded,
            /// Quads whose values on the device differ from those of the static obstacles.
            differing: QuadSet,
        }
        arrays {
            /// Lengths of the lists below.
            pub uniform clipped: Clipped [Clipped::default()],
            array entries: CutQuad [size.quads] as "clip.quads",
            /// Per entry: prescribed boundary flux of moving obstacles, J v over dx^2, m/s.
            pub(crate) array fluxes: [f32; 4] [size.quads] if size.moving_obstacles,
            /// Per cell near a solid or moving obstacle: nodes of the closest triangle, then bits of their weights at
            /// the closest point.
            pub array places: [u32; 4] [2 * size.places],
            /// Per quad: bits of the lanes that have a closest point, and the index of the first. Then the velocities
            /// of the closest points, m/s (`shaders/common/moving_walls.wgsl`).
            pub array walls: u32 [padded.quads + 3 * size.places],
        }
        views {}
        parts {}
    }
}

impl ClipBuffers {
    /// Allocates.
    pub fn new(gpu: &Gpu, grid: &Grid, size: ClipSize) -> Result<ClipBuffers, Error> {
        ClipBuffers::allocate(gpu, size, *grid, grid.padded(), QuadSet::default())
    }

    /// Allocates another capacity and preserves the record of differing quads.
    pub fn resized(&self, gpu: &Gpu, size: ClipSize) -> Result<ClipBuffers, Error> {
        Ok(ClipBuffers { differing: self.differing.clone(), ..ClipBuffers::new(gpu, &self.grid, size)? })
    }

    /// Number of quads whose values on the device differ from those of the static obstacles.
    pub fn n_differing(&self) -> usize {
        self.differing.len
    }

    /// The quads and walls of a clipping.
    pub fn cut(&self, clip: &SolidClip) -> CutQuads {
        CutQuads { quads: cut_quads(&self.padded, &self.grid, clip), walls: clip.moving_walls() }
    }

    /// Whether the capacity suffices for a clipping, written after the one on the device.
    pub fn fits(&self, cut: &CutQuads) -> bool {
        cut.quads.len + self.differing.len <= self.size.quads && cut.walls.len() <= self.size.places
    }

    /// Writes a clipping, `cut` of `clip`, before all work submitted later. `triangles` contains the nodes of the surface
    /// triangles. `anew`: the liquid's arrays now contain the values of the static obstacles.
    ///
    /// # Panics
    /// When the capacity is too small.
    pub fn write(&mut self, gpu: &Gpu, (clip, cut): (&SolidClip, CutQuads), triangles: &[[u32; 3]], anew: bool) {
        if anew {
            gpu.upload(&self.walls, &vec![0; self.padded.quads]);
        }
        let CutQuads { quads: now, walls: near } = cut;
        let listed = now.union(&self.differing);
        // Entry of the quad, and the lane.
        let at = |cell: usize| {
            let index = self.padded.index(self.grid.cell_at(cell));
            (listed.position(index / 4), index % 4)
        };
        let mut words = vec![0; listed.len];
        let lanes: Vec<(usize, usize)> = near.par_iter().map(|wall| at(wall.cell())).collect();
        for (place, (quad, lane)) in lanes.into_iter().enumerate() {
            if words[quad] == 0 {
                words[quad] = (place as u32) << FIRST_PLACE;
            }
            words[quad] |= 1 << lane;
        }
        for (cell, _) in clip.coupling().cells() {
            words[at(cell).0] |= WET;
        }
        let quads = listed.members();
        let entries: Vec<CutQuad> =
            quads.par_iter().zip(&words).map(|(&quad, &walls)| self.cut_quad(clip, quad, walls)).collect();
        let places: Vec<[[u32; 4]; 2]> = near
            .par_iter()
            .map(|place| match place {
                MovingWall::Solid(nearest) => {
                    let [a, b, c] = triangles[nearest.triangle];
                    let [u, v, w] = nearest.weights.map(|weight| (weight as f32).to_bits());
                    [[a, b, c, 0], [u, v, w, 0]]
                }
                MovingWall::Obstacle { velocity, .. } => {
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
        gpu.upload(&self.places, places.as_flattened());
        if let Some(fluxes) = &self.fluxes {
            let mut quad_fluxes = vec![[0.0; 4]; listed.len];
            for &(cell, flux) in clip.obstacles().flux() {
                let (quad, lane) = at(cell);
                quad_fluxes[quad][lane] = (flux / self.grid.dx.powi(2)) as f32;
            }
            gpu.upload(fluxes, &quad_fluxes);
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

/// Quads whose cells or faces can differ from those of the static obstacles.
fn cut_quads(padded: &Padded, grid: &Grid, clip: &SolidClip) -> QuadSet {
    let mut bits = Vec::new();
    bits.resize_with(padded.quads.div_ceil(64), AtomicU64::default);
    let insert = |at: [usize; 3]| {
        let quad = padded.index(at) / 4;
        let (word, bit) = (&bits[quad / 64], 1 << (quad % 64));
        if word.load(Ordering::Relaxed) & bit == 0 {
            word.fetch_or(bit, Ordering::Relaxed);
        }
    };
    let insert_cell = |&cell: &usize| insert(grid.cell_at(cell));
    for (faces, cells) in clip.changed() {
        for (axis, faces) in Axis::ALL.into_iter().zip(faces) {
            faces.par_iter().for_each(|&face| insert(grid.face_at(axis, face)));
        }
        cells.par_iter().for_each(insert_cell);
    }
    clip.coupling().pairs().par_iter().for_each(|pair| insert_cell(&pair.cell));
    clip.obstacles().flux().par_iter().for_each(|(cell, _)| insert_cell(cell));
    QuadSet::new(bits.into_iter().map(AtomicU64::into_inner).collect())
}
