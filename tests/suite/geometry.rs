//! Clipping, open areas, distances, mesh files, regions and seeding, against independent constructions.

use std::f64::consts::PI;
use std::fs;
use std::path::Path;

use cutwater::error::Error;
use cutwater::geometry::{self, Clipping, CutCells, Regions, Surface, clip, open_fractions};
use cutwater::grid::{Axis, Grid, Sides};
use cutwater::reference::{Ballistic, advect_markers};
use cutwater::scene::{self, Keyframe, Liquid, Motion, Obstacle, Placement, Region, Scene, Shape, SolitaryWave};
use cutwater::state::State;
use glam::{DMat3, DQuat, DVec3};

use crate::common::{Random, far_below, surface};

fn point(random: &mut Random, low: f64, high: f64) -> DVec3 {
    DVec3::from_array([0; 3].map(|_| random.uniform(low, high)))
}

fn rotation(random: &mut Random) -> DMat3 {
    DMat3::from_quat(DQuat::from_array([0; 4].map(|_| random.uniform(-1.0, 1.0))).normalize())
}

/// A scene on the unit cube, or on a box of cubic cells as wide, with nothing in it.
fn empty_scene(cells: [usize; 3]) -> Scene {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("empty.toml");
    let size = cells.map(|n| n as f64 / cells[0] as f64);
    let text = format!(
        "[domain]\nsize = {size:?}\ncells = {cells:?}\n[time]\nduration = 1.0\n[liquid]\n[[liquid.region]]\n\
         sphere = {{ centre = [0.5, 0.5, 0.5], radius = 0.25 }}\n"
    );
    fs::write(&file, text).unwrap();
    let mut scene = Scene::load(&file, &[], 1.0).unwrap();
    scene.liquid = None;
    scene
}

fn liquid(shapes: &[Shape]) -> Liquid {
    let regions = shapes.iter().map(|shape| Region {
        shape: shape.clone(),
        placement: Placement::default(),
        subtract: false,
        velocity: DVec3::ZERO,
    });
    Liquid {
        density: 1000.0,
        regions: regions.collect(),
        surface: scene::Surface::Markers,
        marker_radius: 0.87,
        seed: 0,
        volume_control: true,
        separation: scene::Separation::None,
    }
}

fn cuboid(min: [f64; 3], max: [f64; 3]) -> Shape {
    Shape::Box { min: DVec3::from_array(min), max: DVec3::from_array(max) }
}

fn obstacle(shape: Shape) -> Obstacle {
    Obstacle { shape, placement: Placement::default(), inside_out: false, motion: None, friction: 0.0 }
}

fn all_open(grid: &Grid) -> CutCells {
    CutCells {
        open: Axis::ALL.map(|axis| vec![1.0; grid.n_faces(axis)]),
        solid_distance: vec![3.0 * grid.dx; grid.n_cells()],
    }
}

// Clipping and open areas

/// A convex surface of few triangles.
fn tetrahedron(corners: [DVec3; 4]) -> Surface {
    let surface = Surface { vertices: corners.to_vec(), triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]] };
    if surface.volume() < 0.0 { surface.inside_out() } else { surface }
}

/// Convex bodies of every kind that has made trouble: turned, thin, across walls and corners, larger than the domain, far
/// from it, on the grid's planes, flush with the walls.
fn convex_bodies(random: &mut Random) -> Vec<(String, Surface)> {
    let mut bodies = Vec::new();
    for number in 0..6 {
        let turn = rotation(random);
        let middle = point(random, 0.35, 0.65);
        let at = |half: DVec3, middle: DVec3| Surface::cuboid(-half, half).map(|x| turn * x + middle);
        let corner = DVec3::from_array([0; 3].map(|_| random.uniform(0.0, 2.0).floor()));
        let corners = [0; 4].map(|_| point(random, 0.05, 0.95));
        let half = point(random, 0.05, 0.15);
        bodies.extend([
            (format!("turned box {number}"), at(half, middle)),
            (format!("plate {number}"), at(DVec3::new(0.3, 0.0005, 0.2), middle)),
            (format!("needle {number}"), at(DVec3::new(1e-4, 0.3, 2e-4), middle)),
            (format!("box at a corner {number}"), at(half, corner)),
            (format!("large plate {number}"), at(DVec3::new(9.0, 0.1, 7.0), middle)),
            (format!("box around all {number}"), at(DVec3::splat(3.0), middle)),
            (format!("box far away {number}"), at(half, middle + 20.0 * corner)),
            (format!("tetrahedron {number}"), tetrahedron(corners)),
            (format!("sphere {number}"), Surface::sphere(point(random, 0.1, 0.9), 0.2, 1.0)),
            (format!("cylinder {number}"), Surface::cylinder(middle, turn * DVec3::X, 0.1, 0.6, 1.0)),
        ]);
        // Whole and half numbers of cells of 1/8.
        let min = DVec3::from_array([0; 3].map(|_| random.uniform(-4.0, 10.0).floor() / 16.0));
        let max = min + DVec3::from_array([0; 3].map(|_| random.uniform(1.0, 12.0).floor() / 16.0));
        bodies.push((format!("box from {min} to {max}"), Surface::cuboid(min, max)));
    }
    let unit = Surface::cuboid(DVec3::ZERO, DVec3::ONE);
    let diagonal = DMat3::from_axis_angle(DVec3::Y, 0.25 * PI);
    bodies.extend([
        ("the domain".to_owned(), unit.clone()),
        ("the domain, almost on its planes".to_owned(), unit.clone().map(|x| x * (1.0 + 1e-11) - 3e-12)),
        (
            "edges on grid lines".to_owned(),
            Surface::cuboid(DVec3::splat(-0.25), DVec3::splat(0.25)).map(|x| diagonal * x * 2.0_f64.sqrt() + 0.5),
        ),
    ]);
    bodies
}

/// Covered share of a grid face by a convex body: the face's square cut by the plane of each triangle, one after the other
/// (Sutherland and Hodgman 1974). What lies within `slack` outside of a plane counts as inside.
fn covered(body: &Surface, grid: &Grid, axis: Axis, face: [usize; 3], slack: f64) -> f64 {
    let centre = grid.face_centre(axis, face);
    let [mut u, mut v] = [DVec3::ZERO; 2];
    u[(axis.index() + 1) % 3] = 0.5 * grid.dx;
    v[(axis.index() + 2) % 3] = 0.5 * grid.dx;
    let mut polygon = vec![centre - u - v, centre + u - v, centre + u + v, centre - u + v];
    for triangle in 0..body.triangles.len() {
        let [a, b, c] = body.corners(triangle);
        let normal = (b - a).cross(c - a).normalize();
        let height: Vec<f64> = polygon.iter().map(|&x| (x - a).dot(normal)).collect();
        let mut kept = Vec::new();
        for (here, (&x, &h)) in polygon.iter().zip(&height).enumerate() {
            let next = (here + 1) % polygon.len();
            if h <= slack {
                kept.push(x);
            }
            if (h <= slack) != (height[next] <= slack) {
                kept.push(x + (polygon[next] - x) * (h / (h - height[next])));
            }
        }
        polygon = kept;
        if polygon.is_empty() {
            return 0.0;
        }
    }
    let fan = polygon[1..].windows(2);
    let area: DVec3 = fan.map(|pair| 0.5 * (pair[0] - polygon[0]).cross(pair[1] - polygon[0])).sum();
    area.length() / (grid.dx * grid.dx)
}

