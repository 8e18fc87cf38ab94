//! Stages of the f64 path, each against a known answer.

use cutwater::geometry::CutCells;
use cutwater::grid::{Axis, Grid, Sides};
use cutwater::reference::{
    Ballistic, Lost, PressureSystem, VolumeSource, active_cells, advect_markers, advect_velocity, diagnose, divergence,
    extrapolate, forces, gradient, liquid_distance, liquid_volume, max_speed, n_layers, open_volumes, probe,
    right_hand_side, solve, solve_direct, solve_iterative, surface_distance, theta, volume_rate, write_back,
};
use cutwater::scene::{ProbeKind, Solver, Up};
use cutwater::state::{SolveStatus, State};
use glam::DVec3;

use crate::common::{Random, far_below, surface};

const GRID: Grid = Grid { cells: [6, 5, 4], dx: 0.5 };

/// A value per face, from its centre.
fn on_faces(grid: &Grid, value: impl Fn(DVec3) -> DVec3) -> [Vec<f64>; 3] {
    Axis::ALL.map(|axis| {
        let centre = |face| grid.face_centre(axis, grid.face_at(axis, face));
        (0..grid.n_faces(axis)).map(|face| value(centre(face))[axis.index()]).collect()
    })
}

fn on_cells(grid: &Grid, value: impl Fn(DVec3) -> f64) -> Vec<f64> {
    (0..grid.n_cells()).map(|cell| value(grid.cell_centre(grid.cell_at(cell)))).collect()
}

/// No obstacles: all faces but the walls are open.
fn empty(grid: &Grid) -> CutCells {
    let open = Axis::ALL.map(|axis| {
        let inner = |face| !grid.face_sides(axis, grid.face_at(axis, face)).contains(&None);
        (0..grid.n_faces(axis)).map(|face| f64::from(u8::from(inner(face)))).collect()
    });
    CutCells { open, solid_distance: vec![3.0 * grid.dx; grid.n_cells()] }
}

fn close(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-12
}

#[test]
fn samples_are_exact_for_trilinear_fields_and_clamped_beyond() {
    // Products of different coordinates are trilinear.
    let field = |x: DVec3| 1.0 + x.x - 2.0 * x.y + 0.5 * x.z + x.x * x.y * x.z;
    let faces = on_faces(&GRID, |x| DVec3::splat(field(x)));
    let cells = on_cells(&GRID, field);
    let mut random = Random(1);
    for _ in 0..100 {
        let x = DVec3::from([0, 1, 2].map(|b| random.uniform(0.25, GRID.size()[b] - 0.25)));
        assert!(close(GRID.sample_cells(&cells, x), field(x)));
        for axis in Axis::ALL {
            assert!(close(GRID.sample(axis, &faces[axis.index()], x), field(x)), "{axis:?} at {x}");
        }
        let exact = DVec3::new(1.0 + x.y * x.z, -2.0 + x.x * x.z, 0.5 + x.x * x.y);
        assert!(gradient(&GRID, &cells, x).distance(exact) < 1e-11, "gradient at {x}");
    }
    let beyond = DVec3::new(-7.0, 1.0, 9.0);
    assert!(close(GRID.sample_cells(&cells, beyond), field(DVec3::new(0.25, 1.0, 1.75))));
    assert!(close(GRID.velocity_at(&faces, beyond).x, field(DVec3::new(0.0, 1.0, 1.75))));
    assert!(close(GRID.velocity_at(&faces, beyond).z, field(DVec3::new(0.25, 1.0, 2.0))));
}

#[test]
fn samples_of_a_grid_one_cell_thick_do_not_vary_across_it() {
    let thin = Grid { cells: [4, 4, 1], dx: 0.25 };
    let cells = on_cells(&thin, |x| x.x);
    for z in [0.0, 0.1, 0.25] {
        let x = DVec3::new(0.4, 0.5, z);
        assert!(close(thin.sample_cells(&cells, x), 0.4));
        assert!(gradient(&thin, &cells, x).distance(DVec3::X) < 1e-12);
    }
}

#[test]
fn markers_follow_a_shear_exactly_and_stay_inside() {
    // Along x the velocity depends on y alone: the midpoint rule is exact.
    let faces = on_faces(&GRID, |x| DVec3::new(0.8 * x.y, 0.0, 0.0));
    let open = empty(&GRID).solid_distance;
    let markers = [[0.4, 0.7, 1.1], [2.9, 2.0, 1.9]];
    let deep = far_below(&GRID);
    let (moved, lost) =
        advect_markers(&GRID, Sides::default(), &faces, &open, &surface(&GRID, &deep), &Ballistic::NONE, &markers, 0.5);
    assert_eq!(lost, Lost::default());
    assert!(DVec3::from(moved[0]).distance(DVec3::new(0.4 + 0.5 * 0.8 * 0.7, 0.7, 1.1)) < 1e-12, "{moved:?}");
    assert!(DVec3::from(moved[1]).distance(DVec3::new(3.0 - 0.005, 2.0, 1.9)) < 1e-12, "{moved:?}");
}

