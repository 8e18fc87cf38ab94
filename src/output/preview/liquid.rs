//! The liquid as one smooth distance field, from markers or from cells, and rays through it.
//!
//! From markers (Zhu and Bridson 2005, section 5): phi(x) = |x - mean of near markers| - radius, the mean weighted by
//! (1 - d^2/R^2)^3. A lone marker is a sphere, a dense body is smooth, where a union of spheres would be bumpy.

use glam::{UVec3, Vec3};
use rayon::prelude::*;

/// Reach R of a marker in the mean, in cells: more smooths more and rounds off more.
const REACH: f32 = 2.0;

/// Samples of the field per cell and axis.
const SAMPLES_PER_CELL: usize = 2;

/// Half the distance of the differences that make a normal, in samples; more hides the grain of the markers.
const NORMAL_STEP: f32 = 1.5;

/// Above this many samples there is one per cell and axis only: 128 MB while the means are summed.
const MOST_SAMPLES: usize = 8_000_000;

/// Layers of samples that one thread sums at a time.
const SLAB: usize = 8;

/// Edge of the blocks that rays skip when they are all liquid or all air, in samples.
const BLOCK: usize = 4;

/// A distance field on cell-centred samples of the domain box, constant beyond the outermost, cut off at the walls.
pub(super) struct LiquidField {
    n: [usize; 3],
    /// Sample spacing, m.
    h: f32,
    /// Corners of the box of all blocks with liquid, m; at most the domain.
    low: Vec3,
    high: Vec3,
    /// m, negative inside; n samples, x fastest.
    phi: Vec<f32>,
    n_blocks: [usize; 3],
    blocks: Vec<Block>,
    /// Made from n and h, for speed: 1/h, the last index, the last but one, and the strides (0 along an axis of one sample).
    inv_h: f32,
    last: Vec3,
    last_low: UVec3,
    strides: [usize; 3],
}

#[derive(Clone, Copy, PartialEq)]
enum Block {
    Air,
    Liquid,
    Mixed,
}

/// Where a ray comes into the liquid.
pub(super) struct Entry {
    /// Distance along the ray, m.
    pub(super) t: f32,
    /// Unit normal, out of the liquid.
    pub(super) normal: Vec3,
}

impl LiquidField {
    /// From markers of a radius (m) in a domain of `cells` of size `dx` (m).
    pub(super) fn from_markers(
        markers: &[Vec3],
        radius: f32,
        cells: [usize; 3],
        dx: f32,
    ) -> LiquidField {
        let n_cells: usize = cells.iter().product();
        let fine = n_cells * SAMPLES_PER_CELL.pow(3) <= MOST_SAMPLES;
        let per_cell = if fine { SAMPLES_PER_CELL } else { 1 };
        let n = cells.map(|n| n * per_cell);
        let h = dx / per_cell as f32;
        let reach = REACH * dx;
        let (inv_h, inv_reach2) = (1.0 / h, 1.0 / (reach * reach));

        // Markers of each slab, in order; every slab is summed by one thread, so that sums do not depend on
        // the number of threads.
        let slabs = n[2].div_ceil(SLAB);
        let mut of_slab: Vec<Vec<Vec3>> = vec![Vec::new(); slabs];
        for &marker in markers {
            let slab_at = |z: f32| ((z / (h * SLAB as f32)).max(0.0) as usize).min(slabs - 1);
            for list in &mut of_slab[slab_at(marker.z - reach)..=slab_at(marker.z + reach)] {
                list.push(marker);
            }
        }
        let mut phi = vec![reach - radius; n[0] * n[1] * n[2]];
        phi.par_chunks_mut(n[0] * n[1] * SLAB)
            .zip(&of_slab)
            .enumerate()
            .for_each(|(slab, (phi, markers))| {
                let first = slab * SLAB;
                let depth = phi.len() / (n[0] * n[1]);
                // Weighted sum of offsets to the markers in xyz, of the weights in w.
                let mut sums = vec![[0.0_f32; 4]; phi.len()];
                for &marker in markers {
                    // Samples from `low` to before `high` that are not further than `reach` from x along an axis.
                    let span = |x: f32, reach: f32, low: usize, high: usize| {
                        let from = ((x - reach) * inv_h + 0.5).max(low as f32) as usize;
                        let to = ((x + reach) * inv_h + 0.5).max(0.0) as usize;
                        from..to.min(high)
                    };
                    for k in span(marker.z, reach, first, first + depth) {
                        let dz = marker.z - (k as f32 + 0.5) * h;
                        for j in span(marker.y, reach, 0, n[1]) {
                            let dy = marker.y - (j as f32 + 0.5) * h;
                            let rest = (reach * reach - dy * dy - dz * dz).max(0.0);
                            let row = n[0] * (j + n[1] * (k - first));
                            for i in span(marker.x, rest.sqrt(), 0, n[0]) {
                                let dx = marker.x - (i as f32 + 0.5) * h;
                                let left = (rest - dx * dx).max(0.0) * inv_reach2;
                                let weight = left * left * left;
                                let sum = &mut sums[row + i];
                                sum[0] += weight * dx;
                                sum[1] += weight * dy;
                                sum[2] += weight * dz;
                                sum[3] += weight;
                            }
                        }
                    }
                }
                for (phi, [x, y, z, weight]) in phi.iter_mut().zip(sums) {
                    if weight > 1e-6 {
                        *phi = Vec3::new(x, y, z).length() / weight - radius;
                    }
                }
            });
        LiquidField::new(n, h, phi)
    }

