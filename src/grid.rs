//! The staggered (MAC) grid: centring of all quantities, and their memory layout on the host and on the device.
//!
//! One cell with centre `c` and six faces (Harlow and Welch 1965). Velocity components are stored on the faces they are normal to,
//! pressure and liquid distance at the centre. The *minus* face of an axis has the index of the cell:
//!
//! ```text
//!            +-----v[i,j+1,k]-----+          y
//!           /|                   /|          |
//!          / |    w[i,j,k]      / |          |
//!         +--------------------+  |          +---- x
//!   u[i,j,k] |        c        | u[i+1,j,k] /
//!         |  +-----------------|--+        z
//!         | /   w[i,j,k+1]     | /
//!         |/                   |/
//!         +-----v[i,j,k]-------+
//! ```
//!
//! The origin is the low corner of the domain. The centre of cell (i, j, k) is (i + 1/2, j + 1/2, k + 1/2) dx. Its minus x face
//! has the centre (i, j + 1/2, k + 1/2) dx. x is fastest in memory everywhere.
//!
//! **Host arrays** are dense and unpadded: `nx ny nz` cells, `(nx + 1) ny nz` x faces, and so on.
//!
//! **Device arrays** are padded ([`Padded`]): neighbours are constant strides apart, four cells along x (a *quad*) are read at once, and
//! kernels test no borders. Cells and the minus faces of all axes share one layout.

use glam::DVec3;

/// An axis of the grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// x
    X,
    /// y
    Y,
    /// z
    Z,
}

impl Axis {
    /// All axes in order.
    pub const ALL: [Axis; 3] = [Axis::X, Axis::Y, Axis::Z];

    /// 0, 1 or 2.
    pub fn index(self) -> usize {
        self as usize
    }
}

/// A set of sides of the domain, named as in scene files, `-x` to `+z`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sides(u32);

impl Sides {
    /// Names of all six sides.
    pub const NAMES: [&'static str; 6] = ["-x", "+x", "-y", "+y", "-z", "+z"];

    /// Adds the minus (0) or the plus side (1) of an axis.
    pub fn with(self, axis: Axis, side: usize) -> Sides {
        Sides(self.0 | 1 << (2 * axis.index() + side))
    }

    /// Whether the set contains the minus (0) or the plus side (1) of an axis.
    #[inline]
    pub fn has(self, axis: Axis, side: usize) -> bool {
        self.0 >> (2 * axis.index() + side) & 1 == 1
    }

    /// Whether the set is not empty.
    pub fn any(self) -> bool {
        self.0 != 0
    }

    /// Bits for kernels (`shaders/common/walls.wgsl`), in the order of the names from the lowest.
    pub fn bits(self) -> u32 {
        self.0
    }

    /// Names of the sides in the set.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        let names = Sides::NAMES.into_iter().enumerate();
        names.filter(move |(bit, _)| self.0 >> bit & 1 == 1).map(|(_, name)| name)
    }
}

/// A MAC grid of cubic cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Cells along x, y, z.
    pub cells: [usize; 3],
    /// Cell size, m.
    pub dx: f64,
}

impl Grid {
    /// Number of cells.
    pub fn n_cells(&self) -> usize {
        self.cells.iter().product()
    }

    /// Index of a cell in a host array.
    #[inline]
    pub fn cell(&self, [i, j, k]: [usize; 3]) -> usize {
        i + self.cells[0] * (j + self.cells[1] * k)
    }

    /// Position of the cell with a host index.
    #[inline]
    pub fn cell_at(&self, index: usize) -> [usize; 3] {
        let [nx, ny, _] = self.cells;
        [index % nx, index / nx % ny, index / (nx * ny)]
    }

    /// Face counts along x, y, z of the faces normal to `axis`: one more than the cells along that axis.
    #[inline]
    pub fn faces(&self, axis: Axis) -> [usize; 3] {
        let mut n = self.cells;
        n[axis.index()] += 1;
        n
    }