#[test]
fn markers_follow_a_rotation_to_second_order() {
    let grid = Grid { cells: [16, 16, 2], dx: 1.0 / 16.0 };
    let faces = on_faces(&grid, |x| DVec3::new(0.5 - x.y, x.x - 0.5, 0.0));
    let solid_distance = empty(&grid).solid_distance;
    let deep = far_below(&grid);
    let error = |steps: u32| {
        let dt = 1.0 / f64::from(steps);
        let mut markers = vec![[0.75, 0.5, 0.05]];
        (0..steps).for_each(|_| {
            markers = advect_markers(
                &grid,
                Sides::default(),
                &faces,
                &solid_distance,
                &surface(&grid, &deep),
                &Ballistic::NONE,
                &markers,
                dt,
            )
            .0
        });
        let (sin, cos) = 1.0_f64.sin_cos();
        DVec3::from(markers[0]).distance(DVec3::new(0.5 + 0.25 * cos, 0.5 + 0.25 * sin, 0.05))
    };
    // 4 in second order; terms of the next order are a step, 1/8, of it at most.
    let ratio = error(8) / error(16);
    assert!((3.5..4.5).contains(&ratio), "halving the step divides the error by {ratio}");
}

#[test]
fn markers_move_with_the_surface_above_them() {
    // The surface is the plane y = 1.5; at the depth of a marker the velocity differs from that 0.67 cells above by 0.67 of its slope.
    let slope = 0.4;
    let faces = on_faces(&GRID, |x| DVec3::new(slope * x.y, 0.0, 0.0));
    let open = empty(&GRID).solid_distance;
    let distance = on_cells(&GRID, |x| x.y - 1.5);
    let (dx, dt) = (GRID.dx, 0.25);
    let ahead = |depth: f64| {
        let start = [1.1, 1.5 - depth * dx, 0.9];
        let sides = Sides::default();
        let surface = surface(&GRID, &distance);
        let (moved, _) = advect_markers(&GRID, sides, &faces, &open, &surface, &Ballistic::NONE, &[start], dt);
        (moved[0][0] - start[0] - dt * slope * start[1]) / (dt * slope * dx)
    };
    for (depth, expected) in [(0.4, 0.67), (1.0, 0.67), (1.25, 0.5025), (1.5, 0.335), (2.0, 0.0), (2.4, 0.0)] {
        let got = ahead(depth);
        assert!((got - expected).abs() < 1e-12, "{depth} cells deep: {got}");
    }
    // Where the slope would take it further, half a cell is the most.
    let steep = on_faces(&GRID, |x| DVec3::new(0.0, 0.0, 8.0 * (x.y - 1.0)));
    let start = [1.1, 1.1, 0.5];
    let surface = surface(&GRID, &distance);
    let sides = Sides::default();
    let (moved, _) = advect_markers(&GRID, sides, &steep, &open, &surface, &Ballistic::NONE, &[start], dt);
    let expected = start[2] + dt * 0.8 + 0.5 * dx;
    assert!((moved[0][2] - expected).abs() < 1e-12, "{moved:?}");
}

#[test]
fn the_surface_is_as_far_from_the_liquid_as_from_the_air() {
    let grid = Grid { cells: [7, 8, 5], dx: 0.25 };
    let far = empty(&grid).solid_distance;
    // Below a plane between the cells, whatever the liquid distance says inside.
    let level = 4.2 * grid.dx;
    let plane = |inside: f64| {
        let phi = on_cells(&grid, |x| {
            let distance = x.y - level;
            if distance > 0.0 { distance } else { inside }
        });
        surface_distance(&grid, &far, &phi)
    };
    let expected = on_cells(&grid, |x| (x.y - level).max(-2.0 * grid.dx));
    for inside in [-grid.dx, -0.3 * grid.dx, 0.0] {
        for (cell, got) in plane(inside).iter().enumerate() {
            let expected = expected[cell];
            let known = expected >= -1.5 * grid.dx;
            assert!(
                (got - expected).abs() < 1e-12 || (!known && *got <= expected + 0.5 * grid.dx),
                "cell {:?}: {got}, expected {expected}",
                grid.cell_at(cell)
            );
        }
    }
    // A bubble of one cell in the liquid, and no surface at all.
    let middle = grid.cell([3, 4, 2]);
    let mut phi = vec![-grid.dx; grid.n_cells()];
    assert!(surface_distance(&grid, &far, &phi).iter().all(|d| *d == -2.0 * grid.dx));
    phi[middle] = 0.1 * grid.dx;
    let bubble = surface_distance(&grid, &far, &phi);
    for (ijk, expected) in [
        ([3, 4, 2], 0.1),
        ([4, 4, 2], -0.9),
        ([3, 3, 1], 0.1 - 2.0_f64.sqrt()),
        ([3, 2, 2], -1.9),
        ([5, 5, 2], -2.0),
        ([0, 4, 2], -2.0),
    ] {
        let got = bubble[grid.cell(ijk)] / grid.dx;
        assert!((got - expected).abs() < 1e-12, "{ijk:?}: {got}");
    }
    // In the middle of an obstacle, where nothing is known of the liquid, there is no surface.
    let mut solid = far;
    solid[middle] = -0.5 * grid.dx;
    phi[middle] = grid.dx;
    let under_water = surface_distance(&grid, &solid, &phi);
    assert!(under_water.iter().all(|d| *d == -2.0 * grid.dx));
}