    /// From distances at cell centres (m).
    pub(super) fn from_cells(phi: Vec<f32>, cells: [usize; 3], dx: f32) -> LiquidField {
        LiquidField::new(cells, dx, phi)
    }

    fn new(n: [usize; 3], h: f32, phi: Vec<f32>) -> LiquidField {
        let size = Vec3::new(n[0] as f32, n[1] as f32, n[2] as f32) * h;
        let n_blocks = n.map(|n| n.div_ceil(BLOCK));
        let blocks: Vec<Block> = (0..n_blocks.iter().product())
            .into_par_iter()
            .map(|block: usize| {
                let at = block_at(n_blocks, block);
                let range =
                    |axis: usize| at[axis] * BLOCK..((at[axis] + 1) * BLOCK + 1).min(n[axis]);
                let (mut liquid, mut air) = (false, false);
                for k in range(2) {
                    for j in range(1) {
                        let row = n[0] * (j + n[1] * k);
                        for phi in &phi[row + range(0).start..row + range(0).end] {
                            liquid |= *phi < 0.0;
                            air |= *phi >= 0.0;
                        }
                    }
                }
                match (liquid, air) {
                    (true, false) => Block::Liquid,
                    (false, _) => Block::Air,
                    (true, true) => Block::Mixed,
                }
            })
            .collect();
        let (mut low, mut high) = (size, Vec3::ZERO);
        for (block, kind) in blocks.iter().enumerate() {
            if *kind != Block::Air {
                let at = block_at(n_blocks, block);
                let at = Vec3::new(at[0] as f32, at[1] as f32, at[2] as f32);
                // Outermost samples reach to the walls.
                let corner = |at: Vec3| (at * BLOCK as f32 + 0.5) * h;
                let first = Vec3::select(at.cmpeq(Vec3::ZERO), Vec3::ZERO, corner(at));
                low = low.min(first);
                high = high.max(corner(at + 1.0) + 0.5 * h).min(size);
            }
        }
        let counts = UVec3::from_array(n.map(|n| n as u32));
        let all = [1, n[0], n[0] * n[1]];
        LiquidField {
            n,
            h,
            low,
            high,
            phi,
            n_blocks,
            blocks,
            inv_h: 1.0 / h,
            last: (counts - 1).as_vec3(),
            last_low: counts.saturating_sub(UVec3::splat(2)),
            strides: [0, 1, 2].map(|axis| if n[axis] > 1 { all[axis] } else { 0 }),
        }
    }

    /// The field at a point, trilinear, without the walls.
    fn phi(&self, x: Vec3) -> f32 {
        let at = (x * self.inv_h - 0.5).clamp(Vec3::ZERO, self.last);
        // Conversion truncates, which is floor here, and is much faster.
        let low = at.as_uvec3().min(self.last_low);
        let t = at - low.as_vec3();
        let start = low.x as usize + self.n[0] * (low.y as usize + self.n[1] * low.z as usize);
        let [sx, sy, sz] = self.strides;
        let row = |at: usize| self.phi[at] + (self.phi[at + sx] - self.phi[at]) * t.x;
        let slab = |at: usize| row(at) + (row(at + sy) - row(at)) * t.y;
        slab(start) + (slab(start + sz) - slab(start)) * t.z
    }

    fn normal(&self, x: Vec3) -> Vec3 {
        let slope = |step: Vec3| self.phi(x + step) - self.phi(x - step);
        let h = NORMAL_STEP * self.h;
        Vec3::new(slope(Vec3::X * h), slope(Vec3::Y * h), slope(Vec3::Z * h)).normalize_or(Vec3::Y)
    }