#[test]
fn open_fractions_equal_a_clip_of_the_faces() {
    let mut random = Random(11);
    // Not a cube, so that no axis can stand for another.
    let grid = Grid { cells: [8, 7, 6], dx: 0.125 };
    for (name, body) in convex_bodies(&mut random) {
        assert_eq!(body.fault(), None, "{name}");
        for (start, surface) in [(1.0, body.clone()), (0.0, body.clone().inside_out())] {
            let open = open_fractions(&grid, start, &[clip(&surface, &grid)]);
            assert!(open.closure_defect <= 1e-12, "{name}, start {start}: a line ends {:e} off", open.closure_defect);
            for axis in Axis::ALL {
                for (number, &open) in open.faces[axis.index()].iter().enumerate() {
                    let face = grid.face_at(axis, number);
                    assert!(
                        (-1e-12..=1.0 + 1e-12).contains(&open),
                        "{name}, start {start}, {axis:?} {face:?}: {open:e}"
                    );
                    // A face that lies on the boundary of the solid is closed, on whichever side the solid is.
                    let expected = if start == 1.0 {
                        1.0 - covered(&body, &grid, axis, face, 1e-10)
                    } else {
                        covered(&body, &grid, axis, face, -1e-10)
                    };
                    // The body on almost grid planes is moved onto them by up to 1e-9 cells; elsewhere it is rounding
                    // of positions up to 20 cells away and of thin triangles' planes.
                    assert!(
                        (open - expected).abs() <= 1e-10,
                        "{name}, start {start}, {axis:?} {face:?}: {open}, expected {expected}"
                    );
                }
            }
        }
    }
}

/// Sum of outward area vectors of a cell, m^2: its open faces and its patches.
fn cell_defect(grid: &Grid, open: &[Vec<f64>; 3], clippings: &[Clipping]) -> Vec<DVec3> {
    let mut sums: Vec<DVec3> = (0..grid.n_cells())
        .map(|cell| {
            DVec3::from_array(Axis::ALL.map(|axis| {
                let minus = grid.cell_at(cell);
                let mut plus = minus;
                plus[axis.index()] += 1;
                let [minus, plus] = [minus, plus].map(|face| open[axis.index()][grid.face(axis, face)]);
                (plus - minus) * grid.dx * grid.dx
            }))
        })
        .collect();
    for patch in clippings.iter().flat_map(|clipping| &clipping.patches) {
        sums[patch.cell] += patch.area * patch.normal;
    }
    sums
}

#[test]
fn patches_cover_the_surface_and_close_every_cell() {
    let mut random = Random(5);
    let grid = Grid { cells: [9, 8, 10], dx: 0.1 };
    let mut clippings = Vec::new();
    // Eight bodies in the domain, each in its own octant: their contributions add.
    for number in 0..8 {
        let octant = DVec3::new(
            if number & 1 == 0 { 0.22 } else { 0.67 },
            if number & 2 == 0 { 0.2 } else { 0.6 },
            if number & 4 == 0 { 0.25 } else { 0.75 },
        );
        let turn = rotation(&mut random);
        let half = point(&mut random, 0.02, 0.1);
        let surface = match number % 3 {
            0 => Surface::cuboid(-half, half).map(|x| turn * x + octant),
            1 => Surface::sphere(octant, half.x, grid.dx),
            _ => Surface::cylinder(octant, turn * DVec3::Z, half.x, half.y, grid.dx),
        };
        let clipping = clip(&surface, &grid);
        let area: f64 = clipping.patches.iter().map(|patch| patch.area).sum();
        assert!((area / surface.area() - 1.0).abs() < 1e-12, "{area}");
        let mut moments = vec![DVec3::ZERO; surface.triangles.len()];
        for patch in &clipping.patches {
            let corners = surface.corners(patch.triangle);
            let weights = patch.barycentric;
            assert!(weights.iter().all(|weight| (-1e-9..=1.0 + 1e-9).contains(weight)));
            let centroid = (0..3).map(|c| weights[c] * corners[c]).sum::<DVec3>();
            assert!(centroid.distance(patch.centroid) < 1e-12, "{patch:?}");
            let middle = grid.cell_centre(grid.cell_at(patch.cell));
            assert!((centroid - middle).abs().max_element() < 0.5 * grid.dx + 1e-12);
            let normal = surface.area_vector(patch.triangle).normalize();
            // Direction is lost where a polygon is hardly larger than rounding.
            let slack = 1e-6_f64.max(1e-15 * grid.dx / patch.area.sqrt());
            assert!(normal.dot(patch.normal) < -1.0 + slack || patch.area < 1e-18);
            moments[patch.triangle] += patch.area * patch.centroid;
        }
        for (triangle, moment) in moments.into_iter().enumerate() {
            let [a, b, c] = surface.corners(triangle);
            let expected = surface.area_vector(triangle).length() * (a + b + c) / 3.0;
            assert!(moment.distance(expected) < 1e-14);
        }
        clippings.push(clipping);
    }
    let open = open_fractions(&grid, 1.0, &clippings);
    assert!(open.closure_defect <= 1e-12);
    let worst = cell_defect(&grid, &open.faces, &clippings).into_iter().map(DVec3::length).fold(0.0, f64::max);
    assert!(worst <= 1e-15 * grid.dx, "a cell opens by {worst:e} m^2");
}

#[test]
fn a_patch_on_a_grid_plane_belongs_to_the_liquid_side() {
    let grid = Grid { cells: [4; 3], dx: 0.25 };
    let block = Surface::cuboid(DVec3::splat(0.25), DVec3::splat(0.75));
    // The second differs by less than 1e-9 cells, in and out.
    let almost = block.clone().map(|x| x + (x - 0.45) * 4e-10);
    for block in [block, almost] {
        for inside_out in [false, true] {
            let surface = if inside_out { block.clone().inside_out() } else { block.clone() };
            let clipping = clip(&surface, &grid);
            assert!((clipping.patches.iter().map(|p| p.area).sum::<f64>() - 1.5).abs() < 1e-8);
            for patch in &clipping.patches {
                let cell = grid.cell_at(patch.cell);
                let in_block = cell.iter().all(|&i| i == 1 || i == 2);
                assert_eq!(in_block, inside_out, "{patch:?}");
            }
        }
    }
}

#[test]
fn a_scene_without_obstacles_is_open_but_for_the_walls() {
    let scene = empty_scene([4, 3, 5]);
    let grid = scene.grid();
    let CutCells { open, solid_distance } = geometry::cut_cells(&scene, &grid).unwrap();
    for axis in Axis::ALL {
        for (number, &open) in open[axis.index()].iter().enumerate() {
            let at = grid.face_at(axis, number)[axis.index()];
            let wall = at == 0 || at == grid.cells[axis.index()];
            assert_eq!(open, if wall { 0.0 } else { 1.0 });
        }
    }
    assert_eq!(solid_distance, vec![3.0 * grid.dx; grid.n_cells()]);
}

#[test]
fn obstacles_close_faces_add_up_and_are_clamped() {
    let mut scene = empty_scene([8; 3]);
    let grid = scene.grid();
    // A container, a block in it that hides 0.2 of some faces and less than the area clamp of others, and an overlap.
    scene.obstacles = vec![
        Obstacle { inside_out: true, ..obstacle(cuboid([0.125; 3], [0.875; 3])) },
        obstacle(cuboid([0.25; 3], [0.4, 0.3750625, 0.5])),
        obstacle(cuboid([0.0; 3], [0.2; 3])),
    ];
    let CutCells { open, solid_distance } = geometry::cut_cells(&scene, &grid).unwrap();
    let at = |axis: Axis, face| open[axis.index()][grid.face(axis, face)];
    assert_eq!(at(Axis::X, [1, 4, 4]), 0.0);
    assert_eq!(at(Axis::X, [2, 4, 4]), 1.0);
    assert_eq!(at(Axis::X, [3, 2, 2]), 0.0);
    assert!((at(Axis::Y, [3, 2, 2]) - 0.8).abs() < 1e-12);
    // 0.0005 of the cell above is hidden: open.
    assert_eq!(at(Axis::X, [3, 3, 2]), 1.0);
    // Solid twice over.
    assert_eq!(at(Axis::X, [1, 0, 0]), 0.0);
    assert!(open.iter().flatten().all(|open| (0.0..=1.0).contains(open)));
    let distance = |cell| solid_distance[grid.cell(cell)] / grid.dx;
    assert!((distance([1, 4, 4]) - 0.5).abs() < 1e-12);
    assert!((distance([0, 4, 4]) + 0.5).abs() < 1e-12);
    assert!((distance([2, 2, 2]) + 0.5).abs() < 1e-12);
}