#[test]
fn markers_leave_obstacles_along_the_normal_or_are_dropped() {
    // A wall through x = 1: everything below is solid.
    let still = on_faces(&GRID, |_| DVec3::ZERO);
    let wall = on_cells(&GRID, |x| x.x - 1.0);
    let deep = far_below(&GRID);
    let (moved, lost) = advect_markers(
        &GRID,
        Sides::default(),
        &still,
        &wall,
        &surface(&GRID, &deep),
        &Ballistic::NONE,
        &[[0.8, 1.0, 1.0], [1.2, 1.0, 1.0]],
        0.1,
    );
    assert_eq!(lost, Lost::default());
    assert!(DVec3::from(moved[0]).distance(DVec3::new(1.05, 1.0, 1.0)) < 1e-12, "{moved:?}");
    assert_eq!(moved[1], [1.2, 1.0, 1.0]);
    // No direction leads out of a constant distance.
    let buried = vec![-0.3; GRID.n_cells()];
    let (moved, lost) = advect_markers(
        &GRID,
        Sides::default(),
        &still,
        &buried,
        &surface(&GRID, &deep),
        &Ballistic::NONE,
        &[[0.8, 1.0, 1.0]],
        0.1,
    );
    assert_eq!((moved.len(), lost.dropped, lost.left), (0, 1, 0));
}

#[test]
fn advection_keeps_a_constant_and_shifts_a_linear_field() {
    let constant = on_faces(&GRID, |_| DVec3::new(0.3, -0.2, 0.1));
    let open = empty(&GRID).open;
    let advected = advect_velocity(&GRID, &open, &constant, &Ballistic::NONE, 0.4);
    assert!(advected.iter().zip(&constant).all(|(a, b)| a.iter().zip(b).all(|(a, b)| close(*a, *b))));
    // v depends on x and is carried along x by 0.5 m/s for 0.6 s: v(x - 0.3), where that lies between faces.
    let field = |x: DVec3| DVec3::new(0.5, 2.0 * x.x, 0.0);
    let advected = advect_velocity(&GRID, &open, &on_faces(&GRID, field), &Ballistic::NONE, 0.6);
    for (face, v) in advected[1].iter().enumerate() {
        let x = GRID.face_centre(Axis::Y, GRID.face_at(Axis::Y, face)).x;
        let exact = 2.0 * (x - 0.3).max(0.25);
        assert!(close(*v, exact), "{v}, exactly {exact}, at x = {x}");
    }
}

#[test]
fn slivers_carry_what_is_and_whole_faces_what_these_show() {
    let grid = Grid { cells: [4, 8, 1], dx: 1.0 };
    // Everything moves along x at 1 m/s but one sliver. Its eight neighbours of the same axis are whole.
    let (sliver, u, dt) = (grid.face(Axis::X, [2, 4, 0]), 3.0, 0.25);
    let mut cut = empty(&grid);
    let mut faces = on_faces(&grid, |_| DVec3::X);
    faces[0][sliver] = u;
    // Between it and the faces before and after it u falls linearly to 1. A trace goes back dt u of where it is half way.
    let carried = |u: f64| u - dt * (u - 0.5 * dt * u * (u - 1.0)) * (u - 1.0);
    for (a, part_of_shown) in [(0.05, 0.0), (0.15, 0.5)] {
        cut.open[0][sliver] = a;
        let advected = &advect_velocity(&grid, &cut.open, &faces, &Ballistic::NONE, dt)[0];
        let shows = u + (1.0 - a / 0.2) * (1.0 - u);
        let expected = carried(u) + part_of_shown * (carried(shows) - carried(u));
        assert!(close(advected[sliver], expected), "{a} open");
        let back = dt * (1.0 + 0.5 * dt * (shows - 1.0));
        let next = advected[grid.face(Axis::X, [3, 4, 0])];
        assert!(close(next, 1.0 + back * (shows - 1.0)), "{a} open");
    }
    // Closed faces and those that are a fifth open are carried as they are.
    for open in [0.0, 0.2] {
        cut.open[0][sliver] = open;
        let whole = advect_velocity(&grid, &empty(&grid).open, &faces, &Ballistic::NONE, dt);
        assert_eq!(advect_velocity(&grid, &cut.open, &faces, &Ballistic::NONE, dt), whole);
    }
    // A film of slivers shows what it is; almost as much, where the others are no more than just whole.
    let whole = advect_velocity(&grid, &empty(&grid).open, &faces, &Ballistic::NONE, dt);
    for open in [0.15, 0.2 + 1e-9] {
        let mut film = cut.open.each_ref().map(|faces| vec![open; faces.len()]);
        film[0][sliver] = 0.15;
        let advected = advect_velocity(&grid, &film, &faces, &Ballistic::NONE, dt);
        let pairs = advected.iter().flatten().zip(whole.iter().flatten());
        assert!(pairs.into_iter().all(|(u, expected)| (u - expected).abs() < 1e-6));
    }
}

#[test]
fn gravity_acts_on_every_face() {
    let mut faces = on_faces(&GRID, |x| x);
    forces(&mut faces, DVec3::new(1.0, -9.81, 0.5), 0.1);
    let exact = on_faces(&GRID, |x| x + DVec3::new(0.1, -0.981, 0.05));
    assert!(faces.iter().flatten().zip(exact.iter().flatten()).all(|(a, b)| close(*a, *b)));
}

