//! The liquid as one smooth distance field, from markers or from cells, and rays through it.
//!
//! From markers (Zhu and Bridson 2005, section 5): phi(x) = |x - mean of near markers| - radius, the mean weighted by
//! (1 - d^2/R^2)^3. A lone marker is a sphere, a dense body is smooth, where a union of spheres would be bumpy.

use glam::Vec3;
use rayon::prelude::*;

/// Reach R of a marker in the mean, in cells: more smooths more and rounds off more.
const REACH: f32 = 1.75;

/// Samples of the field per cell and axis.
const SAMPLES_PER_CELL: usize = 2;

/// Above this many samples there is one per cell and axis only: 128 MB while the means are summed.
const MOST_SAMPLES: usize = 8_000_000;

/// Edge of the blocks that rays skip when they are all liquid or all air, in samples.
const BLOCK: usize = 8;

/// A distance field on cell-centred samples of the domain box, constant beyond the outermost, cut off at the walls.
pub(super) struct LiquidField {
    n: [usize; 3],
    /// Sample spacing, m.
    h: f32,
    /// Extents of the domain, m.
    size: Vec3,
    /// m, negative inside; n samples, x fastest.
    phi: Vec<f32>,
    n_blocks: [usize; 3],
    blocks: Vec<Block>,
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

