//! Cut cells of solids that move, and J, against independent constructions.

use cutwater::elastic::Solids;
use cutwater::geometry::{
    Coupling, CutCells, MovedMesh, ObstacleSurfaces, SolidClip, Surface, clip, obstacle_cut, open_fractions,
};
use cutwater::grid::{Axis, Grid};
use cutwater::linalg::dot;
use cutwater::scene::{FaceAreas, Obstacle, Placement, Scene, Shape, Solver};
use glam::{DMat3, DVec3};

use crate::common::Random;
use crate::elastic::random_rotation;
use crate::solid_scene::{block, displaced, noise, scene_of, solids_of};

/// Clamps only what rounding leaves.
const NO_CLAMP: f64 = 1e-11;

/// Solids in the scene's domain of 4 x 4 x 4 m, cut into cells that are no cube of a number.
struct Case {
    name: String,
    scene: Scene,
    solids: Solids,
    displacement: Vec<[f64; 3]>,
}

impl Case {
    fn new(name: String, size: [f64; 3], bricks: [usize; 3], x: impl Fn(DVec3) -> DVec3) -> Case {
        let mut scene = scene_of(vec![block(size, bricks)]);
        scene.domain.cells = [16; 3];
        scene.solver.area_clamp = NO_CLAMP;
        let solids = solids_of(&scene);
        let displacement = displaced(&solids, x);
        Case { name, scene, solids, displacement }
    }

    fn mesh(&self) -> MovedMesh<'_> {
        self.solids.moved(&self.displacement)
    }

    fn clip(&self) -> SolidClip {
        let grid = self.scene.grid();
        let mut clip = SolidClip::new(&grid, obstacle_cut(&self.scene, &grid).unwrap(), &self.scene.solver);
        clip.clip(&self.mesh());
        clip
    }

    fn surface(&self) -> Surface {
        let mesh = self.mesh();
        Surface { vertices: mesh.nodes, triangles: mesh.triangles.to_vec() }
    }
}

/// Turned, thin, on the planes of the grid, across walls and corners, bent.
fn cases() -> Vec<Case> {
    let mut random = Random(3);
    let mut cases = Vec::new();
    for number in 0..4 {
        let turn = random_rotation(&mut random);
        let at = DVec3::from([0; 3].map(|_| random.uniform(1.3, 2.7)));
        let corner = DVec3::from([0; 3].map(|_| 4.0 * random.uniform(0.0, 2.0).floor()));
        let moved = |to: DVec3| move |x: DVec3| turn * (x - 0.5) + to;
        let mut add = |name: &str, size, bricks, to| {
            cases.push(Case::new(format!("{name} {number}"), size, bricks, moved(to)));
        };
        add("block", [0.9, 0.7, 1.1], [3, 2, 4], at);
        add("plate", [1.3, 0.02, 1.1], [5, 1, 4], at);
        add("needle", [0.003, 1.3, 0.002], [1, 6, 1], at);
        add("block in a corner", [1.1, 0.9, 1.3], [2, 2, 2], corner);
        add("large plate", [9.0, 0.3, 7.0], [4, 1, 3], at);
    }
    let straight = |name: &str, size, bricks, to: DVec3| Case::new(name.into(), size, bricks, move |x| x + to);
    cases.extend([
        straight("on planes", [1.0, 0.5, 0.75], [4, 2, 3], DVec3::splat(1.25)),
        straight("almost on planes", [1.0, 0.5, 0.75], [4, 2, 3], DVec3::splat(1.25 + 1e-11)),
        straight("in a corner", [1.0, 0.5, 0.75], [4, 2, 3], DVec3::ZERO),
        straight("through two walls", [6.0, 0.6, 0.55], [9, 2, 2], DVec3::new(-1.0, 1.4, 2.1)),
        straight("around all", [6.0, 6.0, 6.0], [2, 2, 2], DVec3::splat(-1.0)),
        straight("beyond", [1.0; 3], [2, 2, 2], DVec3::splat(9.0)),
        Case::new("bent".into(), [0.4, 0.4, 2.8], [2, 2, 14], |x| {
            let (angle, arm) = (0.5 * x.z, x.x + 2.0);
            DVec3::new(arm * angle.cos() - 0.4, x.y + 1.7, arm * angle.sin() + 0.6)
        }),
    ]);
    cases
}

