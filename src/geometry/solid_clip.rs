//! `clip` for deforming solids, on top of the obstacles, in every sub-step.
//!
//! Aperture changes of all bodies add up before clamping. The obstacles' apertures are stored, so a sub-step updates only the
//! grid lines and cells that solids meet, and restores those of the previous sub-step. The result depends on the positions
//! alone.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::clip::{Clipping, Patch, clip};
use super::coupling::Coupling;
use super::distance::{BAND, ClosedMesh};
use super::nearest::{Lattice, NearestTriangles, inside_tetrahedra};
use super::{CutCells, ObstacleCut, Surface, clamp_open, is_wall};
use crate::grid::{Axis, Grid};
use crate::scene::{FaceAreas, Scene, Solver};

/// The deformed mesh of all solids.
#[derive(Clone, Debug)]
pub struct MovedMesh<'a> {
    /// Positions, m.
    pub nodes: Vec<DVec3>,
    /// Nodes of the tetrahedra.
    pub elements: &'a [[u32; 4]],
    /// Nodes of the surface triangles, counter-clockwise seen from outside.
    pub triangles: &'a [[u32; 3]],
    /// Elements of each solid, one solid after another.
    pub bodies: Vec<Range<usize>>,
}

impl MovedMesh<'_> {
    /// Surface of all solids for distance queries; `None` without any.
    pub(super) fn closed(&self) -> Option<ClosedMesh> {
        let triangles = self.triangles.to_vec();
        (!triangles.is_empty()).then(|| ClosedMesh::new(self.nodes.clone(), triangles))
    }

    /// Surface of each solid.
    pub(super) fn closed_bodies(&self) -> Vec<ClosedMesh> {
        let mut body_of_node = vec![0; self.nodes.len()];
        for (number, body) in self.bodies.iter().enumerate() {
            for &node in self.elements[body.clone()].as_flattened() {
                body_of_node[node as usize] = number;
            }
        }
        let mut bodies = vec![Surface::default(); self.bodies.len()];
        for &triangle in self.triangles {
            let body = &mut bodies[body_of_node[triangle[0] as usize]];
            let first = body.vertices.len() as u32;
            let corners = triangle.map(|node| self.nodes[node as usize]);
            body.vertices.extend(corners);
            body.triangles.push([first, first + 1, first + 2]);
        }
        let closed = |body: &Surface| {
            let Surface { vertices, triangles } = body.welded();
            ClosedMesh::new(vertices, triangles)
        };
        bodies.iter().map(closed).collect()
    }
}

/// Nearest surface point of the solids to a cell centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// Host index.
    pub cell: usize,
    /// Surface triangle.
    pub triangle: usize,
    /// Barycentric coordinates.
    pub weights: [f64; 3],
}

/// Moving surface beside a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MovingWall {
    /// A point on a solid.
    Solid(Nearest),
    /// An obstacle.
    Obstacle {
        /// Host index.
        cell: usize,
        /// Velocity of the obstacle, m/s.
        velocity: DVec3,
    },
}

impl MovingWall {
    /// Host index of the cell.
    pub fn cell(&self) -> usize {
        match self {
            MovingWall::Solid(nearest) => nearest.cell,
            MovingWall::Obstacle { cell, .. } => *cell,
        }
    }
}

/// Overlap of solids with each other or with obstacles.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Overlap {
    /// Cells with a centre in two solids, or in a solid and an obstacle.
    pub cells: usize,
    /// Thickness of the overlap, m: twice the largest distance of such a centre to the nearest surface.
    pub depth: f64,
}

impl Overlap {
    /// Overlap of solids with each other, in a scene without liquid, which clips nothing.
    pub fn between_solids(grid: &Grid, mesh: &MovedMesh) -> Overlap {
        let lattice = centres(grid);
        let inside = inside_tetrahedra(&lattice, mesh.elements, body_of(mesh), &mesh.nodes);
        let cells = inside.chunk_by(|a, b| a.0 == b.0);
        let shared: Vec<usize> = cells.filter(|bodies| bodies.len() > 1).map(|bodies| bodies[0].0).collect();
        let mut overlap = Overlap::default();
        if shared.is_empty() {
            return overlap;
        }
        let triangles = mesh.triangles.iter();
        let corners = triangles.map(|triangle| triangle.map(|node| mesh.nodes[node as usize]));
        let reach = BAND * grid.dx;
        let mut near = NearestTriangles::new(lattice, reach);
        near.update(&corners.collect::<Vec<_>>());
        for cell in shared {
            overlap.add(near.distance(cell).min(reach), grid.dx);
        }
        overlap
    }