/// The union of spheres, straight from its definition.
fn slow_distance(grid: &Grid, markers: &[[f64; 3]], radius: f64) -> Vec<f64> {
    let holds = |c: [i64; 3]| {
        let beyond = (0..3).any(|b| c[b] < 0 || c[b] >= grid.cells[b] as i64);
        beyond || markers.iter().any(|m| (0..3).all(|b| (m[b] / grid.dx).floor() as i64 == c[b]))
    };
    let cells = (0..grid.n_cells()).map(|cell| {
        let at = grid.cell_at(cell).map(|n| n as i64);
        let around = (0..27).map(|n| [at[0] + n % 3 - 1, at[1] + n / 3 % 3 - 1, at[2] + n / 9 - 1]);
        if around.into_iter().all(holds) {
            return -grid.dx;
        }
        let centre = grid.cell_centre(grid.cell_at(cell));
        let nearest = markers.iter().map(|&m| centre.distance(DVec3::from(m))).fold(2.0 * grid.dx, f64::min);
        nearest - radius
    });
    cells.collect()
}

#[test]
fn liquid_distance_is_the_union_of_spheres() {
    let grid = Grid { cells: [9, 8, 7], dx: 0.25 };
    let mut random = Random(3);
    let mut place = |top: f64| [0, 1, 2].map(|b| random.uniform(0.0, if b == 1 { top } else { grid.size()[b] }));
    // Enough at the bottom for interior cells, a few strays above.
    let mut markers: Vec<_> = (0..3000).map(|_| place(1.0)).collect();
    markers.extend((0..6).map(|_| place(2.0)));
    let radius = 0.87 * grid.dx;
    let phi = liquid_distance(&grid, &empty(&grid), &markers, radius);
    let slow = slow_distance(&grid, &markers, radius);
    assert!(phi.iter().zip(&slow).all(|(a, b)| close(*a, *b)), "differs from the definition");
    assert!(slow.contains(&-grid.dx), "there are interior cells");
    let none = liquid_distance(&grid, &empty(&grid), &[], radius);
    assert!(none.iter().all(|phi| close(*phi, 2.0 * grid.dx - radius)));
}

#[test]
fn liquid_distance_goes_into_obstacles_through_open_faces() {
    // A row of 7 cells; the last 5 centres are solid.
    let grid = Grid { cells: [7, 1, 1], dx: 1.0 };
    let mut cut = empty(&grid);
    cut.solid_distance = vec![0.6, 0.1, -0.2, -1.2, -2.2, -3.0, -3.0];
    cut.open[0][2] = 0.25;
    let phi = liquid_distance(&grid, &cut, &[[1.5, 0.5, 0.5]], 0.87);
    // Each has one known neighbour and keeps within its range: it copies. Three passes, then air.
    let exact = [0.13, -0.87, -0.87, -0.87, -0.87, 1.0, 1.0];
    assert!(phi.iter().zip(exact).all(|(a, b)| close(*a, b)), "{phi:?}");

    // Two known neighbours, weighted by their open fractions, and the slope between the second and the one behind it, at which half
    // a pair is open; a closed face does not count.
    cut.solid_distance = vec![0.1, -0.1, 0.1, 3.0, 0.1, -0.1, 0.1];
    cut.open[0] = vec![0.0, 0.25, 0.5, 1.0, 1.0, 0.0, 0.0, 0.0];
    let phi = liquid_distance(&grid, &cut, &[[0.5, 0.5, 0.5], [4.2, 0.5, 0.5]], 0.87);
    let slope = 0.5 * (phi[3] - phi[2]) / (1.0 + 0.5);
    let mean = (0.25 * (phi[0] + slope) + 0.5 * (phi[2] - slope)) / 0.75;
    assert!(slope < -0.3 && close(phi[1], mean) && close(phi[5], 1.0), "{phi:?}");
}

/// A centre just inside an overhang, with more open below it than beside it: beside it the level lies 0.4 cells lower, and so it does
/// here. The mean alone says liquid.
#[test]
fn liquid_distance_stands_no_higher_in_obstacles_than_beside_them() {
    let grid = Grid { cells: [3, 4, 3], dx: 1.0 };
    let mut cut = empty(&grid);
    let at = |i, j, k| grid.cell([i, j, k]);
    cut.solid_distance[at(1, 2, 1)] = -0.05;
    cut.solid_distance[at(1, 3, 1)] = -0.6;
    cut.solid_distance[at(2, 2, 1)] = -0.6;
    cut.solid_distance[at(1, 2, 2)] = -0.3;
    // Below 0.9, in front 0.6, on one side 0.4 open; nothing above and behind.
    let mut face = |axis: Axis, ijk, open| cut.open[axis.index()][grid.face(axis, ijk)] = open;
    face(Axis::Y, [1, 2, 1], 0.9);
    face(Axis::Z, [1, 2, 1], 0.6);
    face(Axis::X, [1, 2, 1], 0.4);
    face(Axis::Y, [1, 3, 1], 0.0);
    face(Axis::X, [2, 2, 1], 0.0);
    face(Axis::Z, [1, 2, 2], 0.0);
    // Markers so dense that above them phi is the height over the level, 2.1.
    let steps = |n: usize| (0..n).map(|s| (s as f64 + 0.5) * 0.05);
    let markers: Vec<_> = steps(60)
        .flat_map(|x| steps(60).map(move |z| (x, z)))
        .flat_map(|(x, z)| [0.5, 1.23].map(|y| [x, y, z]))
        .collect();
    let phi = liquid_distance(&grid, &cut, &markers, 0.87);
    let mean = (0.9 * phi[at(1, 1, 1)] + 0.3 * phi[at(1, 2, 0)] + 0.2 * phi[at(0, 2, 1)]) / 1.4;
    assert!(mean < -0.1, "the mean is {mean}");
    let value = phi[at(1, 2, 1)];
    assert!((0.0..0.5).contains(&value), "{value} where it is 0.4 beside it");
}