    /// Where a ray is in the box of the liquid, and the normal of the side through which it comes in.
    fn span(&self, origin: Vec3, inverse: Vec3) -> (f32, f32, Vec3) {
        let (low, high) = (
            (self.low - origin) * inverse,
            (self.high - origin) * inverse,
        );
        let (near, far) = (low.min(high), low.max(high));
        let t = near.max_element();
        let wall = Vec3::select(near.cmpge(Vec3::splat(t)), -inverse.signum(), Vec3::ZERO)
            .normalize_or(Vec3::Y);
        (t, far.min_element(), wall)
    }

    /// The block at a point, and the distance along the ray at which the ray leaves it.
    fn block(&self, origin: Vec3, direction: Vec3, inverse: Vec3, t: f32) -> (Block, f32) {
        let edge = self.h * BLOCK as f32;
        // Blocks begin and end at samples, half a spacing in from the walls.
        let at = ((origin + direction * t) - 0.5 * self.h) / edge;
        let mut far = f32::INFINITY;
        let mut block = [0; 3];
        for axis in 0..3 {
            block[axis] = (at[axis].max(0.0) as usize).min(self.n_blocks[axis] - 1);
            let ahead = direction[axis] > 0.0;
            let outermost = if ahead { self.n_blocks[axis] - 1 } else { 0 };
            if block[axis] != outermost {
                let wall = (block[axis] + usize::from(ahead)) as f32 * edge + 0.5 * self.h;
                far = far.min((wall - origin[axis]) * inverse[axis]);
            }
        }
        let [i, j, k] = block;
        (
            self.blocks[i + self.n_blocks[0] * (j + self.n_blocks[1] * k)],
            far.max(t) + 1e-3 * self.h,
        )
    }

    /// First change from air to liquid on the ray between two distances.
    fn surface(&self, origin: Vec3, direction: Vec3, from: f32, to: f32) -> Option<f32> {
        let inverse = direction.recip();
        let (mut t, mut last) = (from, from);
        while t < to {
            let (block, far) = self.block(origin, direction, inverse, t);
            if block == Block::Air {
                (last, t) = (t, far);
                continue;
            }
            while t < far.min(to) {
                let phi = self.phi(origin + direction * t);
                if phi < 0.0 {
                    return Some(self.root(origin, direction, last, t));
                }
                last = t;
                t += (0.8 * phi).clamp(0.3 * self.h, 1.5 * self.h);
            }
        }
        None
    }

    /// Bisection between a distance in air and one in liquid.
    fn root(&self, origin: Vec3, direction: Vec3, mut air: f32, mut liquid: f32) -> f32 {
        for _ in 0..7 {
            let middle = 0.5 * (air + liquid);
            if self.phi(origin + direction * middle) < 0.0 {
                liquid = middle;
            } else {
                air = middle;
            }
        }
        liquid
    }

    /// Where a ray first comes into the liquid before `limit`, from air outside or inside the domain.
    pub(super) fn entry(&self, origin: Vec3, direction: Vec3, limit: f32) -> Option<Entry> {
        let (near, far, wall) = self.span(origin, direction.recip());
        let (from, to) = (near.max(0.0), far.min(limit));
        if from >= to {
            return None;
        }
        // A little inside, for the rounding of the box.
        let start = from + 1e-3 * self.h;
        if self.phi(origin + direction * start) < 0.0 {
            return Some(Entry {
                t: from,
                normal: wall,
            });
        }
        let t = self.surface(origin, direction, start, to)?;
        Some(Entry {
            t,
            normal: self.normal(origin + direction * t),
        })
    }

    /// Length of liquid on the ray before `limit`, m, smooth across the surface; stops counting beyond `enough`.
    pub(super) fn length(&self, origin: Vec3, direction: Vec3, limit: f32, enough: f32) -> f32 {
        let inverse = direction.recip();
        let (near, far, _) = self.span(origin, inverse);
        let to = far.min(limit);
        let mut t = near.max(0.0) + 1e-3 * self.h;
        let mut length = 0.0;
        while t < to && length < enough {
            let (block, far) = self.block(origin, direction, inverse, t);
            let end = far.min(to);
            match block {
                Block::Air => {}
                Block::Liquid => length += end - t,
                Block::Mixed => {
                    let steps = ((end - t) * self.inv_h).ceil();
                    let step = (end - t) / steps;
                    for index in 0..steps as usize {
                        let phi = self.phi(origin + direction * (t + (index as f32 + 0.5) * step));
                        length += step * (0.5 - phi * self.inv_h).clamp(0.0, 1.0);
                    }
                }
            }
            t = far;
        }
        length
    }
}

fn block_at([nx, ny, _]: [usize; 3], index: usize) -> [usize; 3] {
    [index % nx, index / nx % ny, index / (nx * ny)]
}