    /// Counts a cell with its centre at a depth (m) in the overlap.
    fn add(&mut self, depth: f64, dx: f64) {
        if depth > TOUCHES * dx {
            self.cells += 1;
            self.depth = self.depth.max(2.0 * depth);
        }
    }
}

fn centres(grid: &Grid) -> Lattice {
    Lattice { n: grid.cells, offset: 0.5, dx: grid.dx }
}

/// The cut cells of a scene with solids.
#[derive(Clone, Debug)]
pub struct SolidClip {
    grid: Grid,
    area_clamp: f64,
    obstacles: ObstacleCut,
    cut: CutCells,
    /// Faces and cells that differ from those of the obstacles.
    changed_faces: [Vec<usize>; 3],
    changed_cells: Vec<usize>,
    near_centres: NearestTriangles,
    /// Present with nodal face areas.
    near_corners: Option<NearestTriangles>,
    patches: Vec<Patch>,
    coupling: Coupling,
    band: Vec<Nearest>,
    overlap: Overlap,
    closure_defect: f64,
}

/// Half width of the narrow band of corner distances for nodal face areas, cells.
const CORNER_BAND: f64 = 2.0;

/// Depth of touching surfaces, cells.
const TOUCHES: f64 = 1e-6;

impl SolidClip {
    /// Starts with the obstacles alone.
    pub fn new(grid: &Grid, obstacles: ObstacleCut, settings: &Solver) -> SolidClip {
        let corners = || {
            let lattice = Lattice { n: grid.cells.map(|n| n + 1), offset: 0.0, dx: grid.dx };
            NearestTriangles::new(lattice, CORNER_BAND * grid.dx)
        };
        SolidClip {
            grid: *grid,
            area_clamp: settings.area_clamp,
            cut: obstacles.cut.clone(),
            obstacles,
            changed_faces: Default::default(),
            changed_cells: Vec::new(),
            near_centres: NearestTriangles::new(centres(grid), BAND * grid.dx),
            near_corners: (settings.face_areas == FaceAreas::Nodal).then(corners),
            patches: Vec::new(),
            coupling: Coupling::default(),
            band: Vec::new(),
            overlap: Overlap::default(),
            closure_defect: 0.0,
        }
    }

    /// Copies the keyframes of a scene's obstacles: see [`ObstacleCut::follow`].
    pub fn follow(&mut self, scene: &Scene) {
        self.obstacles.follow(scene);
    }

    /// Moves the obstacles as [`ObstacleCut::move_to`] does; precedes [`SolidClip::clip`].
    pub fn move_obstacles(&mut self, time: f64, dt: f64) {
        self.restore();
        let SolidClip { cut, obstacles, .. } = self;
        let differed = |obstacles: &ObstacleCut| {
            let (faces, cells) = obstacles.changed();
            (faces.map(<[usize]>::to_vec), cells.to_vec())
        };
        let before = differed(obstacles);
        obstacles.move_to(time, dt);
        for (faces, cells) in [before, differed(obstacles)] {
            for (a, faces) in faces.into_iter().enumerate() {
                for face in faces {
                    cut.open[a][face] = obstacles.cut.open[a][face];
                }
            }
            for cell in cells {
                cut.solid_distance[cell] = obstacles.cut.solid_distance[cell];
            }
        }
    }