#[test]
fn weights_and_ghost_parts_of_active_cells() {
    // A column of liquid two cells high under air, beside a closed wall.
    let grid = Grid { cells: [2, 3, 1], dx: 1.0 };
    let mut cut = empty(&grid);
    let inner = grid.face(Axis::X, [1, 0, 0]);
    cut.open[0][inner] = 0.4;
    let phi = [-1.2, -1.0, -0.2, -0.001, 0.8, 1.5];
    let active = active_cells(&grid, &cut.open, &phi, 0.01);
    assert_eq!(active.stencil.active_mask(), [true, true, true, true, false, false]);
    assert!(close(active.stencil.weight[0][inner], 0.4));
    assert!(close(active.stencil.dirichlet[2], 1.0 / 0.2) && close(active.stencil.dirichlet[3], 1.0 / 0.01));
    assert!(close(theta(-0.2, 0.8, 0.01), 0.2) && close(theta(-0.001, 1.5, 0.01), 0.01));
    assert!(active.closed.is_empty());
    // phi = 0 is outside.
    assert!(!active_cells(&grid, &cut.open, &[0.0; 6], 0.01).stencil.active(0));
    // A cell without an open face is no unknown, whatever it holds.
    let shut = Axis::ALL.map(|axis| vec![0.0; grid.n_faces(axis)]);
    assert!(active_cells(&grid, &shut, &[-1.0; 6], 0.01).stencil.active_cells().is_empty());
}

#[test]
fn closed_components_are_found_and_solved_beside_an_open_one() {
    // A wall at x = 2 cells keeps the full left part from the right part, which has a surface.
    let grid = Grid { cells: [5, 4, 3], dx: 0.2 };
    let mut cut = empty(&grid);
    for face in 0..grid.n_faces(Axis::X) {
        if grid.face_at(Axis::X, face)[0] == 2 {
            cut.open[0][face] = 0.0;
        }
    }
    let phi = on_cells(&grid, |x| if x.x < 0.4 { -1.0 } else { x.y - 0.45 });
    let mut random = Random(5);
    let mut u =
        Axis::ALL.map(|axis| -> Vec<f64> { (0..grid.n_faces(axis)).map(|_| random.uniform(-1.0, 1.0)).collect() });
    let active = active_cells(&grid, &cut.open, &phi, 0.01);
    let left: Vec<_> = (0..grid.n_cells()).filter(|&cell| grid.cell_at(cell)[0] < 2).collect();
    assert_eq!(active.closed, std::slice::from_ref(&left));

    // Volume control acts on the open component alone.
    let volumes = open_volumes(&grid, &cut.solid_distance);
    let source = VolumeSource { rate: 0.5, open_volumes: &volumes };
    let with = right_hand_side(&grid, &cut.open, &u, &active, Some(source)).values;
    let rhs = right_hand_side(&grid, &cut.open, &u, &active, None);
    for cell in active.stencil.active_cells() {
        let expected = if left.contains(&cell) { 0.0 } else { 0.5 * grid.cell_volume() };
        assert!((with[cell] - rhs.values[cell] - expected).abs() < 1e-15);
    }
    let sum: f64 = left.iter().map(|&cell| rhs.values[cell]).sum();
    assert!(sum.abs() < 1e-15, "the closed right-hand side keeps a sum of {sum}");

    let system = PressureSystem::new(active, rhs, 0.01, 1000.0);
    let settings = Solver { tolerance: 1e-12, ..Solver::default() };
    let (direct, report) = solve_direct(&system, &settings).unwrap();
    assert_eq!(report.status, SolveStatus::Converged, "{report:?}");
    let (iterative, report) = solve_iterative(&system, &settings);
    assert_eq!(report.status, SolveStatus::Converged, "{report:?}");
    let largest = direct.iter().fold(0.0_f64, |m, p| m.max(p.abs()));
    assert!(direct.iter().zip(&iterative).all(|(a, b)| (a - b).abs() < 1e-9 * largest));
    let mean: f64 = left.iter().map(|&cell| direct[cell]).sum();
    assert!(mean.abs() < 1e-12 * largest, "the closed pressure has mean {mean}");

    // The projected field has no divergence.
    let valid = write_back(&system, &direct, &cut.open, &phi, 0.01, &mut u);
    let left = divergence(&cut.open, &u, &system.stencil, None);
    assert!(left < 1e-10, "divergence {left}");
    assert!(!valid[0][grid.face(Axis::X, [2, 1, 1])] && valid[0][grid.face(Axis::X, [1, 1, 1])]);
    assert!(!valid[1][grid.face(Axis::Y, [3, 3, 0])], "a face between air cells is valid");
    assert!(valid[1][grid.face(Axis::Y, [3, 2, 0])], "the free surface is not valid");
}