/// The dense sums of all clippings, clamped and closed at the walls.
fn expected_open(grid: &Grid, start: f64, surfaces: &[Surface], clamp: f64) -> [Vec<f64>; 3] {
    let clippings: Vec<_> = surfaces.iter().map(|surface| clip(surface, grid)).collect();
    let sums = open_fractions(grid, start, &clippings);
    assert!(sums.closure_defect <= 1e-12, "{:e}", sums.closure_defect);
    let mut open = sums.faces;
    for axis in Axis::ALL {
        for (face, open) in open[axis.index()].iter_mut().enumerate() {
            let inner = !grid.face_sides(axis, grid.face_at(axis, face)).contains(&None);
            *open = match *open {
                open if !inner || open < clamp => 0.0,
                open if open > 1.0 - clamp => 1.0,
                open => open,
            };
        }
    }
    open
}

fn assert_open(name: &str, got: &CutCells, expected: &[Vec<f64>; 3]) {
    for (got, expected) in got.open.iter().flatten().zip(expected.iter().flatten()) {
        // A clamp may fall on either side of rounding.
        assert!((got - expected).abs() <= 2.0 * NO_CLAMP, "{name}: {got}, {expected}");
    }
}

#[test]
fn open_areas_are_those_of_all_lines_summed() {
    for case in cases() {
        let clip = case.clip();
        assert!(clip.closure_defect() <= 1e-12, "{}", case.name);
        let grid = case.scene.grid();
        let expected = expected_open(&grid, 1.0, &[case.surface()], NO_CLAMP);
        assert_open(&case.name, clip.cut_cells(), &expected);
    }
}

/// Every body moves as one: what J says of its translation is what its patches take from the open faces, per cell.
#[test]
fn j_of_a_translation_closes_every_cell() {
    for case in cases() {
        let (grid, clip) = (case.scene.grid(), case.clip());
        let sums = open_fractions(&grid, 1.0, &[cutwater::geometry::clip(&case.surface(), &grid)]);
        for axis in Axis::ALL {
            let a = axis.index();
            let mut v = vec![[0.0; 3]; case.solids.rest.len()];
            v.iter_mut().for_each(|v| v[a] = 1.0);
            let mut flux = vec![0.0; grid.n_cells()];
            clip.coupling().add_product(v.as_flattened(), &mut flux);
            for (cell, flux) in flux.into_iter().enumerate() {
                let minus = grid.cell_at(cell);
                let mut plus = minus;
                plus[a] += 1;
                let [minus, plus] = [minus, plus].map(|face| sums.faces[a][grid.face(axis, face)]);
                let defect = flux / (grid.dx * grid.dx) - (minus - plus);
                assert!(defect.abs() <= 1e-12, "{} {axis:?}: {defect:e}", case.name);
            }
        }
    }
}