    /// Clips the solids at their positions.
    pub fn clip(&mut self, mesh: &MovedMesh) {
        self.restore();
        let surface = Surface { vertices: mesh.nodes.clone(), triangles: mesh.triangles.to_vec() };
        let corners: Vec<[DVec3; 3]> = (0..surface.triangles.len()).map(|triangle| surface.corners(triangle)).collect();
        let SolidClip { grid, cut, obstacles, near_centres, near_corners, .. } = self;
        let left = &obstacles.cut.solid_distance;
        let cut_surface = || {
            let clipping = clip(&surface, grid);
            let coupling = || Coupling::new(&clipping.patches, mesh.triangles, mesh.nodes.len());
            let (coupling, sums) = rayon::join(coupling, || all_line_sums(grid, &clipping));
            (clipping.patches, coupling, sums)
        };
        let distances = || Distances::new(grid, near_centres, left, mesh, &corners);
        let ((patches, coupling, mut sums), distances) = rayon::join(cut_surface, distances);
        (self.patches, self.coupling) = (patches, coupling);
        self.closure_defect = sums.iter().map(|(_, defect)| *defect).fold(0.0, f64::max);
        if let Some(near) = near_corners {
            near.update(&corners);
            for (sums, areas) in sums.iter_mut().zip(nodal_areas(grid, near, mesh)) {
                sums.0 = areas;
            }
        }
        let (raw, clamp, open_sides) = (&obstacles.raw, self.area_clamp, obstacles.open_sides);
        let axes = Axis::ALL.into_par_iter().zip(&mut cut.open).zip(&mut self.changed_faces).zip(sums);
        axes.for_each(|(((axis, open), changed), (changes, _))| {
            for (face, change) in changes {
                if !is_wall(grid, open_sides, axis, grid.face_at(axis, face)) {
                    open[face] = clamp_open(raw[axis.index()][face] + change, clamp);
                    changed.push(face);
                }
            }
        });
        self.band = distances.band;
        self.overlap = distances.overlap;
        self.changed_cells.extend(distances.cells.iter().map(|(cell, _)| cell));
        for (cell, distance) in distances.cells {
            cut.solid_distance[cell] = distance;
        }
    }

    fn restore(&mut self) {
        let left = &self.obstacles.cut;
        let axes = self.changed_faces.par_iter_mut().zip(&mut self.cut.open).zip(&left.open);
        axes.for_each(|((faces, open), left)| {
            for face in faces.drain(..) {
                open[face] = left[face];
            }
        });
        for cell in self.changed_cells.drain(..) {
            self.cut.solid_distance[cell] = left.solid_distance[cell];
        }
    }

    /// The cut cells of obstacles and solids.
    pub fn cut_cells(&self) -> &CutCells {
        &self.cut
    }

    /// The obstacles at their positions.
    pub fn obstacles(&self) -> &ObstacleCut {
        &self.obstacles
    }

    /// Faces per axis, and cells, that differ from those of the static obstacles, by moving obstacles, then by solids;
    /// unsorted, with repetitions.
    pub fn changed(&self) -> [([&[usize]; 3], &[usize]); 2] {
        let solids = (self.changed_faces.each_ref().map(Vec::as_slice), self.changed_cells.as_slice());
        [self.obstacles.changed(), solids]
    }

    /// Cells beside a moving surface, ascending.
    pub fn moving_walls(&self) -> Vec<MovingWall> {
        let solids = self.band.iter().copied().map(MovingWall::Solid);
        let obstacles = self.obstacles.wall_velocities().iter();
        let obstacles = obstacles
            .filter(|(cell, _)| self.nearest(*cell).is_none())
            .map(|&(cell, velocity)| MovingWall::Obstacle { cell, velocity });
        let mut walls: Vec<MovingWall> = solids.chain(obstacles).collect();
        walls.sort_by_key(MovingWall::cell);
        walls
    }

    /// The patches of the solids in the cells of the domain, in the order of the triangles.
    pub fn patches(&self) -> &[Patch] {
        &self.patches
    }

    /// J over all cells with patches.
    pub fn coupling(&self) -> &Coupling {
        &self.coupling
    }

    /// Nearest surface points of the solids for cell centres within three cells of them and nearer to them than to
    /// obstacles; cells ascending.
    pub fn band(&self) -> &[Nearest] {
        &self.band
    }

    /// The nearest surface point for a cell of the band.
    pub fn nearest(&self, cell: usize) -> Option<&Nearest> {
        let at = self.band.binary_search_by_key(&cell, |nearest| nearest.cell);
        at.ok().map(|at| &self.band[at])
    }