#[test]
fn tessellations_keep_volume_and_chord_error() {
    let dx = 0.02;
    for radius in [0.01, 0.1, 0.4] {
        let centre = DVec3::new(0.3, -0.2, 0.7);
        let sphere = Surface::sphere(centre, radius, dx);
        let axis = DVec3::new(1.0, 2.0, -0.5).normalize();
        let cylinder = Surface::cylinder(centre, axis, radius, 0.3, dx);
        for (surface, volume, round) in
            [(sphere, 4.0 / 3.0 * PI * radius.powi(3), true), (cylinder, PI * radius * radius * 0.3, false)]
        {
            assert_eq!(surface.fault(), None);
            assert!((surface.volume() / volume - 1.0).abs() < 1e-10);
            for triangle in 0..surface.triangles.len() {
                let corners = surface.corners(triangle);
                let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
                let edges = [0, 1, 2].map(|e| 0.5 * (corners[e] + corners[(e + 1) % 3]));
                for x in corners.into_iter().chain(edges).chain([middle]) {
                    let x = x - centre;
                    let height = x.dot(axis);
                    let off = if round {
                        x.length() - radius
                    } else {
                        let outside = (x - height * axis).length() - radius;
                        // On a cap, the middle of the disc counts as on it.
                        if (height * (height - 0.3)).abs() < 1e-12 { outside.max(0.0) } else { outside }
                    };
                    assert!(off.abs() <= 1e-3 * dx, "{off} at {x} of radius {radius}");
                }
            }
        }
    }
}

// Distances

/// Distance between a point and a triangle: by its plane where the foot lies inside, else by its edges.
fn triangle_distance(x: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let normal = (b - a).cross(c - a).normalize();
    let corners = [a, b, c];
    let edges = [(a, b), (b, c), (c, a)];
    if edges.iter().all(|(p, q)| (*q - *p).cross(x - *p).dot(normal) >= 0.0) {
        return (x - corners[0]).dot(normal).abs();
    }
    edges
        .into_iter()
        .map(|(p, q)| {
            let along = ((x - p).dot(q - p) / (q - p).length_squared()).clamp(0.0, 1.0);
            x.distance(p + along * (q - p))
        })
        .fold(f64::INFINITY, f64::min)
}

/// How often a closed surface winds around a point: the sum of solid angles (van Oosterom and Strackee 1983) over 4 pi.
fn winding(surface: &Surface, x: DVec3) -> f64 {
    let angles = (0..surface.triangles.len()).map(|triangle| {
        let [a, b, c] = surface.corners(triangle).map(|corner| corner - x);
        let [la, lb, lc] = [a.length(), b.length(), c.length()];
        let bottom = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
        2.0 * a.dot(b.cross(c)).atan2(bottom)
    });
    angles.sum::<f64>() / (4.0 * PI)
}

fn brute_force_distance(surface: &Surface, x: DVec3) -> f64 {
    let distance = (0..surface.triangles.len())
        .map(|triangle| triangle_distance(x, surface.corners(triangle)))
        .fold(f64::INFINITY, f64::min);
    if winding(surface, x) > 0.5 { -distance } else { distance }
}

/// Two boxes joined to an L, 20 triangles with sharp inner and outer edges.
fn l_shape() -> Surface {
    let profile = [[0.0, 0.0], [0.5, 0.0], [0.5, 0.15], [0.15, 0.15], [0.15, 0.6], [0.0, 0.6]];
    let n = profile.len() as u32;
    let vertices = [0.0, 0.4].iter().flat_map(|&z| profile.map(|[x, y]| DVec3::new(x, y, z))).collect();
    let ends = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]];
    let mut triangles: Vec<[u32; 3]> = Vec::new();
    for [a, b, c] in ends {
        triangles.extend([[a, c, b], [a + n, b + n, c + n]]);
    }
    for here in 0..n {
        let next = (here + 1) % n;
        triangles.extend([[here, next, next + n], [here, next + n, here + n]]);
    }
    Surface { vertices, triangles }
}

fn write_obj(file: &Path, surface: &Surface) {
    let mut text = String::from("# an L\no l\n");
    for x in &surface.vertices {
        text += &format!("v {} {} {}\n", x.x, x.y, x.z);
    }
    for [a, b, c] in &surface.triangles {
        text += &format!("f {} {} {}\n", a + 1, b + 1, c + 1);
    }
    fs::write(file, text).unwrap();
}

#[test]
fn obstacle_distance_equals_brute_force() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("l.obj");
    write_obj(&file, &l_shape());
    let mut random = Random(3);
    let mut scene = empty_scene([12, 12, 12]);
    let grid = scene.grid();
    let band = 3.0 * grid.dx;
    for number in 0..4 {
        let placement = Placement {
            translate: point(&mut random, -0.1, 0.1),
            rotate: rotation(&mut random),
            scale: random.uniform(0.7, 1.2),
            at: None,
        };
        let [min, max] = [DVec3::new(0.3, 0.4, 0.45), DVec3::new(0.6, 0.7, 0.5)];
        let axis = (rotation(&mut random) * DVec3::X).normalize();
        let [centre, base] = [DVec3::splat(0.5), DVec3::splat(0.4)];
        let fine = 0.05 * grid.dx;
        // Shape, its own surface, its centre, and the chord error of that surface.
        let l = l_shape();
        let [low, high] = l.bounds();
        let shapes = [
            (Shape::Box { min, max }, Surface::cuboid(min, max), 0.5 * (min + max), 0.0),
            (Shape::Sphere { centre, radius: 0.2 }, Surface::sphere(centre, 0.2, fine), centre, 1e-3 * fine),
            (
                Shape::Cylinder { base, axis, radius: 0.1, height: 0.3 },
                Surface::cylinder(base, axis, 0.1, 0.3, fine),
                base + 0.15 * axis,
                1e-3 * fine,
            ),
            (Shape::Mesh { file: file.clone().into(), unit: 1.0 }, l, 0.5 * (low + high), 0.0),
        ];
        for (shape, surface, centre, chord_error) in shapes {
            let surface = surface.placed(&placement, centre);
            scene.obstacles = vec![Obstacle { placement, inside_out: number == 3, ..obstacle(shape.clone()) }];
            let cut_cells = geometry::cut_cells(&scene, &grid).unwrap();
            // A sample of cells, as the tessellations are fine.
            for cell in (0..grid.n_cells()).step_by(if chord_error > 0.0 { 61 } else { 1 }) {
                let x = grid.cell_centre(grid.cell_at(cell));
                let expected = brute_force_distance(&surface, x).clamp(-band, band);
                let expected = if number == 3 { -expected } else { expected };
                let got = cut_cells.solid_distance[cell];
                assert!(
                    (got - expected).abs() <= 1e-12 + placement.scale * chord_error,
                    "{shape:?} at {x}: {got}, expected {expected}"
                );
            }
        }
    }
}