#[test]
fn j_and_its_transpose_are_adjoint_and_j_takes_barycentric_velocities() {
    let mut random = Random(8);
    for case in cases() {
        let (grid, clip) = (case.scene.grid(), case.clip());
        let n = case.solids.rest.len();
        let v = noise(&mut random, n, 1.0);
        let p: Vec<f64> = (0..grid.n_cells()).map(|_| random.uniform(-1.0, 1.0)).collect();
        let v = v.as_flattened();
        let (mut flux, mut force) = (vec![0.0; p.len()], vec![0.0; v.len()]);
        clip.coupling().add_product(v, &mut flux);
        clip.coupling().add_transposed(&p, &mut force);
        let (left, right) = (dot(&p, &flux), dot(&force, v));
        assert!((left - right).abs() <= 1e-13 * left.abs().max(1.0), "{}", case.name);
        let mut direct = vec![0.0; p.len()];
        for patch in clip.patches() {
            let nodes = case.solids.triangles[patch.triangle];
            let velocity: DVec3 = nodes
                .iter()
                .zip(patch.barycentric)
                .map(|(&node, weight)| weight * DVec3::from_slice(&v[3 * node as usize..]))
                .sum();
            direct[patch.cell] += patch.area * patch.normal.dot(velocity);
        }
        for (flux, direct) in flux.iter().zip(direct) {
            assert!((flux - direct).abs() <= 1e-14, "{}", case.name);
        }
        // Every pair once, in order; those of cells are those of nodes.
        let pairs = clip.coupling().pairs();
        assert!(pairs.windows(2).all(|two| (two[0].cell, two[0].node) < (two[1].cell, two[1].node)));
        let of_nodes: usize = (0..n).map(|node| clip.coupling().node_pairs(node).len()).sum();
        assert_eq!(of_nodes, pairs.len());
        let half = clip.coupling().restricted(|cell| cell % 2 == 0);
        assert!(half.pairs().iter().all(|pair| pair.cell % 2 == 0));
        assert_eq!(half.cells().count(), clip.coupling().cells().filter(|(cell, _)| cell % 2 == 0).count());
    }
}

/// The volume that a body takes, by the divergence theorem over its patches; and linear fields over whole triangles from the
/// patches' moments.
#[test]
fn patches_keep_volume_and_moments() {
    for case in cases() {
        let clip = case.clip();
        let surface = case.surface();
        let [low, high] = surface.bounds();
        if low.min_element() <= 0.0 || high.max_element() >= 4.0 {
            // What lies beyond a wall, or on it, is in no cell.
            continue;
        }
        let about = 0.5 * (low + high);
        let displaced: f64 =
            clip.patches().iter().map(|patch| -patch.area * patch.normal.dot(patch.centroid - about) / 3.0).sum();
        let volume = surface.volume();
        assert!((displaced / volume - 1.0).abs() < 1e-11, "{}", case.name);
        let mut sums = vec![[DVec3::ZERO; 3]; surface.triangles.len()];
        for patch in clip.patches() {
            let of_corners = patch.moments.iter().zip(patch.barycentric);
            for (sum, (moment, weight)) in sums[patch.triangle].iter_mut().zip(of_corners) {
                *sum += moment + weight * patch.area * (patch.centroid - about);
            }
            let sum: DVec3 = patch.moments.into_iter().sum();
            assert!(sum.length() <= 1e-15, "{}", case.name);
        }
        for (triangle, sums) in sums.into_iter().enumerate() {
            let corners = surface.corners(triangle).map(|x| x - about);
            let whole: DVec3 = corners.into_iter().sum();
            let area = surface.area_vector(triangle).length();
            for (sum, corner) in sums.into_iter().zip(corners) {
                let exact = area / 12.0 * (whole + corner);
                assert!(sum.distance(exact) <= 1e-11, "{} {triangle}", case.name);
            }
        }
    }
}

/// Distance to a triangle by its plane, its sides and its corners.
fn to_triangle(x: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let normal = (b - a).cross(c - a);
    let foot = x - normal * ((x - a).dot(normal) / normal.length_squared());
    let side = |p: DVec3, q: DVec3| (q - p).cross(foot - p).dot(normal) >= 0.0;
    if side(a, b) && side(b, c) && side(c, a) {
        return x.distance(foot);
    }
    let to_side = |p: DVec3, q: DVec3| {
        let part = ((x - p).dot(q - p) / (q - p).length_squared()).clamp(0.0, 1.0);
        x.distance(p + part * (q - p))
    };
    to_side(a, b).min(to_side(b, c)).min(to_side(c, a))
}