    /// Overlap of solids with each other and with obstacles.
    pub fn overlap(&self) -> Overlap {
        self.overlap
    }

    /// Largest closure defect of a grid line: rounding.
    pub fn closure_defect(&self) -> f64 {
        self.closure_defect
    }
}

/// Distances at cell centres near the solids and in them.
struct Distances {
    /// Cells near a surface, ascending, then those deeper in the solids, with their distance to obstacles and solids, m.
    cells: Vec<(usize, f64)>,
    band: Vec<Nearest>,
    overlap: Overlap,
}

impl Distances {
    /// `left`: distance to the obstacles, m. `corners`: those of the surface triangles.
    fn new(
        grid: &Grid,
        near: &mut NearestTriangles,
        left: &[f64],
        mesh: &MovedMesh,
        corners: &[[DVec3; 3]],
    ) -> Distances {
        let (points, ()) = rayon::join(
            || inside_tetrahedra(&centres(grid), mesh.elements, body_of(mesh), &mesh.nodes),
            || near.update(corners),
        );
        let reach = BAND * grid.dx;
        let inside = |cell: usize| points.binary_search_by_key(&cell, |point| point.0).is_ok();
        let near_cells = near.near.par_iter().map(|&cell| {
            let distance = near.distance(cell).min(reach);
            let distance = if inside(cell) { -distance } else { distance };
            // A nearer obstacle takes precedence.
            let nearest = (distance < left[cell]).then(|| near.nearest(cell, |triangle| corners[triangle])).flatten();
            let nearest = nearest.map(|(triangle, weights)| Nearest { cell, triangle, weights });
            ((cell, distance.min(left[cell])), nearest)
        });
        let (mut cells, band): (Vec<(usize, f64)>, Vec<Option<Nearest>>) = near_cells.unzip();
        let mut overlap = Overlap::default();
        for bodies in points.chunk_by(|a, b| a.0 == b.0) {
            let cell = bodies[0].0;
            let distance = -near.distance(cell).min(reach);
            let shared = match bodies.len() {
                1 => distance.max(left[cell]),
                _ => distance,
            };
            overlap.add(-shared, grid.dx);
            // Deeper than the band.
            if distance == -reach {
                cells.push((cell, -reach));
            }
        }
        Distances { cells, band: band.into_iter().flatten().collect(), overlap }
    }
}

fn body_of(mesh: &MovedMesh) -> impl Fn(usize) -> u32 + Sync {
    |element| mesh.bodies.partition_point(|body| body.end <= element) as u32
}

/// [`line_sums`] of all axes.
fn all_line_sums(grid: &Grid, clipping: &Clipping) -> [(Vec<(usize, f64)>, f64); 3] {
    let mut sums = Axis::ALL.map(|_| (Vec::new(), 0.0));
    let axes = Axis::ALL.into_par_iter().zip(&mut sums);
    axes.for_each(|(axis, sums)| *sums = line_sums(grid, axis, clipping));
    sums
}

/// Aperture changes (face, change) along the grid lines of an axis that meet a surface, and their largest closure defect.
pub(super) fn line_sums(grid: &Grid, axis: Axis, clipping: &Clipping) -> (Vec<(usize, f64)>, f64) {
    let a = axis.index();
    let per_area = 1.0 / (grid.dx * grid.dx);
    // The first face identifies a line.
    let line = |mut cell: [usize; 3]| {
        cell[a] = 0;
        grid.face(axis, cell)
    };
    let patches = clipping.patches.iter().map(|patch| {
        let cell = grid.cell_at(patch.cell);
        let flux = patch.area * patch.normal[a] * per_area;
        (line(cell), cell[a] as isize, flux)
    });
    let ghosts = clipping.ghosts.iter().filter(|ghost| ghost.axis == axis);
    let ghosts = ghosts.map(|ghost| {
        let cell = ghost.cell.map(|at| at.max(0) as usize);
        (line(cell), ghost.cell[a], ghost.flux)
    });
    let mut crossings: Vec<(usize, isize, f64)> = patches.chain(ghosts).collect();
    crossings.par_sort_by_key(|&(line, at, _)| (line, at));
    let [nx, ny, _] = grid.faces(axis);
    let stride = [1, nx, nx * ny][a];
    let (mut changes, mut defect) = (Vec::new(), 0.0_f64);
    for crossings in crossings.chunk_by(|a, b| a.0 == b.0) {
        let mut change = 0.0;
        for (number, &(line, at, flux)) in crossings.iter().enumerate() {
            change -= flux;
            if let Some(&(_, next, _)) = crossings.get(number + 1) {
                let faces = at + 1..=next;
                changes.extend(faces.map(|face| (line + stride * face as usize, change)));
            }
        }
        defect = defect.max(change.abs());
    }
    (changes, defect)
}

