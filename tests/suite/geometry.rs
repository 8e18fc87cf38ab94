//! Clipping, open areas, distances, mesh files and seeding, against independent constructions.

use cutwater::geometry::{self, CutCells};
use cutwater::grid::Grid;
use cutwater::scene::{self, Domain, Liquid, Output, Region, Scene, Shape, Solver, Time};
use glam::DVec3;

/// A scene on [0, size] with cubic cells and nothing in it.
fn empty_scene(cells: [usize; 3], dx: f64) -> Scene {
    let size = DVec3::from_array(cells.map(|n| n as f64 * dx));
    Scene {
        name: "test".into(),
        file: "test.toml".into(),
        hash: String::new(),
        scale: 1.0,
        overrides: Vec::new(),
        domain: Domain {
            size,
            cells,
            gravity: DVec3::new(0.0, -9.81, 0.0),
        },
        time: Time {
            duration: 1.0,
            frames_per_second: 24.0,
            cfl: 3.0,
            fixed_step: None,
        },
        liquid: None,
        obstacles: Vec::new(),
        probes: Vec::new(),
        solver: Solver::default(),
        output: Output {
            particles: true,
            fields: false,
            every: 1,
        },
        camera: scene::Camera {
            eye: DVec3::ONE,
            target: DVec3::ZERO,
            up: DVec3::Y,
            fov: 40.0,
            size: [64, 64],
        },
    }
}

fn liquid(shapes: &[Shape]) -> Liquid {
    let regions = shapes.iter().map(|shape| Region {
        shape: shape.clone(),
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
    }
}

/// The volume that the union-of-spheres rule gives to markers, m^3.
fn sphere_volume(grid: &Grid, cut_cells: &CutCells, markers: &[[f64; 3]], radius: f64) -> f64 {
    let [nx, ny, nz] = grid.cells.map(|n| n as isize);
    let dx = grid.dx;
    let mut nearest = vec![2.0 * dx; grid.n_cells()];
    let mut occupied = vec![false; grid.n_cells()];
    let all = (-2..=2).flat_map(|k| (-2..=2).flat_map(move |j| (-2..=2).map(move |i| [i, j, k])));
    let around: Vec<[isize; 3]> = all.collect();
    let cell_of = |at: [isize; 3]| {
        let inside =
            (0..nx).contains(&at[0]) && (0..ny).contains(&at[1]) && (0..nz).contains(&at[2]);
        inside.then(|| grid.cell(at.map(|i| i as usize)))
    };
    for &marker in markers {
        let at = marker.map(|x| (x / dx).floor() as isize);
        occupied[cell_of(at).expect("markers lie in the domain")] = true;
        for step in &around {
            if let Some(cell) = cell_of([at[0] + step[0], at[1] + step[1], at[2] + step[2]]) {
                let centre = grid.cell_centre(grid.cell_at(cell));
                nearest[cell] = nearest[cell].min((centre - DVec3::from_array(marker)).length());
            }
        }
    }
    let volume = (0..grid.n_cells()).map(|cell| {
        let at = grid.cell_at(cell).map(|i| i as isize);
        let interior = around
            .iter()
            .filter(|step| step.iter().all(|c| c.abs() <= 1))
            .all(|step| {
                cell_of([at[0] + step[0], at[1] + step[1], at[2] + step[2]])
                    .is_none_or(|c| occupied[c] || cut_cells.solid_distance[c] < 0.0)
            });
        let phi = if interior {
            -dx
        } else {
            nearest[cell] - radius * dx
        };
        geometry::open_volume(cut_cells.solid_distance[cell], dx) * (0.5 - phi / dx).clamp(0.0, 1.0)
    });
    volume.sum::<f64>() * dx.powi(3)
}

#[test]
fn seeded_volume_is_within_one_percent() {
    let n = 32;
    let cuboid = |min: [f64; 3], max: [f64; 3]| Shape::Box {
        min: DVec3::from_array(min),
        max: DVec3::from_array(max),
    };
    let ball = 4.0 / 3.0 * std::f64::consts::PI;
    // The level of the second lies anywhere in a cell, the boxes of the fourth touch inside one.
    let cases = [
        (vec![cuboid([0.0; 3], [1.0, 0.5, 1.0])], 0.5),
        (vec![cuboid([0.0; 3], [0.3, 0.61, 1.0])], 0.3 * 0.61),
        (
            vec![Shape::Sphere {
                centre: DVec3::new(0.513, 0.507, 0.491),
                radius: 0.25,
            }],
            ball * 0.25_f64.powi(3),
        ),
        (
            vec![
                cuboid([0.0; 3], [0.31, 0.4, 1.0]),
                cuboid([0.31, 0.0, 0.0], [1.0, 0.4, 1.0]),
            ],
            0.4,
        ),
    ];
    for (shapes, exact) in cases {
        let mut scene = empty_scene([n; 3], 1.0 / n as f64);
        scene.liquid = Some(liquid(&shapes));
        let grid = scene.grid();
        let cut_cells = geometry::cut_cells(&scene, &grid).unwrap();
        let markers = geometry::seed_markers(&scene, &grid, &cut_cells).unwrap();
        let volume = sphere_volume(&grid, &cut_cells, &markers, 0.87);
        assert!(
            (volume / exact - 1.0).abs() < 0.01,
            "{shapes:?}: {volume} for {exact}"
        );
    }
}