/// A pillar on the floor and a rod on a wall, as they are, turned, scaled, moved and drawn by a mesh: their distance is that of bodies
/// that go on beyond the wall, and a marker in the pillar, just above the floor, leaves it sideways.
#[test]
fn sides_of_obstacles_on_walls_are_no_way_out() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("pillar.obj");
    let [min, max] = [DVec3::new(0.4, 0.0, 0.4), DVec3::new(0.6, 0.5, 0.7)];
    write_obj(&file, &Surface::cuboid(min, max));
    let centre = 0.5 * (min + max);
    let lying = DVec3::new(0.125, 0.05, 0.075);
    let cuboid = |min, max| Shape::Box { min, max };
    let rod = |base, axis, height| Shape::Cylinder { base, axis, radius: 0.2, height };
    let here = Placement::default();
    let moved = Placement { translate: -DVec3::X, ..here };
    let turned = |scale| Placement { rotate: DMat3::from_axis_angle(DVec3::Z, 0.5 * PI), scale, ..here };
    let pillars = vec![
        (cuboid(min, max), here),
        (cuboid(min + DVec3::X, max + DVec3::X), moved),
        (cuboid(centre - lying, centre + lying), turned(2.0)),
        (Shape::Mesh { file: file.into(), unit: 1.0 }, here),
    ];
    let rods = vec![
        (rod(DVec3::new(1.0, 0.5, 0.5), -DVec3::X, 0.4), here),
        (rod(DVec3::new(0.8, 0.3, 0.5), DVec3::Y, 0.4), turned(1.0)),
    ];
    let mut scene = empty_scene([16, 16, 16]);
    let grid = scene.grid();
    let mut distance = |shape: &Shape, placement: Placement, inside_out: bool| {
        scene.obstacles = vec![Obstacle { placement, inside_out, ..obstacle(shape.clone()) }];
        geometry::cut_cells(&scene, &grid).unwrap().solid_distance
    };
    for (bodies, beyond) in
        [(&pillars, cuboid(min - 2.0 * DVec3::Y, max)), (&rods, rod(DVec3::new(3.0, 0.5, 0.5), -DVec3::X, 2.4))]
    {
        for ((shape, placement), inside_out) in bodies.iter().flat_map(|body| [(body, false), (body, true)]) {
            let expected = distance(&beyond, here, inside_out);
            let got = distance(shape, *placement, inside_out);
            for (cell, (got, expected)) in got.iter().zip(expected).enumerate() {
                assert!(
                    (got - expected).abs() < 1e-12,
                    "{shape:?}, cell {:?}: {got}, expected {expected}",
                    grid.cell_at(cell)
                );
            }
        }
    }
    let still = State::at_rest(&grid).velocity;
    for (shape, placement) in pillars {
        let distance = distance(&shape, placement, false);
        let start = [0.42, 0.01, 0.55];
        let deep = far_below(&grid);
        let surface = surface(&grid, &deep);
        let sides = Sides::default();
        let (markers, _) = advect_markers(&grid, sides, &still, &distance, &surface, &Ballistic::NONE, &[start], 0.01);
        let [x, y, z] = markers[0];
        assert!(x < 0.4 && [y, z] == start[1..], "{shape:?}: {markers:?}");
    }
}

// Mesh files

/// A unit cube in each format, as text or bytes.
fn cubes() -> Vec<(&'static str, Vec<u8>)> {
    let cube = Surface::cuboid(DVec3::ZERO, DVec3::ONE);
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let mut obj = String::from("# a cube of quads, one of them by negative numbers\nmtllib no.mtl\n");
    let mut ply = String::from(
        "ply\nformat ascii 1.0\ncomment a cube\nelement vertex 8\nproperty float x\nproperty double y\nproperty float z\n\
         element face 6\nproperty list uchar int vertex_indices\nend_header\n",
    );
    for x in &cube.vertices {
        obj += &format!("v {} {} {}\n", x.x, x.y, x.z);
        ply += &format!("{} {} {}\n", x.x, x.y, x.z);
    }
    for (number, quad) in quads.iter().enumerate() {
        let name = |v: i32| if number == 3 { v - 8 } else { v + 1 }.to_string();
        obj += &format!("f {}\n", quad.map(name).join(" "));
        ply += &format!("4 {}\n", quad.map(|v| v.to_string()).join(" "));
    }
    let mut binary_ply =
        b"ply\nformat binary_little_endian 1.0\nelement vertex 8\nproperty float x\nproperty float y\n\
        property float z\nelement face 12\nproperty list uchar uint vertex_index\nend_header\n"
            .to_vec();
    // A free header that begins like a text file: met in the wild.
    let mut binary_stl = b"solid exported".to_vec();
    binary_stl.resize(80, b' ');
    binary_stl.extend(12_u32.to_le_bytes());
    let mut stl = String::from("solid cube\n");
    let bytes = |x: DVec3| x.as_vec3().to_array().into_iter().flat_map(f32::to_le_bytes);
    for x in &cube.vertices {
        binary_ply.extend(bytes(*x));
    }
    for (number, triangle) in cube.triangles.iter().enumerate() {
        binary_ply.push(3);
        binary_ply.extend(triangle.iter().flat_map(|v| v.to_le_bytes()));
        stl += " facet normal 0 0 0\n  outer loop\n";
        binary_stl.extend(bytes(DVec3::ZERO));
        for x in cube.corners(number) {
            stl += &format!("   vertex {} {} {}\n", x.x, x.y, x.z);
            binary_stl.extend(bytes(x));
        }
        stl += "  endloop\n endfacet\n";
        binary_stl.extend([0, 0]);
    }
    stl += "endsolid cube\n";
    vec![
        ("obj", obj.into_bytes()),
        ("stl", stl.into_bytes()),
        ("STL", binary_stl),
        ("ply", ply.into_bytes()),
        ("ply", binary_ply),
    ]
}

#[test]
fn mesh_files_are_read() {
    let folder = tempfile::tempdir().unwrap();
    for (number, (extension, bytes)) in cubes().into_iter().enumerate() {
        let file = folder.path().join(format!("cube{number}.{extension}"));
        fs::write(&file, bytes).unwrap();
        let cube = geometry::read_mesh(&file).unwrap();
        assert_eq!(cube.vertices.len(), 8, "{}", file.display());
        assert_eq!(cube.triangles.len(), 12, "{}", file.display());
        assert!((cube.volume() - 1.0).abs() < 1e-15);
        assert_eq!(cube.bounds(), [DVec3::ZERO, DVec3::ONE]);
    }
}

#[test]
fn broken_mesh_files_are_refused_with_the_place_and_the_cure() {
    let folder = tempfile::tempdir().unwrap();
    let cubes = cubes();
    let text = |cube: usize| String::from_utf8(cubes[cube].1.clone()).unwrap();
    let (obj, stl, ply) = (text(0), text(1), text(3));
    let cut = |cube: usize, bytes: usize| cubes[cube].1[..cubes[cube].1.len() - bytes].to_vec();
    let without = |text: &str, line: &str| text.replacen(line, "", 1).into_bytes();
    let with = |text: &str, line: &str, other: &str| text.replacen(line, other, 1).into_bytes();
    let cases: Vec<(&str, Vec<u8>, &[&str])> = vec![
        ("obj", with(&obj, "v 1 0 0", "v 1 zero 0"), &["mesh.obj:4:", "position"]),
        ("obj", with(&obj, "f 1 5 7 3", "f 1 5 700 3"), &["mesh.obj:", "out of bounds"]),
        (
            "obj",
            without(&obj, "f 1 5 7 3\n"),
            &["not closed: the edge from [", "belongs to triangle", "fill the holes"],
        ),
        ("obj", with(&obj, "f 1 5 7 3", "f 3 7 5 1"), &["in the same direction", "consistent"]),
        ("obj", with(&obj, "v 1 0 0", "v nan 0 0"), &["triangle", "finite"]),
        ("obj", Vec::new(), &["no triangles"]),
        ("stl", with(&stl, "vertex 0 0 0", "vertex 0 0"), &["mesh.stl:5:", "facet 1:", "export"]),
        ("stl", with(&stl, "endloop", "endlop"), &["facet 1:", "endlop"]),
        ("stl", cut(2, 25), &["facet 12", "export"]),
        ("stl", b"nothing".to_vec(), &["mesh.stl", "not an STL file"]),
        ("ply", with(&ply, "\n1 0 0\n", "\n1 0\n"), &["mesh.ply:12:"]),
        ("ply", with(&ply, "property double y", "property double w"), &["vertex 1:", "`y`"]),
        ("ply", with(&ply, "4 0 4 6 2", "4 0 4 6 99"), &["face 1: vertex 99", "8"]),
        ("ply", cut(4, 2), &["mesh.ply"]),
        ("fbx", Vec::new(), &["unknown kind", ".obj, .stl, .ply, .glb or .gltf"]),
    ];
    for (extension, bytes, expected) in cases {
        let file = folder.path().join(format!("mesh.{extension}"));
        fs::write(&file, bytes).unwrap();
        let error = geometry::read_mesh(&file).expect_err(expected[0]);
        assert!(matches!(error, Error::Input { .. }) && error.exit_code() == 2);
        for word in expected {
            assert!(error.to_string().contains(word), "{word} in: {error}");
        }
    }
    let error = geometry::read_mesh(&folder.path().join("none.obj")).unwrap_err();
    assert!(error.to_string().contains("none.obj"), "{error}");
}