#[test]
fn the_matrix_is_the_operator_and_a_zero_right_hand_side_gives_zero() {
    let grid = Grid { cells: [4, 4, 4], dx: 0.25 };
    let cut = empty(&grid);
    let phi = on_cells(&grid, |x| x.y + 0.1 * x.x - 0.6);
    let active = active_cells(&grid, &cut.open, &phi, 0.01);
    let u = on_faces(&grid, |x| DVec3::new(x.y, x.z * x.y, 1.0 - x.x));
    let rhs = right_hand_side(&grid, &cut.open, &u, &active, None);
    let mut system = PressureSystem::new(active, rhs, 0.01, 1000.0);
    let matrix = system.to_csr();
    assert_eq!(matrix.asymmetry(), 0.0);
    let cells = system.stencil.active_cells();
    let mut random = Random(9);
    let mut x = vec![0.0; grid.n_cells()];
    cells.iter().for_each(|&cell| x[cell] = random.uniform(-1.0, 1.0));
    let packed: Vec<f64> = cells.iter().map(|&cell| x[cell]).collect();
    let mut product = vec![0.0; cells.len()];
    matrix.multiply(&packed, &mut product);
    let residual = system.residual(&x);
    for (row, &cell) in cells.iter().enumerate() {
        assert!((system.rhs[cell] - product[row] - residual[cell]).abs() < 1e-17, "row {row}");
    }

    system.rhs.fill(0.0);
    for (pressure, report) in
        [solve_direct(&system, &Solver::default()).unwrap(), solve_iterative(&system, &Solver::default())]
    {
        assert!(pressure.iter().all(|p| *p == 0.0));
        assert_eq!((report.iterations, report.residual, report.status), (0, 0.0, SolveStatus::Converged));
    }
    system.rhs[cells[0]] = f64::NAN;
    assert_eq!(solve(&system, &Solver::default()).unwrap().1.status, SolveStatus::NonFinite);
}

#[test]
fn a_solve_that_may_not_iterate_enough_says_so() {
    let system = cutwater::reference::base_block::BaseBlock::new(12).pressure_system();
    let settings = Solver { max_iterations: 3, ..Solver::default() };
    let (_, report) = solve_iterative(&system, &settings);
    assert_eq!((report.status, report.iterations), (SolveStatus::IterationLimit, 3));
    assert!(report.residual > 1e-8 && report.residual < 1.0, "{report:?}");
}

#[test]
fn volume_control_spreads_over_half_its_time_and_is_capped() {
    let (time, dt) = (0.05, 0.01);
    let deficit = 1.0 / 0.99 - 1.0;
    assert!(close(volume_rate(1.0, 0.99, time, dt), deficit / 0.025));
    assert!(close(volume_rate(1.0, 0.99, time, 0.05), deficit / 0.075));
    assert!(close(volume_rate(1.0, 0.5, time, dt), 0.1 / time));
    assert!(close(volume_rate(1.0, 2.0, time, dt), -0.1 / time));
    assert_eq!(volume_rate(1.0, 0.0, time, dt), 0.0);
}

#[test]
fn extrapolation_takes_means_layer_by_layer() {
    let grid = Grid { cells: [8, 3, 1], dx: 1.0 };
    let cut = empty(&grid);
    let mut faces = on_faces(&grid, |_| DVec3::splat(99.0));
    let mut valid = Axis::ALL.map(|axis| vec![false; grid.n_faces(axis)]);
    for (j, value) in [(0, 1.0), (2, 4.0)] {
        let face = grid.face(Axis::X, [2, j, 0]);
        (faces[0][face], valid[0][face]) = (value, true);
    }
    extrapolate(&grid, &cut, None, valid, 2, &mut faces);
    let x = |i, j| faces[0][grid.face(Axis::X, [i, j, 0])];
    assert_eq!([x(2, 0), x(2, 1), x(2, 2)], [1.0, 2.5, 4.0]);
    // First layer: one beside, or two across an edge. Second: the one beside, whatever is across an edge.
    assert_eq!([x(3, 0), x(3, 1), x(3, 2)], [1.0, 2.5, 4.0]);
    assert_eq!([x(4, 0), x(4, 1), x(4, 2)], [1.0, 2.5, 4.0]);
    for j in 0..3 {
        assert_eq!(x(5, j), 0.0, "the third layer is not reached");
    }
    assert_eq!(x(0, 0), 0.0, "walls do not let liquid through");
    assert!(faces[1].iter().all(|v| *v == 0.0), "axes do not mix");
    assert_eq!(n_layers(2.5), 5);

    // One layer around two faces, which are not beside each other: faces that differ in one index go before those that differ in
    // two, and these before those that differ in three.
    let grid = Grid { cells: [8, 4, 4], dx: 1.0 };
    let cut = empty(&grid);
    let mut faces = on_faces(&grid, |_| DVec3::ZERO);
    let mut valid = Axis::ALL.map(|axis| vec![false; grid.n_faces(axis)]);
    for (ijk, value) in [([3, 0, 0], 1.0), ([3, 1, 2], 7.0)] {
        let face = grid.face(Axis::X, ijk);
        (faces[0][face], valid[0][face]) = (value, true);
    }
    extrapolate(&grid, &cut, None, valid, 1, &mut faces);
    let x = |ijk| faces[0][grid.face(Axis::X, ijk)];
    assert_eq!([x([4, 0, 0]), x([4, 1, 0])], [1.0, 1.0], "one index, two");
    assert_eq!(x([3, 1, 1]), 7.0, "one index before two");
    assert_eq!(x([3, 0, 1]), 1.0, "one index before two");
    assert_eq!([x([4, 1, 1]), x([4, 0, 1])], [7.0, 1.0], "two before three");
    assert_eq!([x([4, 2, 3]), x([2, 0, 3])], [7.0, 7.0], "three alone");
    assert_eq!([x([5, 0, 0]), x([4, 3, 2])], [0.0, 0.0], "two layers off");
}