    /// Number of faces normal to `axis`.
    pub fn n_faces(&self, axis: Axis) -> usize {
        self.faces(axis).iter().product()
    }

    /// Index of a face normal to `axis` in a host array.
    #[inline]
    pub fn face(&self, axis: Axis, [i, j, k]: [usize; 3]) -> usize {
        let [nx, ny, _] = self.faces(axis);
        i + nx * (j + ny * k)
    }

    /// Position of the face with a host index.
    #[inline]
    pub fn face_at(&self, axis: Axis, index: usize) -> [usize; 3] {
        let [nx, ny, _] = self.faces(axis);
        [index % nx, index / nx % ny, index / (nx * ny)]
    }

    /// Centre of a cell, m.
    #[inline]
    pub fn cell_centre(&self, [i, j, k]: [usize; 3]) -> DVec3 {
        DVec3::new(i as f64 + 0.5, j as f64 + 0.5, k as f64 + 0.5) * self.dx
    }

    /// Centre of a face, m.
    #[inline]
    pub fn face_centre(&self, axis: Axis, ijk: [usize; 3]) -> DVec3 {
        let mut x = self.cell_centre(ijk);
        x[axis.index()] -= 0.5 * self.dx;
        x
    }

    /// Size of the domain, m.
    pub fn size(&self) -> DVec3 {
        DVec3::new(self.cells[0] as f64, self.cells[1] as f64, self.cells[2] as f64) * self.dx
    }

    /// Volume of a cell, m^3.
    pub fn cell_volume(&self) -> f64 {
        self.dx.powi(3)
    }

    /// Stencil of the eight faces of `axis` around `x` (m).
    #[inline]
    pub fn faces_around(&self, axis: Axis, x: DVec3) -> Corner {
        let mut offset = DVec3::splat(0.5);
        offset[axis.index()] = 0.0;
        Corner::new(self.faces(axis), x / self.dx - offset)
    }

    /// Trilinear interpolation at `x` (m) of the host face field of `axis`; the continuous index is clamped to the field.
    #[inline]
    pub fn sample(&self, axis: Axis, field: &[f64], x: DVec3) -> f64 {
        self.faces_around(axis, x).interpolate(field)
    }

    /// Stencil of the eight cell centres around `x` (m).
    #[inline]
    pub fn centres_around(&self, x: DVec3) -> Corner {
        Corner::new(self.cells, x / self.dx - 0.5)
    }

    /// Trilinear interpolation at `x` (m) of a cell-centred host field, constant beyond the outermost centres.
    #[inline]
    pub fn sample_cells(&self, field: &[f64], x: DVec3) -> f64 {
        self.centres_around(x).interpolate(field)
    }

    /// Velocity at `x` (m): the samples of the three face fields.
    #[inline]
    pub fn velocity_at(&self, velocity: &[Vec<f64>; 3], x: DVec3) -> DVec3 {
        DVec3::from_array(Axis::ALL.map(|axis| self.sample(axis, &velocity[axis.index()], x)))
    }

    /// Velocity of a cell, the mean of those of opposite faces, m/s.
    pub fn cell_velocity(&self, velocity: &[Vec<f64>; 3], cell: usize) -> DVec3 {
        let ijk = self.cell_at(cell);
        DVec3::from_array(Axis::ALL.map(|axis| {
            let mut plus = ijk;
            plus[axis.index()] += 1;
            let faces = &velocity[axis.index()];
            0.5 * (faces[self.face(axis, ijk)] + faces[self.face(axis, plus)])
        }))
    }

    /// Position (m) of what starts at `x` (m) after dt (s) in a velocity, by the midpoint rule. A negative dt leads back.
    #[inline]
    pub fn traced(&self, velocity: &[Vec<f64>; 3], x: DVec3, dt: f64) -> DVec3 {
        let middle = x + 0.5 * dt * self.velocity_at(velocity, x);
        x + dt * self.velocity_at(velocity, middle)
    }