#[test]
fn surface_files_cut_off_or_with_huge_counts_are_refused() {
    for (extension, whole) in cubes() {
        let file = format!("mesh.{extension}");
        let read = |bytes: &[u8]| geometry::parse_mesh(bytes.to_vec(), Path::new(&file));
        let sound = read(&whole).unwrap();
        for length in 0..whole.len() {
            match read(&whole[..length]) {
                // Only line ends and the name behind `endsolid` may be missing.
                Ok(cut) => {
                    assert!(cut == sound && whole.len() - length < 8, "{extension} cut at {length} of {}", whole.len())
                }
                Err(error) => assert_eq!(error.exit_code(), 2),
            }
        }
        // The largest count of four bytes, or of digits.
        let count = if whole.is_ascii() { b'9' } else { 0xff };
        for at in 0..whole.len() - 4 {
            let mut changed = whole.clone();
            changed[at..at + 4].fill(count);
            if let Ok(surface) = read(&changed) {
                assert_eq!(surface.fault(), None);
            }
        }
    }
}

#[test]
fn surfaces_that_bound_nothing_are_refused() {
    let cube = Surface::cuboid(DVec3::ZERO, DVec3::ONE);
    assert_eq!(cube.fault(), None);
    let problem = |surface: Surface| surface.fault().expect("a fault").problem;
    let inverted = problem(cube.clone().inside_out());
    assert!(inverted.contains("inverted") && inverted.contains("edge"), "{inverted}");
    let mut flat = cube.clone();
    flat.vertices[1] = flat.vertices[0];
    assert!(problem(flat).contains("has no area"));
    // Two cubes that share an edge: four triangles there.
    let mut pair = cube.clone();
    let other = cube.map(|x| x + DVec3::new(1.0, 1.0, 0.0));
    pair.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + 8)));
    pair.vertices.extend(other.vertices);
    assert!(problem(pair.welded()).contains("same direction"));
}

#[test]
fn parts_that_bound_no_solid_together_are_refused() {
    let block = |low: [f64; 3], high: [f64; 3]| Surface::cuboid(low.into(), high.into());
    let join = |parts: &[Surface]| {
        let mut all = Surface::default();
        for part in parts {
            let first = all.vertices.len() as u32;
            all.triangles.extend(part.triangles.iter().map(|t| t.map(|v| v + first)));
            all.vertices.extend(&part.vertices);
        }
        all.map(|x| DMat3::from_axis_angle(DVec3::new(1.0, 2.0, 2.0) / 3.0, 0.7) * x)
    };
    let unit = block([0.0; 3], [1.0; 3]);
    let far = block([2.0, 0.0, 0.0], [3.0, 1.0, 1.0]);
    let inner = block([0.25; 3], [0.75; 3]);
    let innermost = block([0.4; 3], [0.6; 3]);
    let hole = inner.clone().inside_out();
    for (name, sound) in [
        ("apart", vec![unit.clone(), far.clone()]),
        ("a hole", vec![unit.clone(), hole.clone(), far.clone()]),
        ("a hole first", vec![hole.clone(), unit.clone()]),
        ("an island in a hole", vec![unit.clone(), hole.clone(), innermost.clone()]),
    ] {
        assert_eq!(join(&sound).fault(), None, "{name}");
    }
    // Two bars that cross have no corner in each other.
    let bars = [block([-1.0, 0.3, 0.3], [2.0, 0.7, 0.7]), block([0.3, -1.0, 0.2], [0.7, 2.0, 0.8])];
    for (parts, expected) in [
        (bars.to_vec(), "overlap or touch"),
        (vec![unit.clone(), unit.clone().map(|x| x + 0.5)], "overlap or touch"),
        (vec![unit.clone(), inner.clone()], "lies inside another"),
        (
            vec![unit.clone(), hole.clone(), innermost.clone(), innermost.clone().map(|x| 0.5 + 0.5 * (x - 0.5))],
            "lies inside another",
        ),
        (vec![unit.clone(), far.map(|x| 0.5 * x + DVec3::X).inside_out()], "inverted"),
        (vec![unit, hole, innermost.inside_out()], "no hole in another part"),
    ] {
        let fault = join(&parts).fault().expect("a fault");
        assert!(fault.problem.contains(expected), "{fault:?}");
    }
}

#[test]
fn a_mesh_cuts_like_the_shape_it_draws() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("box.obj");
    let [min, max] = [DVec3::new(0.2, 0.3, 0.35), DVec3::new(0.6, 0.71, 0.8)];
    write_obj(&file, &Surface::cuboid(min, max));
    let placement = Placement {
        translate: DVec3::new(0.05, -0.03, 0.01),
        rotate: DMat3::from_axis_angle(DVec3::new(1.0, 2.0, 2.0) / 3.0, 0.7),
        scale: 0.9,
        at: None,
    };
    let mut scene = empty_scene([10; 3]);
    let grid = scene.grid();
    let [mesh, shape] = [Shape::Mesh { file: file.into(), unit: 1.0 }, Shape::Box { min, max }].map(|shape| {
        scene.obstacles = vec![Obstacle { placement, ..obstacle(shape) }];
        geometry::cut_cells(&scene, &grid).unwrap()
    });
    let fields = |cut_cells: CutCells| {
        let mut all = cut_cells.open.concat();
        all.extend(cut_cells.solid_distance);
        all
    };
    for (mesh, shape) in fields(mesh).into_iter().zip(fields(shape)) {
        assert!((mesh - shape).abs() < 1e-12);
    }
}

// Regions

#[test]
fn region_distances_are_exact() {
    let tilted = DVec3::new(1.0, 2.0, 2.0) / 3.0;
    let [k, amplitude] = [2.0 * PI, 0.05];
    let mut pool =
        liquid(&[cuboid([0.0; 3], [1.0, 0.4, 1.0]), Shape::Sphere { centre: DVec3::new(0.5, 0.8, 0.5), radius: 0.1 }]);
    pool.regions.push(Region {
        shape: Shape::Cylinder { base: DVec3::new(0.5, 0.0, 0.5), axis: DVec3::Y, radius: 0.2, height: 1.0 },
        placement: Placement::default(),
        subtract: true,
        velocity: DVec3::ZERO,
    });
    let half_space = liquid(&[Shape::HalfSpace { point: DVec3::splat(0.5), normal: tilted }]);
    let wave = liquid(&[Shape::Wave { level: 0.5, amplitude, wave_number: [k, 0.0], phase: 0.3 }]);
    let cases = [
        // Above the box, past its edge, in it, near the cylinder that is taken away, in the ball that it takes away.
        (&pool, [0.1, 0.6, 0.5], 0.2),
        (&pool, [-0.3, 0.8, 0.5], 0.5),
        (&pool, [0.1, 0.3, 0.5], -0.1),
        (&pool, [0.25, 0.2, 0.5], -0.05),
        (&pool, [0.5, 0.8, 0.5], 0.2),
        (&half_space, [0.5, 0.5, 0.8], 0.2),
        (&half_space, [0.2, 0.5, 0.5], -0.1),
    ];
    for (liquid, x, expected) in cases {
        let got = Regions::new(liquid, DVec3::ONE, str::to_owned).unwrap().distance(DVec3::from_array(x));
        assert!((got - expected).abs() < 1e-15, "{x:?}: {got}, expected {expected}");
    }
    // Near its surface the wave's distance is right to second order in the distance.
    let regions = Regions::new(&wave, DVec3::ONE, str::to_owned).unwrap();
    for step in 0..50 {
        let x = step as f64 / 50.0;
        let phase = k * x + 0.3;
        let on = DVec3::new(x, 0.5 + amplitude * phase.cos(), 0.2);
        assert!(regions.distance(on).abs() < 1e-15);
        let normal = DVec3::new(amplitude * k * phase.sin(), 1.0, 0.0).normalize();
        for offset in [-1e-4, 1e-4] {
            let got = regions.distance(on + offset * normal);
            assert!((got - offset).abs() < 3e-8, "{got} for {offset}");
        }
    }
}