#[test]
fn slivers_keep_their_velocity_and_show_what_their_area_is_worth() {
    let grid = Grid { cells: [4, 8, 1], dx: 1.0 };
    // Valid faces across x at i = 1 and 2 with a fraction and a velocity; those at i = 3 are closed.
    let shown = |fraction: f64, sliver: f64, rest: f64, full: f64| {
        let mut cut = empty(&grid);
        let mut faces = on_faces(&grid, |_| DVec3::ZERO);
        let mut valid = Axis::ALL.map(|axis| vec![false; grid.n_faces(axis)]);
        for j in 0..8 {
            let [near, far, closed] = [2, 1, 3].map(|i| grid.face(Axis::X, [i, j, 0]));
            (cut.open[0][near], faces[0][near], valid[0][near]) = (fraction, sliver, true);
            (cut.open[0][far], faces[0][far], valid[0][far]) = (rest, full, true);
            cut.open[0][closed] = 0.0;
        }
        extrapolate(&grid, &cut, None, valid, 1, &mut faces);
        let x = |i| faces[0][grid.face(Axis::X, [i, 4, 0])];
        assert_eq!([x(1), x(2)], [full, sliver], "valid faces stay as they are");
        x(3)
    };
    // Five neighbours: two slivers and three whole faces.
    let (a, [u, v]) = (0.05, [100.0, 1.0]);
    let mean = (2.0 * a * u + 3.0 * v) / (2.0 * a + 3.0);
    assert!(close(shown(a, u, 1.0, v), u + 0.75 * (mean - u)));
    assert!((shown(1e-6, u, 1.0, v) - v).abs() < 1e-2, "almost closed: what is around it");
    assert_eq!(shown(0.2, u, 1.0, v), u, "a fifth open: no sliver");
    assert!(close(shown(a, u, a, u), u), "a film that flows as one shows its velocity");
}

#[test]
fn faces_in_obstacles_slip() {
    // Solid below a plane tilted by 45 degrees.
    let grid = Grid { cells: [8, 8, 4], dx: 1.0 };
    let mut cut = empty(&grid);
    let normal = DVec3::new(1.0, 1.0, 0.0).normalize();
    let depth = |x: DVec3| (x - DVec3::splat(4.0)).dot(normal);
    cut.solid_distance = on_cells(&grid, depth);
    for axis in Axis::ALL {
        for face in 0..grid.n_faces(axis) {
            if depth(grid.face_centre(axis, grid.face_at(axis, face))) < 0.0 {
                cut.open[axis.index()][face] = 0.0;
            }
        }
    }
    let flow = DVec3::new(3.0, 1.0, 0.5);
    let mut faces = on_faces(&grid, |_| flow);
    let valid = Axis::ALL.map(|axis| vec![true; grid.n_faces(axis)]);
    extrapolate(&grid, &cut, None, valid, 1, &mut faces);
    let [inside, outside] =
        [[2, 2, 1], [6, 6, 1]].map(|ijk| Axis::ALL.map(|axis| faces[axis.index()][grid.face(axis, ijk)]));
    let slipped = flow - flow.dot(normal) * normal;
    assert!(DVec3::from(inside).distance(slipped) < 1e-12, "{inside:?}, exactly {slipped}");
    assert_eq!(DVec3::from(outside), flow);
}

#[test]
fn diagnosis_of_a_moving_block() {
    let grid = Grid { cells: [4, 4, 4], dx: 0.5 };
    let cut = empty(&grid);
    let phi = on_cells(&grid, |x| x.y - 1.1);
    let volumes = open_volumes(&grid, &cut.solid_distance);
    // Two full layers and a fifth of the third.
    assert!(close(liquid_volume(&grid, &volumes, &phi), 4.0 * 1.1));
    let u = on_faces(&grid, |_| DVec3::new(2.0, -1.0, 0.5));
    let stencil = active_cells(&grid, &cut.open, &phi, 0.01).stencil;
    let diagnosis =
        diagnose(&grid, &cut, &phi, &u, divergence(&cut.open, &u, &stencil, None), 1000.0, DVec3::new(0.0, -10.0, 0.0));
    assert!(close(diagnosis.volume, 4.4) && diagnosis.max_speed == 2.0);
    assert!(DVec3::from(diagnosis.momentum).distance(4400.0 * DVec3::new(2.0, -1.0, 0.5)) < 1e-9);
    assert!((diagnosis.kinetic_energy - 4400.0 * 0.5 * 5.25).abs() < 1e-9);
    // Layers at 0.25, 0.75 and 1.25 m.
    let potential = 10.0 * 1000.0 * (2.0 * 0.25 + 2.0 * 0.75 + 0.4 * 1.25);
    assert!((diagnosis.potential_energy - potential).abs() < 1e-9, "{}", diagnosis.potential_energy);
    // The block runs into the wall at 2 m/s and into the floor at 1 m/s, faces of 0.25 m^2 in cells of 0.125 m^3: at an edge
    // both meet, and a side wall adds 0.5 m/s.
    assert!(close(diagnosis.divergence, (2.0 + 1.0 + 0.5) / 0.5), "{}", diagnosis.divergence);
    let mut broken = u;
    broken[1][3] = f64::NAN;
    assert!(max_speed(&broken).is_nan());
}