    /// The cells on the minus and plus side of a face; `None` beyond the domain.
    #[inline]
    pub fn face_sides(&self, axis: Axis, ijk: [usize; 3]) -> [Option<usize>; 2] {
        let a = axis.index();
        let mut minus = ijk;
        let minus = (ijk[a] > 0).then(|| {
            minus[a] -= 1;
            self.cell(minus)
        });
        [minus, (ijk[a] < self.cells[a]).then(|| self.cell(ijk))]
    }

    /// The wall of a face: 0 for the minus, 1 for the plus side of its axis; `None` for inner faces.
    #[inline]
    pub fn wall(&self, axis: Axis, ijk: [usize; 3]) -> Option<usize> {
        match ijk[axis.index()] {
            0 => Some(0),
            at if at == self.cells[axis.index()] => Some(1),
            _ => None,
        }
    }

    /// The device layout of this grid.
    pub fn padded(&self) -> Padded {
        Padded::new(self.cells)
    }
}

/// Stencil of eight points around a position in an array of extents `n`, for trilinear interpolation.
#[derive(Clone, Copy, Debug)]
pub struct Corner {
    /// Index of the lowest point.
    low: usize,
    /// Stride to the upper neighbour along each axis; 0 in an array one point thick.
    up: [usize; 3],
    /// Fractional position between the points, 0 to 1.
    pub between: [f64; 3],
}

impl Corner {
    /// Stencil around the continuous index `at`, which is clamped to the array.
    #[inline]
    pub fn new(n: [usize; 3], at: DVec3) -> Corner {
        let stride = [1, n[0], n[0] * n[1]];
        let mut corner = Corner { low: 0, up: [0; 3], between: [0.0; 3] };
        for b in 0..3 {
            let index = at[b].clamp(0.0, (n[b] - 1) as f64);
            // The upper end belongs to the last interval.
            let low = (index as usize).min(n[b].saturating_sub(2));
            corner.low += stride[b] * low;
            corner.up[b] = if n[b] > 1 { stride[b] } else { 0 };
            corner.between[b] = index - low as f64;
        }
        corner
    }

    /// Values at the eight points, x fastest, then y, then z.
    #[inline]
    pub fn values(&self, field: &[f64]) -> [f64; 8] {
        std::array::from_fn(|c| {
            let offset: usize = (0..3).map(|b| if c >> b & 1 == 1 { self.up[b] } else { 0 }).sum();
            field[self.low + offset]
        })
    }

    /// Interpolated value.
    #[inline]
    pub fn interpolate(&self, field: &[f64]) -> f64 {
        Corner::mix(&self.values(field), self.between)
    }

    /// Trilinear interpolation of eight values, x fastest, then y, then z.
    #[inline]
    pub fn mix(v: &[f64; 8], [x, y, z]: [f64; 3]) -> f64 {
        let mix = |low: f64, high: f64, f: f64| low + (high - low) * f;
        let along_x = [0, 2, 4, 6].map(|c| mix(v[c], v[c + 1], x));
        let low = mix(along_x[0], along_x[1], y);
        mix(low, mix(along_x[2], along_x[3], y), z)
    }

    /// The eight (index, weight) pairs.
    pub fn weights(&self) -> [(usize, f64); 8] {
        std::array::from_fn(|c| {
            let mut point = (self.low, 1.0);
            for b in 0..3 {
                let upper = c >> b & 1 == 1;
                point.0 += if upper { self.up[b] } else { 0 };
                point.1 *= if upper { self.between[b] } else { 1.0 - self.between[b] };
            }
            point
        })
    }
}