/// What is left of the equations of a wave that stays as it is falls with the fourth power of its height, within the depth and at the surface: no
/// divergence, no curl, no flow through the surface and Bernoulli's law on it, all in the frame that goes with the wave. Lengths in
/// depths, speeds in sqrt(g depth), the wave turned.
#[test]
fn a_solitary_wave_is_one_to_third_order() {
    let residuals = |e: f64| {
        let (gravity, depth): (f64, f64) = (9.81, 0.4);
        let direction = [0.6, -0.8];
        let way = DVec3::new(direction[0], 0.0, direction[1]);
        let crest = [0.7, -0.2];
        let wave = liquid(&[Shape::Solitary(SolitaryWave { depth, height: e * depth, crest, direction, gravity })]);
        let regions = Regions::new(&wave, DVec3::ONE, str::to_owned).unwrap();
        let at = |x: f64, z: f64| DVec3::new(crest[0], 0.0, crest[1]) + depth * (x * way + z * DVec3::Y);
        let velocity = |x: f64, z: f64| {
            let velocity = regions.velocity(at(x, z)).unwrap();
            assert!(velocity.dot(DVec3::new(-way.z, 0.0, way.x)).abs() < 1e-15);
            [velocity.dot(way), velocity.y].map(|v| v / (gravity * depth).sqrt())
        };
        // The height at which the distance is 0.
        let surface = |x: f64| {
            let [mut low, mut high] = [0.5, 2.0];
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                let below = regions.distance(at(x, middle)) < 0.0;
                *(if below { &mut low } else { &mut high }) = middle;
            }
            low
        };
        let speed = (1.0 + e - e * e / 20.0 - 3.0 * e.powi(3) / 70.0).sqrt();
        let d = 1e-4;
        let (mut within, mut on) = ([0.0_f64; 2], [0.0_f64; 2]);
        for step in -40..=40 {
            let x = 0.2 * f64::from(step);
            for z in [0.2, 0.5, 0.9] {
                let [[east_u, east_w], [west_u, west_w]] = [velocity(x + d, z), velocity(x - d, z)];
                let [[up_u, up_w], [down_u, down_w]] = [velocity(x, z + d), velocity(x, z - d)];
                let divergence = (east_u - west_u + up_w - down_w) / (2.0 * d);
                let curl = (east_w - west_w - up_u + down_u) / (2.0 * d);
                within = [within[0].max(divergence.abs()), within[1].max(curl.abs())];
            }
            let height = surface(x);
            let slope = (surface(x + d) - surface(x - d)) / (2.0 * d);
            let [u, w] = velocity(x, height - 1e-9);
            let through = (u - speed) * slope - w;
            let bernoulli = 0.5 * ((u - speed).powi(2) + w * w) + height - 1.0 - 0.5 * speed * speed;
            on = [on[0].max(through.abs()), on[1].max(bernoulli.abs())];
        }
        [within[0], within[1], on[0], on[1]]
    };
    let [high, low] = [residuals(0.2), residuals(0.1)];
    for (what, (high, low)) in ["divergence", "curl", "through", "Bernoulli"].into_iter().zip(high.into_iter().zip(low))
    {
        let order = (high / low).log2();
        assert!(high < 0.01 && order > 3.6, "{what}: {high:e}, {low:e}, order {order}");
    }
}

#[test]
fn sides_on_walls_are_no_free_surface() {
    let mut scene = empty_scene([8, 8, 6]);
    let grid = scene.grid();
    let level = 0.53;
    let upright = Shape::Cylinder { base: DVec3::new(0.5, 0.0, 0.375), axis: DVec3::Y, radius: 0.2, height: level };
    let pool = cuboid([0.0; 3], [1.0, level, 0.75]);
    for (shape, top_only) in [(pool, true), (upright, false)] {
        scene.liquid = Some(liquid(&[shape]));
        let distance = geometry::liquid_distance(&scene, &grid).unwrap();
        for (cell, distance) in distance.into_iter().enumerate() {
            let x = grid.cell_centre(grid.cell_at(cell));
            let top = x.y - level;
            let round = (x.x - 0.5).hypot(x.z - 0.375) - 0.2;
            let expected = if top_only {
                top
            } else if top > 0.0 && round > 0.0 {
                top.hypot(round)
            } else {
                top.max(round)
            };
            assert!((distance - expected).abs() < 1e-14, "{x}: {distance}");
        }
    }
}

// Seeding and the first state

/// The volume that the union-of-spheres rule gives to markers, m^3.
fn sphere_volume(grid: &Grid, cut_cells: &CutCells, markers: &[[f64; 3]], radius: f64) -> f64 {
    let n = grid.cells.map(|n| n as isize);
    let dx = grid.dx;
    let mut nearest = vec![2.0 * dx; grid.n_cells()];
    let mut occupied = vec![false; grid.n_cells()];
    let steps = || -2..=2_isize;
    let around: Vec<[isize; 3]> =
        steps().flat_map(|k| steps().flat_map(move |j| steps().map(move |i| [i, j, k]))).collect();
    let shifted = |at: [isize; 3], step: &[isize; 3]| {
        let at = [at[0] + step[0], at[1] + step[1], at[2] + step[2]];
        let inside = (0..3).all(|a| (0..n[a]).contains(&at[a]));
        inside.then(|| grid.cell(at.map(|i| i as usize)))
    };
    for &marker in markers {
        let at = marker.map(|x| (x / dx).floor() as isize);
        occupied[shifted(at, &[0; 3]).expect("markers lie in the domain")] = true;
        for cell in around.iter().filter_map(|step| shifted(at, step)) {
            let centre = grid.cell_centre(grid.cell_at(cell));
            nearest[cell] = nearest[cell].min(centre.distance(DVec3::from_array(marker)));
        }
    }
    let volume = (0..grid.n_cells()).map(|cell| {
        let at = grid.cell_at(cell).map(|i| i as isize);
        let solid = |cell: usize| cut_cells.solid_distance[cell] < 0.0;
        let interior = around
            .iter()
            .filter(|step| step.iter().all(|c| c.abs() <= 1))
            .filter_map(|step| shifted(at, step))
            .all(|cell| occupied[cell] || solid(cell));
        let phi = if interior { -dx } else { nearest[cell] - radius * dx };
        geometry::open_volume(cut_cells.solid_distance[cell], dx) * (0.5 - phi / dx).clamp(0.0, 1.0)
    });
    volume.sum::<f64>() * dx.powi(3)
}