#[test]
fn distances_and_nearest_places_are_those_of_all_triangles() {
    for case in cases() {
        let (grid, clip) = (case.scene.grid(), case.clip());
        let surface = case.surface();
        let mesh = case.mesh();
        for cell in 0..grid.n_cells() {
            let x = grid.cell_centre(grid.cell_at(cell));
            let triangles = 0..surface.triangles.len();
            let distance = triangles.map(|triangle| to_triangle(x, surface.corners(triangle)));
            let distance = distance.fold(f64::INFINITY, f64::min).min(3.0 * grid.dx);
            let got = clip.cut_cells().solid_distance[cell];
            assert!((got.abs() - distance).abs() <= 1e-12, "{}: {got}, {distance}", case.name);
            let inside = mesh.elements.iter().any(|element| {
                let [a, b, c, d] = element.map(|node| mesh.nodes[node as usize]);
                let weights = DMat3::from_cols(b - a, c - a, d - a).inverse() * (x - a);
                weights.min_element() >= -1e-12 && weights.element_sum() <= 1.0 + 1e-12
            });
            if distance > 1e-6 {
                assert_eq!(got < 0.0, inside, "{} at {x}: {got}", case.name);
            }
            match clip.nearest(cell) {
                None => assert_eq!(distance, 3.0 * grid.dx, "{}", case.name),
                Some(nearest) => {
                    assert_eq!(nearest.cell, cell);
                    let corners = surface.corners(nearest.triangle);
                    let place: DVec3 = (0..3).map(|c| nearest.weights[c] * corners[c]).sum();
                    assert!((place.distance(x) - distance).abs() <= 1e-9, "{}", case.name);
                    assert!(nearest.weights.iter().all(|weight| *weight >= -1e-12));
                }
            }
        }
    }
}

/// What is clipped before changes nothing, and neither does the number of threads.
#[test]
fn a_clip_depends_on_the_positions_alone() {
    let all = cases();
    let grid = all[0].scene.grid();
    for face_areas in [FaceAreas::Clipped, FaceAreas::Nodal] {
        let settings = Solver { face_areas, ..all[0].scene.solver };
        let obstacles = obstacle_cut(&all[0].scene, &grid).unwrap();
        let mut used = SolidClip::new(&grid, obstacles.clone(), &settings);
        for (number, case) in all.iter().enumerate() {
            used.clip(&case.mesh());
            let mut fresh = SolidClip::new(&grid, obstacles.clone(), &settings);
            let pool = rayon::ThreadPoolBuilder::new().num_threads(1 + number % 3);
            pool.build().unwrap().install(|| fresh.clip(&case.mesh()));
            assert_eq!(used.cut_cells().open, fresh.cut_cells().open, "{}", case.name);
            assert_eq!(used.cut_cells().solid_distance, fresh.cut_cells().solid_distance, "{}", case.name);
            assert_eq!(used.patches(), fresh.patches());
            assert_eq!(used.coupling(), fresh.coupling());
            assert_eq!(used.band(), fresh.band());
            assert_eq!(used.overlap(), fresh.overlap());
        }
        // Far away nothing is left of it.
        used.clip(&all[0].solids.moved(&vec![[99.0; 3]; all[0].solids.rest.len()]));
        assert_eq!(used.cut_cells().open, obstacles.cut.open);
        assert_eq!(used.cut_cells().solid_distance, obstacles.cut.solid_distance);
        assert!(used.patches().is_empty() && used.band().is_empty());
    }
}