/// Device layout of one level: rows of quads (runs of four cells along x).
///
/// Each row ends with a spare cell, each slab with a spare row; one spare slab precedes the level and two follow. A spare cell
/// is the neighbour beyond the end of its row and before the start of the next. Spare cells are zero (inactive, closed).
///
/// The number of quads is a multiple of 4, so that kernels read flags of four quads at once. Rows are a multiple of 8 cells
/// long, so that the 8 fine cells of a coarse quad are two quads of one row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Padded {
    /// Cells along x, y, z.
    pub cells: [usize; 3],
    /// Quads per row, the stride along y.
    pub stride_y: usize,
    /// Quads per slab, the stride along z.
    pub stride_z: usize,
    /// Total number of quads.
    pub quads: usize,
}

impl Padded {
    /// Layout for a level of `cells`.
    pub fn new(cells: [usize; 3]) -> Padded {
        let stride_y = 2 * (cells[0] / 8 + 1);
        let stride_z = stride_y * (cells[1] + 1);
        Padded { cells, stride_y, stride_z, quads: (stride_z * (cells[2] + 3)).next_multiple_of(4) }
    }

    /// Number of scalars.
    pub fn len(&self) -> usize {
        4 * self.quads
    }

    /// Always false; clippy requires it beside [`Padded::len`].
    pub fn is_empty(&self) -> bool {
        self.quads == 0
    }

    /// Kernel uniform for arrays of this level alone.
    pub fn layout(&self) -> Layout {
        self.layout_at(0, self.quads)
    }

    /// Kernel uniform for arrays of `total` quads with this level from quad `first` on.
    pub fn layout_at(&self, first: usize, total: usize) -> Layout {
        Layout {
            cells: self.cells.map(|n| n as u32),
            stride_y: self.stride_y as u32,
            stride_z: self.stride_z as u32,
            quads: self.quads as u32,
            first: first as u32,
            total: total as u32,
        }
    }

    /// Index of cell (i, j, k), or of its minus face, in a device array of scalars.
    #[inline]
    pub fn index(&self, [i, j, k]: [usize; 3]) -> usize {
        4 * (self.stride_z * (k + 1) + self.stride_y * j) + i
    }

    /// First cell of a quad, which lies in a row of the domain.
    pub fn cell_of(&self, quad: usize) -> [usize; 3] {
        let (slab, in_slab) = (quad / self.stride_z, quad % self.stride_z);
        let (row, in_row) = (in_slab / self.stride_y, in_slab % self.stride_y);
        [4 * in_row, row, slab - 1]
    }

    /// Pads a host array of extents `n` (cells or faces) with zeros.
    pub fn pad<T: Copy, U: Copy + Default>(&self, n: [usize; 3], host: &[T], convert: impl Fn(T) -> U) -> Vec<U> {
        let mut device = vec![U::default(); self.len()];
        for (row, values) in host.chunks_exact(n[0]).enumerate() {
            let start = self.index([0, row % n[1], row / n[1]]);
            for (slot, &value) in device[start..].iter_mut().zip(values) {
                *slot = convert(value);
            }
        }
        device
    }

    /// Extracts the host array of extents `n` from a device array.
    pub fn unpad<T: Copy, U>(&self, n: [usize; 3], device: &[T], convert: impl Fn(T) -> U) -> Vec<U> {
        let mut host = Vec::with_capacity(n.iter().product());
        for k in 0..n[2] {
            for j in 0..n[1] {
                let start = self.index([0, j, k]);
                host.extend(device[start..start + n[0]].iter().map(|&value| convert(value)));
            }
        }
        host
    }
}

/// Kernel uniform of a [`Padded`] level.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Layout {
    /// Cells along x, y, z.
    pub cells: [u32; 3],
    /// Quads from one row to the next.
    pub stride_y: u32,
    /// Quads from one slab to the next.
    pub stride_z: u32,
    /// Quads of the level.
    pub quads: u32,
    /// First quad of the level in arrays of several levels.
    pub first: u32,
    /// Quads of these arrays.
    pub total: u32,
}