        // Markers of each layer of blocks, in order; every layer is summed by one thread, so that sums do not depend on
        // the number of threads.
        let layers = n[2].div_ceil(BLOCK);
        let mut of_layer: Vec<Vec<Vec3>> = vec![Vec::new(); layers];
        for &marker in markers {
            let layer = |z: f32| ((z / (h * BLOCK as f32)).max(0.0) as usize).min(layers - 1);
            for list in &mut of_layer[layer(marker.z - reach)..=layer(marker.z + reach)] {
                list.push(marker);
            }
        }
        let mut phi = vec![reach - radius; n[0] * n[1] * n[2]];
        phi.par_chunks_mut(n[0] * n[1] * BLOCK)
            .zip(&of_layer)
            .enumerate()
            .for_each(|(layer, (phi, markers))| {
                let first = layer * BLOCK;
                let depth = phi.len() / (n[0] * n[1]);
                // Weighted sum of offsets to the markers in xyz, of the weights in w.
                let mut sums = vec![[0.0_f32; 4]; phi.len()];
                for &marker in markers {
                    let span = |x: f32, low: usize, high: usize| {
                        let from = ((x - reach) / h - 0.5).ceil().max(low as f32) as usize;
                        let to = ((x + reach) / h - 0.5).floor().min(high as f32 - 1.0);
                        from..(to + 1.0).max(0.0) as usize
                    };
                    for k in span(marker.z, first, first + depth) {
                        let dz = marker.z - (k as f32 + 0.5) * h;
                        for j in span(marker.y, 0, n[1]) {
                            let dy = marker.y - (j as f32 + 0.5) * h;
                            let rest = reach * reach - dy * dy - dz * dz;
                            let row = n[0] * (j + n[1] * (k - first));
                            for i in span(marker.x, 0, n[0]) {
                                let dx = marker.x - (i as f32 + 0.5) * h;
                                let left = (rest - dx * dx).max(0.0) / (reach * reach);
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
        let blocks = (0..n_blocks.iter().product())
            .into_par_iter()
            .map(|block: usize| {
                let at = [
                    block % n_blocks[0],
                    block / n_blocks[0] % n_blocks[1],
                    block / (n_blocks[0] * n_blocks[1]),
                ];
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
        LiquidField {
            n,
            h,
            size,
            phi,
            n_blocks,
            blocks,
        }
    }

    /// The field at a point, trilinear, without the walls.
    fn phi(&self, x: Vec3) -> f32 {
        let last = Vec3::new(self.n[0] as f32, self.n[1] as f32, self.n[2] as f32) - 1.0;
        let at = (x / self.h - 0.5).clamp(Vec3::ZERO, last);
        let low = at.floor().min((last - 1.0).max(Vec3::ZERO));
        let t = at - low;
        let start = low.x as usize + self.n[0] * (low.y as usize + self.n[1] * low.z as usize);
        let step = |axis: usize, stride: usize| if self.n[axis] > 1 { stride } else { 0 };
        let (sx, sy, sz) = (
            step(0, 1),
            step(1, self.n[0]),
            step(2, self.n[0] * self.n[1]),
        );
        let row = |at: usize| self.phi[at] + (self.phi[at + sx] - self.phi[at]) * t.x;
        let slab = |at: usize| row(at) + (row(at + sy) - row(at)) * t.y;
        slab(start) + (slab(start + sz) - slab(start)) * t.z
    }

    fn normal(&self, x: Vec3) -> Vec3 {
        let slope = |step: Vec3| self.phi(x + step) - self.phi(x - step);
        let h = self.h;
        Vec3::new(slope(Vec3::X * h), slope(Vec3::Y * h), slope(Vec3::Z * h)).normalize_or(Vec3::Y)
    }

    /// Where a ray is in the domain box.
    fn span(&self, origin: Vec3, inverse: Vec3) -> (f32, f32, Vec3) {
        let (low, high) = (-origin * inverse, (self.size - origin) * inverse);
        let (near, far) = (low.min(high), low.max(high));
        let t = near.max_element();
        // The wall through which the ray comes in.
        let wall = Vec3::select(near.cmpge(Vec3::splat(t)), -inverse.signum(), Vec3::ZERO)
            .normalize_or(Vec3::Y);
        (t, far.min_element(), wall)
    }

    /// First change from air to liquid (or back, if `inside`) on the ray between two distances.
    fn change(
        &self,
        origin: Vec3,
        direction: Vec3,
        inside: bool,
        from: f32,
        to: f32,
    ) -> Option<f32> {
        let inverse = direction.recip();
        let edge = self.h * BLOCK as f32;
        let same = if inside { Block::Liquid } else { Block::Air };
        let sign = if inside { -1.0 } else { 1.0 };
        let mut t = from;
        let mut last = from;
        while t < to {
            let x = origin + direction * t;
            // Blocks hold the samples' positions, half a spacing in.
            let at = (x - 0.5 * self.h) / edge;
            let index = |axis: usize| (at[axis].max(0.0) as usize).min(self.n_blocks[axis] - 1);
            let [i, j, k] = [index(0), index(1), index(2)];
            if self.blocks[i + self.n_blocks[0] * (j + self.n_blocks[1] * k)] == same {
                let mut far = f32::INFINITY;
                for (axis, index) in [i, j, k].into_iter().enumerate() {
                    let ahead = direction[axis] > 0.0;
                    let outermost = if ahead { self.n_blocks[axis] - 1 } else { 0 };
                    if index != outermost {
                        let wall = (index + usize::from(ahead)) as f32 * edge + 0.5 * self.h;
                        far = far.min((wall - origin[axis]) * inverse[axis]);
                    }
                }
                last = t;
                t = far.max(t) + 1e-3 * self.h;
                continue;
            }
            let phi = sign * self.phi(x);
            if phi < 0.0 {
                return Some(self.root(origin, direction, sign, last, t));
            }
            last = t;
            t += (0.8 * phi).clamp(0.3 * self.h, self.h);
        }
        None
    }

    /// Bisection between a distance on the near side and one beyond.
    fn root(&self, origin: Vec3, direction: Vec3, sign: f32, mut near: f32, mut far: f32) -> f32 {
        for _ in 0..7 {
            let middle = 0.5 * (near + far);
            if sign * self.phi(origin + direction * middle) < 0.0 {
                far = middle;
            } else {
                near = middle;
            }
        }
        far
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
        let t = self.change(origin, direction, false, start, to)?;
        Some(Entry {
            t,
            normal: self.normal(origin + direction * t),
        })
    }

    /// Length of liquid on the ray before `limit`, m; stops counting beyond `enough`.
    pub(super) fn length(&self, origin: Vec3, direction: Vec3, limit: f32, enough: f32) -> f32 {
        let (near, far, _) = self.span(origin, direction.recip());
        let to = far.min(limit);
        let mut t = near.max(0.0) + 1e-3 * self.h;
        let mut length = 0.0;
        if t >= to {
            return 0.0;
        }
        let mut inside = self.phi(origin + direction * t) < 0.0;
        while length < enough {
            let next = self.change(origin, direction, inside, t, to);
            let end = next.unwrap_or(to);
            if inside {
                length += end - t;
            }
            if next.is_none() {
                break;
            }
            t = end;
            inside = !inside;
        }
        length
    }
}