#[test]
fn probes_read_a_pool() {
    let grid = Grid { cells: [6, 8, 4], dx: 0.25 };
    let mut state = State::at_rest(&grid);
    let level = |x: DVec3| 1.3 - 0.2 * x.x;
    state.liquid_distance = on_cells(&grid, |x| x.y - level(x));
    state.active = state.liquid_distance.iter().map(|phi| *phi < 0.0).collect();
    state.pressure = on_cells(&grid, |x| (100.0 * (1.0 - x.y)).max(0.0));
    state.velocity = on_faces(&grid, |x| x);
    let mut open = on_faces(&grid, |_| DVec3::ONE);
    let read = |kind| probe(&grid, &open, &state, &kind);
    let point = DVec3::new(0.6, 0.7, 0.4);
    let foot = DVec3::new(0.6, 0.0, 0.4);
    let up = Up::against(DVec3::NEG_Y);
    assert!(close(read(ProbeKind::Height { foot, up })[0], 1.3 - 0.12));
    // Upside down the liquid hangs from the other side: its surface is its far end from there.
    let down = Up::against(DVec3::Y);
    let size = grid.size();
    assert!(close(read(ProbeKind::Height { foot, up: down })[0], size.y));
    // Along x, below the lowest crest, it goes from wall to wall.
    let along = ProbeKind::Height { foot: DVec3::new(0.0, 0.2, 0.4), up: Up::against(DVec3::NEG_X) };
    assert!(close(read(along)[0], size.x));
    assert!(close(read(ProbeKind::Pressure { point })[0], 30.0));
    assert!(DVec3::from_slice(&read(ProbeKind::Velocity { point })).distance(point) < 1e-12);
    assert_eq!(read(ProbeKind::Front { axis: 0, lower: false }), [1.5], "the liquid touches the far wall");
    let front = read(ProbeKind::Front { axis: 1, lower: false })[0];
    assert!(close(front, level(DVec3::new(0.125, 0.0, 0.0))), "the highest column reaches {front} m");
    let lower = |axis| read(ProbeKind::Front { axis, lower: true })[0];
    assert_eq!([lower(0), lower(1)], [0.0, 0.0], "the liquid touches these walls");
    // Drops: their lower ends lie between cells.
    let drop = DVec3::new(0.7, 1.1, 0.55);
    let mut falling = State::at_rest(&grid);
    falling.liquid_distance = on_cells(&grid, |x| (x - drop).abs().max_element() - 0.3);
    falling.active = falling.liquid_distance.iter().map(|phi| *phi < 0.0).collect();
    for axis in 0..3 {
        let [low, high] =
            [true, false].map(|lower| probe(&grid, &open, &falling, &ProbeKind::Front { axis, lower })[0]);
        assert!(close(low, drop[axis] - 0.3), "axis {axis}: {low}");
        assert!(close(high, drop[axis] + 0.3), "axis {axis}: {high}");
    }
    // Flux of the velocity x through planes: x times the wet area, exact between planes of faces as it is linear there.
    let flux = |open: &_, axis, min, max| {
        let kind = ProbeKind::Flux { axis, min, max };
        probe(&grid, open, &state, &kind)[0]
    };
    let (low, high) = (DVec3::new(0.6, 0.1, 0.05), DVec3::new(0.6, 0.7, 0.9));
    let wet = flux(&open, 0, low, high);
    assert!(close(wet, 0.6 * 0.6 * 0.85), "{wet} m^3/s below the surface");
    let high = DVec3::new(0.5, size.y, size.z);
    // Wet faces end half a cell to both sides of the level, so that a level surface is exact; this one is level across a face.
    let whole = flux(&open, 0, DVec3::new(0.5, 0.0, 0.0), high);
    assert!(close(whole, 0.5 * 1.2 * size.z), "{whole} m^3/s");
    let (low, high) = (DVec3::new(0.0, 0.3, 0.0), DVec3::new(size.x, 0.3, size.z));
    assert!(close(flux(&open, 1, low, high), 0.3 * size.x * size.z));
    let (low, high) = (DVec3::new(0.0, 0.0, size.z), DVec3::new(size.x, 0.5, size.z));
    assert!(close(flux(&open, 2, low, high), size.z * size.x * 0.5), "at the wall");
    open[2].iter_mut().for_each(|open| *open = 0.25);
    assert!(close(flux(&open, 2, low, high), 0.25 * size.z * size.x * 0.5));
    let read = |kind| probe(&grid, &open, &state, &kind);
    assert_eq!(read(ProbeKind::Front { axis: 0, lower: true }), [0.0]);
    // A buried cell beside the point does not pull the pressure down; air does.
    let buried = grid.cell([2, 2, 1]);
    state.active[buried] = false;
    state.pressure[buried] = 0.0;
    let beside = DVec3::new(0.8, 0.625, 0.375);
    let pressure = probe(&grid, &open, &state, &ProbeKind::Pressure { point: beside })[0];
    assert!(close(pressure, 37.5), "{pressure} Pa");
    let nothing = State::at_rest(&grid);
    for kind in
        [ProbeKind::Height { foot, up }, ProbeKind::Front { axis: 2, lower: false }, ProbeKind::Pressure { point }]
    {
        assert_eq!(probe(&grid, &open, &nothing, &kind), [0.0], "{kind:?} without liquid");
    }
    let lower = ProbeKind::Front { axis: 2, lower: true };
    assert_eq!(probe(&grid, &open, &nothing, &lower), [size.z]);
}