#[test]
fn seeded_volume_is_within_one_percent() {
    let mut scene = empty_scene([32; 3]);
    let grid = scene.grid();
    let ball = |radius: f64| 4.0 / 3.0 * PI * radius.powi(3);
    let sphere = |centre: [f64; 3], radius| Shape::Sphere { centre: DVec3::from_array(centre), radius };
    let column =
        obstacle(Shape::Cylinder { base: DVec3::new(0.5, 0.0, 0.5), axis: DVec3::Y, radius: 0.2, height: 1.0 });
    let half_full = Obstacle { inside_out: true, ..obstacle(sphere([0.5; 3], 0.45)) };
    // Levels on and off the grid, boxes at one, two and three walls, a drop, boxes that touch inside a cell, an obstacle
    // through the surface, a container.
    let cases = [
        (vec![cuboid([0.0; 3], [1.0, 0.5, 1.0])], vec![], 0.5),
        (vec![cuboid([0.0; 3], [1.0, 0.26, 1.0])], vec![], 0.26),
        (vec![cuboid([0.0; 3], [0.3, 0.61, 1.0])], vec![], 0.3 * 0.61),
        (vec![sphere([0.513, 0.507, 0.491], 0.15)], vec![], ball(0.15)),
        (vec![cuboid([0.0; 3], [0.31, 0.4, 1.0]), cuboid([0.31, 0.0, 0.0], [1.0, 0.4, 1.0])], vec![], 0.4),
        (vec![cuboid([0.0; 3], [1.0, 0.43, 1.0])], vec![column], 0.43 * (1.0 - PI * 0.04)),
        (vec![cuboid([0.0; 3], [1.0, 0.5, 1.0])], vec![half_full], 0.5 * ball(0.45)),
    ];
    for (shapes, obstacles, exact) in cases {
        scene.liquid = Some(liquid(&shapes));
        scene.obstacles = obstacles;
        let cut_cells = geometry::cut_cells(&scene, &grid).unwrap();
        let markers = geometry::seed_markers(&scene, &grid, &cut_cells).unwrap();
        let volume = sphere_volume(&grid, &cut_cells, &markers, 0.87);
        let error = volume / exact - 1.0;
        assert!(error.abs() < 0.01, "{shapes:?}: {volume} for {exact}");
    }
}

#[test]
fn seeding_is_repeatable_and_fits_f32() {
    let mut scene = empty_scene([6, 7, 5]);
    let grid = scene.grid();
    let whole = DVec3::from_array(grid.size().to_array());
    let mut seeded = |seed| {
        scene.liquid = Some(Liquid { seed, ..liquid(&[cuboid([0.0; 3], whole.to_array())]) });
        geometry::seed_markers(&scene, &grid, &all_open(&grid)).unwrap()
    };
    let markers = seeded(4);
    assert_eq!(markers, seeded(4));
    assert_ne!(markers, seeded(5));
    assert_eq!(markers.len(), 8 * grid.n_cells());
    // One in each eighth of each cell, in the order of the cells, no nearer to a wall than 0.01 dx.
    for (number, marker) in markers.iter().enumerate() {
        assert_eq!(marker.map(|x| f64::from(x as f32)), *marker);
        let corner = grid.cell_centre(grid.cell_at(number / 8)) - 0.5 * grid.dx;
        let eighth = ((DVec3::from_array(*marker) - corner) / (0.5 * grid.dx)).floor();
        let index = number % 8;
        let expected = [index & 1, index >> 1 & 1, index >> 2].map(|i| i as f64);
        assert_eq!(eighth.to_array(), expected, "{marker:?}");
        let x = DVec3::from_array(*marker);
        assert!(x.min(whole - x).min_element() > 0.0099 * grid.dx);
    }
    // No grid pattern: the places within the eighths spread evenly.
    let jitter = |marker: &[f64; 3]| marker.map(|x| (2.0 * x / grid.dx).fract());
    for axis in 0..3 {
        let mean = markers.iter().map(|m| jitter(m)[axis]).sum::<f64>() / markers.len() as f64;
        assert!((mean - 0.5).abs() < 0.03, "{mean}");
    }
}

#[test]
fn markers_keep_their_depth_below_air_only() {
    let mut scene = empty_scene([16; 3]);
    let grid = scene.grid();
    let plate = cuboid([0.0, 0.5, 0.0], [0.5, 0.75, 1.0]);
    scene.obstacles = vec![obstacle(plate)];
    scene.liquid = Some(liquid(&[cuboid([0.0; 3], [1.0, 0.5, 1.0])]));
    let cut_cells = geometry::cut_cells(&scene, &grid).unwrap();
    let markers = geometry::seed_markers(&scene, &grid, &cut_cells).unwrap();
    let highest =
        |low: f64, high: f64| markers.iter().filter(|m| (low..high).contains(&m[0])).map(|m| m[1]).fold(0.0, f64::max);
    // Up to the plate on the left, 0.67 dx below the air on the right, in between it depends.
    assert!(highest(0.0, 0.45) > 0.5 - 0.05 * grid.dx);
    let depth = (0.5 - highest(0.55, 1.0)) / grid.dx;
    assert!((0.67..0.75).contains(&depth), "{depth}");
}

#[test]
fn first_state_has_the_velocity_of_the_regions() {
    let mut scene = empty_scene([8; 3]);
    let grid = scene.grid();
    let drop = DVec3::new(0.1, -2.0, 0.3);
    let mut both = liquid(&[cuboid([0.0; 3], [1.0, 0.25, 1.0]), cuboid([0.25, 0.5, 0.25], [0.75, 0.9, 0.75])]);
    both.regions[1].velocity = drop;
    scene.liquid = Some(both);
    let cut_cells = geometry::cut_cells(&scene, &grid).unwrap();
    let state = geometry::initial_state(&scene, &grid, &cut_cells).unwrap();
    assert!(!state.markers.is_empty());
    let v = |face| state.velocity[1][grid.face(Axis::Y, face)];
    assert_eq!(v([4, 5, 4]), drop.y);
    // Beside a cell of the drop; as far from it as from the pool, so the last region's; the pool's; beyond two cells.
    assert_eq!([v([4, 4, 4]), v([4, 3, 4]), v([4, 2, 4]), v([0, 7, 0])], [drop.y, drop.y, 0.0, 0.0]);
    assert_eq!(state.velocity[0][grid.face(Axis::X, [2, 5, 4])], drop.x);
    // A cell outside the drop; on a wall, as near.
    let w = |face| state.velocity[2][grid.face(Axis::Z, face)];
    assert_eq!([w([4, 5, 7]), w([4, 5, 8])], [drop.z, 0.0]);
    // Fixed: no markers, the regions' distance instead.
    scene.liquid.as_mut().unwrap().surface = scene::Surface::Fixed;
    let state = geometry::initial_state(&scene, &grid, &cut_cells).unwrap();
    assert!(state.markers.is_empty());
    assert_eq!(state.liquid_distance, geometry::liquid_distance(&scene, &grid).unwrap());
    scene.liquid = None;
    let state = geometry::initial_state(&scene, &grid, &cut_cells).unwrap();
    assert!(state.markers.is_empty() && state.liquid_distance.iter().all(|&phi| phi > 0.0));
}