/// Aperture changes from the distance at the corners of cells (thesis, figure 5.2): minus the solid part of each face, with
/// distances linear along its sides.
fn nodal_areas(grid: &Grid, near: &NearestTriangles, mesh: &MovedMesh) -> [Vec<(usize, f64)>; 3] {
    let lattice = near.lattice;
    let points = inside_tetrahedra(&lattice, mesh.elements, body_of(mesh), &mesh.nodes);
    let mut inside: Vec<usize> = points.into_iter().map(|(corner, _)| corner).collect();
    inside.dedup();
    let [nx, ny, _] = lattice.n;
    let strides = [1, nx, nx * ny];
    let signed = |corner: usize| {
        let distance = near.distance(corner).min(CORNER_BAND * grid.dx);
        match inside.binary_search(&corner) {
            Ok(_) => -distance,
            Err(_) => distance,
        }
    };
    Axis::ALL.map(|axis| {
        let a = axis.index();
        let [b, c] = [(a + 1) % 3, (a + 2) % 3];
        let n = grid.faces(axis);
        let around = |&corner: &usize| {
            let ijk = [corner % nx, corner / nx % ny, corner / (nx * ny)];
            [[0, 0], [1, 0], [0, 1], [1, 1]].into_iter().filter_map(move |back| {
                let mut face = ijk;
                face[b] = ijk[b].checked_sub(back[0])?;
                face[c] = ijk[c].checked_sub(back[1])?;
                (face[b] < n[b] && face[c] < n[c]).then(|| grid.face(axis, face))
            })
        };
        let mut faces: Vec<usize> = inside.iter().flat_map(around).collect();
        faces.sort_unstable();
        faces.dedup();
        let area = faces.par_iter().map(|&face| {
            let [i, j, k] = grid.face_at(axis, face);
            let first = i + nx * (j + ny * k);
            let corners = [0, strides[b], strides[b] + strides[c], strides[c]];
            (face, -negative_part(corners.map(|step| signed(first + step))))
        });
        area.collect()
    })
}

/// Area fraction of a square with a negative distance; `corners` are in cyclic order.
fn negative_part(corners: [f64; 4]) -> f64 {
    let negative = corners.map(|distance| distance < 0.0);
    // Fraction of a side, from one end, with the sign of that end.
    let reach = |from: usize, to: usize| corners[from] / (corners[from] - corners[to]);
    // Triangle at a corner whose neighbours have the other sign.
    let tip = |corner: usize| 0.5 * reach(corner, (corner + 1) % 4) * reach(corner, (corner + 3) % 4);
    let alone = |sign: bool| (0..4).filter(move |&corner| negative[corner] == sign);
    match negative.into_iter().filter(|&negative| negative).count() {
        0 => 0.0,
        1 => alone(true).map(tip).sum(),
        3 => 1.0 - alone(false).map(tip).sum::<f64>(),
        4 => 1.0,
        _ if negative[0] == negative[2] => alone(true).map(tip).sum(),
        _ => {
            // A trapezium between two neighbouring corners.
            let first = (0..4).find(|&at| negative[at] && negative[(at + 1) % 4]);
            let first = first.expect("two neighbours are negative");
            let second = (first + 1) % 4;
            0.5 * (reach(first, (first + 3) % 4) + reach(second, (second + 1) % 4))
        }
    }
}