/// Two blocks that overlap by a known thickness, one of them in an obstacle: contributions add before they are clamped.
#[test]
fn contributions_add_and_overlaps_are_told() {
    let mut scene = scene_of(vec![block([1.0; 3], [3, 3, 3]), block([1.0, 0.8, 0.6], [2, 2, 2])]);
    scene.domain.cells = [32; 3];
    scene.solver.area_clamp = NO_CLAMP;
    let floor = |top: f64| Obstacle {
        shape: Shape::Box { min: DVec3::splat(-1.0), max: DVec3::new(5.0, top, 5.0) },
        placement: Placement::default(),
        inside_out: false,
        motion: None,
        friction: 0.0,
    };
    scene.obstacles = vec![floor(1.07)];
    let solids = solids_of(&scene);
    let grid = scene.grid();
    let first = solids.bodies[0].nodes.end;
    let at = |top: f64, second: DVec3| -> Vec<[f64; 3]> {
        let nodes = 0..solids.rest.len();
        let low = DVec3::new(1.11, top, 1.2);
        nodes.map(|node| if node < first { low } else { low + second }.to_array()).collect()
    };
    // On the floor, the second beside the first; then 0.3 m deep in the floor, the second 0.2 m deep in the first.
    for (top, second, depth, cells) in
        [(1.07, DVec3::new(1.0, 0.0, 0.0), 0.0, 0), (0.77, DVec3::new(0.8, 0.5, 0.1), 0.3, 1)]
    {
        let displacement = at(top, second);
        let mesh = solids.moved(&displacement);
        let mut clip = SolidClip::new(&grid, obstacle_cut(&scene, &grid).unwrap(), &scene.solver);
        clip.clip(&mesh);
        let obstacles = ObstacleSurfaces::new(&scene, &grid).unwrap().at(0.0);
        let mut surfaces = obstacles;
        surfaces.push(Surface { vertices: mesh.nodes.clone(), triangles: mesh.triangles.to_vec() });
        let expected = expected_open(&grid, 1.0, &surfaces, NO_CLAMP);
        assert_open("overlap", clip.cut_cells(), &expected);
        let overlap = clip.overlap();
        assert_eq!(overlap.cells > 0, cells > 0, "{overlap:?}");
        // To twice the way from a plane to the nearest centres.
        assert!((overlap.depth - depth).abs() <= grid.dx, "{overlap:?}");
        for nearest in clip.band() {
            let left = clip.obstacles().cut.solid_distance[nearest.cell];
            assert!(clip.cut_cells().solid_distance[nearest.cell] < left);
        }
    }
}

/// A plane gives the same open areas in both ways; a turned block nearly so.
#[test]
fn nodal_face_areas_are_exact_for_planes() {
    let grid = Case::new(String::new(), [1.0; 3], [1; 3], |x| x).scene.grid();
    let mut random = Random(12);
    let (mut compared, mut sum, mut largest) = (0, 0.0, 0.0_f64);
    for number in 0..4 {
        let turn = random_rotation(&mut random);
        let mut case =
            Case::new(format!("{number}"), [30.0; 3], [1; 3], |x| turn * (x - DVec3::new(30.0, 15.0, 15.0)) + 2.0);
        let clipped = case.clip();
        case.scene.solver.face_areas = FaceAreas::Nodal;
        let nodal = case.clip();
        let fields = clipped.cut_cells().open.iter().zip(&nodal.cut_cells().open);
        for (a, b) in fields.flat_map(|(a, b)| a.iter().zip(b)) {
            assert!((a - b).abs() <= 1e-9, "{a} {b}");
            compared += usize::from(*a > 0.0 && *a < 1.0);
        }
        assert_eq!(clipped.coupling(), nodal.coupling());
        let mut case = Case::new(format!("{number}"), [1.1, 0.9, 1.3], [2, 2, 2], |x| turn * (x - 0.5) + 2.03);
        let clipped = case.clip();
        case.scene.solver.face_areas = FaceAreas::Nodal;
        let nodal = case.clip();
        let fields = clipped.cut_cells().open.iter().zip(&nodal.cut_cells().open);
        for (a, b) in fields.flat_map(|(a, b)| a.iter().zip(b)) {
            sum += (a - b).abs();
            largest = largest.max((a - b).abs());
        }
    }
    assert!(compared > 500, "{compared} faces are cut");
    // A chord across the corner of a cut misses half a face at most. Edges of a block make such corners, sqrt(3) to a dx of their length.
    let edges = 4.0 * 4.0 * (1.1 + 0.9 + 1.3);
    let corners = 3.0_f64.sqrt() * edges / grid.dx;
    println!("{sum} on {corners} faces");
    assert!(largest > 0.0 && sum < 0.5 * corners, "{sum} {largest}");
}

#[test]
fn nothing_couples_nothing() {
    let nothing = Coupling::new(&[], &[], 3);
    let mut out = vec![0.0; 9];
    nothing.add_transposed(&[1.0; 4], &mut out);
    assert_eq!(out, [0.0; 9]);
    assert!(nothing.pairs().is_empty() && nothing.cells().next().is_none());
    assert!(nothing.cell_pairs(3).is_empty());
}