/// A plate 0.3 cells thick, upright and turned, as a box, as a mesh, as a disc; and bodies that are thick enough.
#[test]
fn obstacles_thinner_than_a_cell_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let turn = DMat3::from_axis_angle(DVec3::new(0.6, 0.8, 0.0), 0.7);
    let obstacle = |shape: Shape, inside_out: bool| Obstacle {
        shape,
        placement: Placement { rotate: turn, scale: 0.5, ..Placement::default() },
        inside_out,
        motion: None,
        friction: 0.0,
    };
    let block = |thickness: f64| {
        let half = 0.5 * DVec3::new(0.5, thickness, 0.25);
        (DVec3::splat(0.5) - half, DVec3::splat(0.5) + half)
    };
    let mesh = |name: &str, thickness: f64| {
        let (min, max) = block(thickness);
        let file = folder.path().join(name);
        fs::write(&file, obj_text(&Surface::cuboid(min, max))).unwrap();
        Shape::Mesh { file: file.into(), unit: 1.0 }
    };
    let cuboid = |thickness: f64| {
        let (min, max) = block(thickness);
        Shape::Box { min, max }
    };
    let disc = |height: f64| Shape::Cylinder { base: DVec3::splat(0.5), axis: DVec3::Z, radius: 0.2, height };
    // Nothing gets through it.
    let on_floor = |shape: Shape| Obstacle {
        shape,
        placement: Placement { translate: DVec3::new(0.0, 0.5 * 0.0375 - 0.5, 0.0), ..Placement::default() },
        inside_out: false,
        motion: None,
        friction: 0.0,
    };
    // 16 cells to the metre, half as large: 0.0375 m are 0.3 cells, 0.25 m are 2, more than any direction needs.
    let mut scene = crate::reference_physics::scene([16; 3], &crate::reference_physics::pool(0.3));
    scene.obstacles = vec![
        obstacle(cuboid(0.0375), false),
        obstacle(cuboid(0.25), false),
        obstacle(mesh("thin.obj", 0.0375), false),
        obstacle(mesh("thick.obj", 0.25), false),
        obstacle(disc(0.0375), false),
        obstacle(disc(0.25), false),
        obstacle(cuboid(0.0375), true),
        on_floor(cuboid(0.0375)),
        on_floor(mesh("floor.obj", 0.0375)),
    ];
    let thin = geometry::thin_obstacles(&scene, &scene.grid()).unwrap();
    let numbers: Vec<usize> = thin.iter().map(|wall| wall.body).collect();
    assert_eq!(numbers, [0, 2, 4]);
    for wall in thin {
        assert!((wall.thickness - 0.3).abs() < 1e-6, "{wall:?}");
        let [x, y, z] = match wall.body {
            4 => turn * DVec3::Z,
            _ => turn * DVec3::Y,
        }
        .to_array()
        .map(f64::abs);
        assert!((wall.needed - (x + y + z)).abs() < 1e-9, "{wall:?}");
    }

    // A wall along the axes holds from one cell on; turned by an angle a about one of them, from cos a + sin a on.
    let plate = |cells: f64, degrees: f64, shape: &dyn Fn(f64) -> Shape, motion: Option<Motion>| {
        let placement = Placement { rotate: DMat3::from_rotation_z(degrees.to_radians()), ..Placement::default() };
        Obstacle { motion, placement, ..obstacle(shape(cells / 16.0), false) }
    };
    let tipping = |degrees: f64, start: f64| {
        let frame = |time: f64, degrees: f64| Keyframe {
            time,
            translate: DVec3::ZERO,
            axis: DVec3::Z,
            angle: degrees.to_radians(),
        };
        Some(Motion {
            keyframes: vec![frame(start, 0.0), frame(start + 0.5, degrees), frame(start + 1.0, 0.0)],
            pivot: None,
        })
    };
    let cases = [
        (1.0, 0.0, None, None),
        (0.98, 0.0, None, Some(1.0)),
        (1.35, 30.0, None, Some(1.366)),
        (1.38, 30.0, None, None),
        (1.4, 45.0, None, Some(1.414)),
        (1.43, 45.0, None, None),
        (1.0, 0.0, tipping(30.0, 0.0), Some(1.366)),
        (1.38, 0.0, tipping(30.0, 0.0), None),
        (1.0, 0.0, tipping(90.0, 0.0), Some(1.414)),
        // It stands still for as long as the scene lasts.
        (1.0, 0.0, tipping(30.0, 100.0), None),
    ];
    let file = |thickness: f64| mesh(&format!("plate{thickness}.obj"), thickness);
    for (cells, degrees, motion, needed) in cases {
        for shape in [&cuboid as &dyn Fn(f64) -> Shape, &file] {
            scene.obstacles = vec![plate(cells, degrees, shape, motion.clone())];
            let thin = geometry::thin_obstacles(&scene, &scene.grid()).unwrap();
            let found = thin.first().map(|wall| wall.needed);
            match (found, needed) {
                (None, None) => {}
                (Some(found), Some(needed)) => assert!(f64::abs(found - needed) < 2e-3, "{thin:?}"),
                _ => panic!("{cells} cells at {degrees} degrees: {thin:?}"),
            }
        }
    }
}

/// A tip, an edge, a corner are thin everywhere; a body is thin where no ball fits into it nearby.
#[test]
fn tips_and_edges_are_no_thin_walls() {
    let folder = tempfile::tempdir().unwrap();
    let mut scene = crate::reference_physics::scene([40; 3], &crate::reference_physics::pool(0.3));
    // Of a cone or a wedge with this height and half its width, in cells, about the middle of the domain.
    let cone = |sides: usize, half: f64, height: f64| {
        let mut surface = Surface::default();
        let middle = DVec3::splat(0.5);
        surface.vertices = vec![middle, middle + height / 40.0 * DVec3::Y];
        for i in 0..sides {
            let (sin, cos) = (2.0 * PI * (i as f64 + 0.1) / sides as f64).sin_cos();
            surface.vertices.push(middle + half / 40.0 * DVec3::new(cos, 0.0, sin));
            let (rim, next) = (2 + i as u32, 2 + ((i + 1) % sides) as u32);
            surface.triangles.extend([[0, rim, next], [1, next, rim]]);
        }
        surface
    };
    let mut thin = |name: &str, surface: &Surface| {
        // Fine triangles, so that some lie at the tip.
        let mut fine = surface.clone();
        for _ in 0..4 {
            fine = quartered(&fine);
        }
        let file = folder.path().join(name);
        fs::write(&file, obj_text(&fine)).unwrap();
        scene.obstacles = vec![Obstacle {
            shape: Shape::Mesh { file: file.into(), unit: 1.0 },
            placement: Placement::default(),
            inside_out: false,
            motion: None,
            friction: 0.0,
        }];
        geometry::thin_obstacles(&scene, &scene.grid()).unwrap()
    };
    for (sides, half, height) in [(24, 8.0, 16.0), (24, 8.0, 8.0), (4, 6.0, 12.0), (3, 8.0, 16.0)] {
        let found = thin("cone.obj", &cone(sides, half, height));
        assert!(found.is_empty(), "{sides} sides, {half}, {height}: {found:?}");
    }
    let middle = DVec3::splat(0.5);
    let block = |x: f64, y: f64, z: f64| {
        let half = 0.5 / 40.0 * DVec3::new(x, y, z);
        Surface::cuboid(middle - half, middle + half)
    };
    assert!(thin("block.obj", &block(5.0, 5.0, 5.0)).is_empty());
    // What is as thin over more than its neighbourhood is told: a plate, and a cone like a needle.
    let plate = thin("plate.obj", &block(12.0, 0.5, 12.0));
    assert!((plate[0].thickness - 0.5).abs() < 1e-6, "{plate:?}");
    assert!(!thin("needle.obj", &cone(24, 0.8, 16.0)).is_empty());
}

/// Every triangle cut into four.
fn quartered(surface: &Surface) -> Surface {
    let mut fine = Surface::default();
    for triangle in 0..surface.triangles.len() {
        let [a, b, c] = surface.corners(triangle);
        let [d, e, f] = [0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)];
        for corners in [[a, d, f], [d, b, e], [f, e, c], [d, e, f]] {
            let first = fine.vertices.len() as u32;
            fine.vertices.extend(corners);
            fine.triangles.push([first, first + 1, first + 2]);
        }
    }
    fine.welded()
}

/// A surface as an OBJ file.
pub(crate) fn obj_text(surface: &Surface) -> String {
    let vertices = surface.vertices.iter();
    let vertices = vertices.map(|x| format!("v {} {} {}\n", x.x, x.y, x.z));
    let faces = surface.triangles.iter().map(|t| {
        let [a, b, c] = t.map(|vertex| vertex + 1);
        format!("f {a} {b} {c}\n")
    });
    vertices.chain(faces).collect()
}
