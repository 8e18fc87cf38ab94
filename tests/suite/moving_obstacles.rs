//! Obstacles that move: what they cut out of the grid, what they take up of the liquid, and steps of the f64 path beside them.

use std::fs;
use std::path::Path;

use cutwater::elastic::Solids;
use cutwater::geometry::{ObstacleCut, initial_state, obstacle_cut};
use cutwater::grid::{Axis, Grid};
use cutwater::reference::{Reference, TimeStep};
use cutwater::scene::{Keyframe, Motion, Obstacle, Placement, Scene, Shape};
use cutwater::sim::{Backend, Simulation};
use cutwater::state::{SolveStatus, StepReport};
use glam::{DMat3, DVec3};

use crate::common::Random;
use crate::reference_physics::{GRAVITY, pool, scene};

fn still(shape: Shape) -> Obstacle {
    Obstacle { shape, placement: Placement::default(), inside_out: false, motion: None, friction: 0.0 }
}

/// At rest at t = 0, and where the second keyframe puts it at t = 1.
fn moving(translate: DVec3, axis: DVec3, angle: f64, pivot: Option<DVec3>) -> Motion {
    let frame =
        |time, share| Keyframe { time, translate: share * translate, axis: axis.normalize(), angle: share * angle };
    Motion { keyframes: vec![frame(0.0, 0.0), frame(1.0, 1.0)], pivot }
}

fn vector(random: &mut Random, low: f64, high: f64) -> DVec3 {
    DVec3::from([(); 3].map(|()| random.uniform(low, high)))
}

/// A box, a ball, a cylinder, a mesh and a container in a domain of 1 m.
fn shapes(folder: &Path) -> Vec<(Shape, DVec3, bool)> {
    let file = folder.join("wedge.obj");
    let text = "v 0.3 0.2 0.3\nv 0.7 0.2 0.3\nv 0.5 0.7 0.45\nv 0.5 0.3 0.8\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
    fs::write(&file, text).unwrap();
    let cuboid = |min: f64, max: f64| Shape::Box { min: DVec3::splat(min), max: DVec3::splat(max) };
    let centre = DVec3::splat(0.5);
    vec![
        (cuboid(0.31, 0.62), DVec3::splat(0.465), false),
        (Shape::Sphere { centre, radius: 0.21 }, centre, false),
        (
            Shape::Cylinder { base: DVec3::new(0.5, 0.1, 0.5), axis: DVec3::Y, radius: 0.15, height: 0.6 },
            DVec3::new(0.5, 0.4, 0.5),
            false,
        ),
        (Shape::Mesh { file: file.into(), unit: 1.0 }, DVec3::new(0.5, 0.45, 0.55), false),
        (cuboid(0.15, 0.85), centre, true),
    ]
}

/// Largest difference between two fields.
fn difference(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).fold(0.0, |most, (a, b)| f64::max(most, (a - b).abs()))
}

#[test]
fn a_moved_obstacle_cuts_as_one_that_is_placed_there() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = Random(11);
    let mut scene = scene([17, 17, 17], &pool(0.5));
    let grid = scene.grid();
    let post = Shape::Sphere { centre: DVec3::new(0.8, 0.3, 0.4), radius: 0.12 };
    for (shape, centre, inside_out) in shapes(folder.path()) {
        for pose in 0..6 {
            let (translate, axis) = (vector(&mut random, -0.2, 0.2), vector(&mut random, -1.0, 1.0));
            // Straight and turned, about the middle and about a point aside.
            let angle = [0.0, 1.1][pose % 2];
            let pivot = (pose > 2).then(|| vector(&mut random, 0.2, 0.8));
            let body = |placement, motion| Obstacle { placement, inside_out, motion, ..still(shape.clone()) };
            let motion = moving(translate, axis, angle, pivot);
            scene.obstacles = vec![still(post.clone()), body(Placement::default(), Some(motion))];
            let mut moved = obstacle_cut(&scene, &grid).unwrap();
            moved.move_to(1.0, 0.1);
            let turn = DMat3::from_axis_angle(axis.normalize(), angle);
            let about = pivot.unwrap_or(centre);
            let placement = Placement {
                translate: about + turn * (centre - about) + translate - centre,
                rotate: turn,
                scale: 1.0,
                at: None,
            };
            scene.obstacles[1] = body(placement, None);
            let placed = obstacle_cut(&scene, &grid).unwrap();
            let name = format!("{shape:?}, pose {pose}");
            let distance = difference(&moved.cut.solid_distance, &placed.cut.solid_distance);
            // A ball and a cylinder are tessellated before they are turned, and so is what they cut.
            assert!(distance < 1e-12, "{name}: distances {distance:e}");
            for a in 0..3 {
                let open = difference(&moved.cut.open[a], &placed.cut.open[a]);
                assert!(open < 1e-9, "{name}: open fractions {open:e}");
            }
        }
    }
}

#[test]
fn where_it_was_before_leaves_no_trace() {
    let folder = tempfile::tempdir().unwrap();
    let mut scene = scene([13, 13, 13], &pool(0.5));
    let grid = scene.grid();
    let bodies = shapes(folder.path()).into_iter().enumerate();
    scene.obstacles = bodies
        .map(|(n, (shape, _, inside_out))| Obstacle {
            inside_out,
            motion: (n != 1).then(|| {
                let way = 0.3 * DVec3::new(n as f64 - 2.0, 1.0, 0.5);
                moving(way, DVec3::new(1.0, n as f64, 0.3), 2.0, None)
            }),
            ..still(shape)
        })
        .collect();
    let fields = |cut: &ObstacleCut| {
        let walls = cut.wall_velocities().to_vec();
        (cut.cut.open.clone(), cut.cut.solid_distance.clone(), cut.flux().to_vec(), walls)
    };
    let mut used = obstacle_cut(&scene, &grid).unwrap();
    for time in [0.7, 0.2, 1.5, 0.0, 0.9] {
        let mut fresh = obstacle_cut(&scene, &grid).unwrap();
        used.move_to(time, 0.01);
        fresh.move_to(time, 0.01);
        assert!(fields(&used) == fields(&fresh), "at {time} s");
    }
}

#[test]
fn what_obstacles_take_up_is_what_they_displace() {
    let folder = tempfile::tempdir().unwrap();
    let mut scene = scene([15, 15, 15], &pool(0.5));
    let grid = scene.grid();
    for (shape, _, inside_out) in shapes(folder.path()) {
        let motion = moving(DVec3::new(0.2, -0.1, 0.3), DVec3::new(1.0, -2.0, 0.5), 1.0, None);
        scene.obstacles = vec![Obstacle { inside_out, motion: Some(motion), ..still(shape.clone()) }];
        let mut cut = obstacle_cut(&scene, &grid).unwrap();
        cut.move_to(0.0, 0.02);
        let net: f64 = cut.flux().iter().map(|(_, flux)| flux).sum();
        let gross: f64 = cut.flux().iter().map(|(_, flux)| flux.abs()).sum();
        assert!(gross > 1e-3, "{shape:?} moves");
        // The container reaches nowhere beyond the walls, and no body does at the start.
        assert!(net.abs() < 1e-12 * gross, "{shape:?}: {net:e} of {gross:e}");
    }
    // A plunger of 0.3 m by 0.4 m through the lid, at 0.5 m/s.
    let plunger = Shape::Box { min: DVec3::new(0.22, 0.61, 0.33), max: DVec3::new(0.52, 2.0, 0.73) };
    scene.obstacles =
        vec![Obstacle { motion: Some(moving(DVec3::new(0.0, -0.5, 0.0), DVec3::Y, 0.0, None)), ..still(plunger) }];
    let mut cut = obstacle_cut(&scene, &grid).unwrap();
    for time in [0.0, 0.3] {
        cut.move_to(time, 0.05);
        let net: f64 = cut.flux().iter().map(|(_, flux)| flux).sum();
        assert!((net + 0.3 * 0.4 * 0.5).abs() < 1e-12, "{net} m^3/s at {time} s");
    }
    // After its last keyframe it stands.
    cut.move_to(1.0, 0.05);
    assert!(cut.flux().iter().all(|(_, flux)| *flux == 0.0));
}

fn start(scene: &Scene) -> Reference {
    let cut = obstacle_cut(scene, &scene.grid()).unwrap();
    let state = initial_state(scene, &scene.grid(), &cut.cut).unwrap();
    Reference::new(scene, cut, Solids::default(), state).unwrap()
}

fn step(reference: &mut Reference, dt: f64) -> StepReport {
    reference.step(TimeStep { dt, ..reference.next_time_step() }).unwrap()
}

/// Seen from a tank that moves evenly, water in it is at rest: its velocity is the tank's everywhere, but for rounding. No face is so nearly
/// closed or open that it would be clamped.
#[test]
fn water_in_a_tank_that_moves_evenly_moves_with_it() {
    let velocity = DVec3::new(0.375, 0.0, -0.25);
    let pool = pool(0.52).replace("[[liquid.region]]", "[[liquid.region]]\nvelocity = [0.375, 0.0, -0.25]");
    let tank = format!(
        "{pool}[[obstacle]]\nbox = {{ min = [0.21, 0.13, 0.33], max = [0.69, 0.93, 0.84] }}\ninside_out = true\n\
         keyframes = [{{ t = 0 }}, {{ t = 1, translate = [0.375, 0.0, -0.25] }}]\n"
    );
    let scene = scene([16, 16, 16], &tank);
    let grid = scene.grid();
    let mut reference = start(&scene);
    for number in 0..10 {
        let dt = 1.0 / 60.0;
        let report = step(&mut reference, dt);
        let liquid = report.liquid.unwrap();
        assert_eq!(liquid.solve.status, SolveStatus::Converged, "{report:?}");
        let state = reference.state();
        let open = &reference.cut_cells().open;
        let mut judged = 0;
        for axis in Axis::ALL {
            let a = axis.index();
            for (face, &u) in state.velocity[a].iter().enumerate() {
                let sides = grid.face_sides(axis, grid.face_at(axis, face));
                if open[a][face] > 0.0 && sides.into_iter().flatten().any(|cell| state.active[cell]) {
                    judged += 1;
                    let off = (u - velocity[a]).abs();
                    assert!(off < 1e-10 * GRAVITY * dt, "step {number}, {axis:?} face {face}: off by {off:e} m/s");
                }
            }
        }
        assert!(judged > 500, "{judged} faces");
    }
}

/// What a plunger displaces leaves through the surface, whose faces it leaves at least a tenth open: they keep their velocities.
#[test]
fn a_plunger_lifts_what_it_displaces() {
    let rate = 0.27 * 0.4 * 0.5;
    let plunger = format!(
        "{}[[obstacle]]\nbox = {{ min = [0.25, 0.31, 0.33], max = [0.52, 2.0, 0.73] }}\n\
         keyframes = [{{ t = 0 }}, {{ t = 1, translate = [0.0, -0.5, 0.0] }}]\n",
        pool(0.6)
    );
    let scene = scene([14, 14, 14], &plunger);
    let grid = scene.grid();
    let mut reference = start(&scene);
    for _ in 0..3 {
        let report = step(&mut reference, 0.02);
        let liquid = report.liquid.unwrap();
        assert_eq!(liquid.solve.status, SolveStatus::Converged);
        assert!(liquid.diagnosis.divergence < 1e-5, "{} 1/s", liquid.diagnosis.divergence);
        let (state, open) = (reference.state(), &reference.cut_cells().open);
        let area = grid.dx * grid.dx;
        let mut outflow = 0.0;
        for axis in Axis::ALL {
            let a = axis.index();
            for (face, &u) in state.velocity[a].iter().enumerate() {
                let sides = grid.face_sides(axis, grid.face_at(axis, face));
                if let [Some(minus), Some(plus)] = sides {
                    let out = f64::from(state.active[minus]) - f64::from(state.active[plus]);
                    outflow += out * area * open[a][face] * u;
                }
            }
        }
        assert!((outflow - rate).abs() < 1e-7 * rate, "{outflow} of {rate} m^3/s");
    }
}

/// A vessel full of water, of which a plunger takes room away.
pub(crate) fn squeezed_vessel() -> Scene {
    let full = pool(5.0);
    scene(
        [12, 12, 12],
        &format!(
            "{full}[[obstacle]]\nbox = {{ min = [0.22, 0.61, 0.33], max = [0.52, 2.0, 0.73] }}\n\
             keyframes = [{{ t = 0 }}, {{ t = 1, translate = [0.0, -0.5, 0.0] }}]\n"
        ),
    )
}

#[test]
fn a_vessel_that_shrinks_is_told() {
    let mut reference = start(&squeezed_vessel());
    let liquid = step(&mut reference, 0.02).liquid.unwrap();
    assert_eq!(liquid.closed_components, 1);
    assert_eq!(liquid.solve.status, SolveStatus::Incompatible);
}

/// Nothing is left where an obstacle stood at the start.
#[test]
fn a_solid_falls_past_where_an_obstacle_was() {
    let text = "[domain]\nsize = [1, 1, 1]\ncells = [8, 8, 8]\n[time]\nduration = 1\n\
                [[solid]]\nname = \"block\"\nmesh = { box = { size = [0.2, 0.2, 0.2], cells = [1, 1, 1] } }\n\
                placement = { translate = [0.5, 0.7, 0.5] }\ndensity = 1000\nyoung = 1e5\npoisson = 0.3\n";
    let obstacle = "[[obstacle]]\nbox = { min = [0, 0.3, 0], max = [1, 0.4, 1] }\nkeyframes = [{ t = 0 }, { t = 0.1, translate = [0, -0.3, 0] }]\n";
    let fallen = |text: &str| {
        let scene = Scene::parse("block.toml".as_ref(), text, &[], 1.0).unwrap();
        let mut simulation = Simulation::new(&scene, &Backend::Cpu).unwrap();
        while simulation.clock().frame < 7 {
            simulation.step().unwrap();
        }
        simulation.state().unwrap().displacement
    };
    let (past, free) = (fallen(&format!("{text}{obstacle}")), fallen(text));
    assert!(free[0][1] < -0.35, "{free:?}");
    for (past, free) in past.iter().flatten().zip(free.iter().flatten()) {
        assert!((past - free).abs() < 1e-3, "{past} {free}");
    }
}

#[test]
fn sub_steps_are_short_enough_for_a_fast_obstacle() {
    let text = |end: f64| {
        format!(
            "{}[[obstacle]]\nsphere = {{ centre = [0.3, 0.3, 0.5], radius = 0.1 }}\n\
             keyframes = [{{ t = {} }}, {{ t = {end}, translate = [0.4, 0, 0] }}]\n",
            pool(0.6),
            end - 0.01
        )
    };
    // 40 m/s in the first frame; only in a later one.
    let soon = start(&scene([16, 16, 16], &text(0.02)));
    let dt = soon.next_time_step().dt;
    assert!(dt <= 3.0 / 16.0 / 40.0, "{dt} s");
    let late = start(&scene([16, 16, 16], &text(0.8)));
    assert!(late.next_time_step().dt > 0.02);
}

#[test]
fn bad_motions_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.toml");
    let refused = |lines: &str| {
        let text = format!(
            "[domain]\nsize = [1, 1, 1]\ncells = [8, 8, 8]\n[time]\nduration = 1.0\n[liquid]\n{}[[obstacle]]\n{lines}\n",
            pool(0.5)
        );
        fs::write(&path, text).unwrap();
        Scene::load(&path, &[], 1.0).unwrap_err().to_string()
    };
    let ball = "sphere = { centre = [0.5, 0.5, 0.5], radius = 0.1 }";
    for (lines, parts) in [
        (format!("{ball}\npivot = [0, 0, 0]"), ["bad.toml:12", "obstacle[0].pivot", "add keyframes"]),
        (
            format!("{ball}\nkeyframes = [{{ t = 0 }}, {{ t = 1e-9, translate = [1, 0, 0] }}]"),
            ["bad.toml:12", "obstacle[0].keyframes[1]", "m/s"],
        ),
        (
            format!("{ball}\nkeyframes = [{{ t = 1 }}, {{ t = 0.5 }}]"),
            ["bad.toml:12", "obstacle[0].keyframes[1].t", "ascending order of time"],
        ),
        (format!("{ball}\nkeyframes = []"), ["bad.toml:12", "obstacle[0].keyframes", "no entry"]),
        (
            "sphere = { centre = [5, 5, 5], radius = 0.1 }\nkeyframes = [{ t = 0 }, { t = 1, translate = [1, 0, 0] }]"
                .into(),
            ["bad.toml:11", "obstacle[0].sphere", "outside the domain"],
        ),
    ] {
        let message = refused(&lines);
        for part in parts {
            assert!(message.contains(part), "`{part}` is not in: {message}");
        }
    }
    // It comes in later.
    let text = "sphere = { centre = [5, 0.5, 0.5], radius = 0.1 }\nkeyframes = [{ t = 0 }, { t = 1, translate = [-4.5, 0, 0] }]";
    let text = format!(
        "[domain]\nsize = [1, 1, 1]\ncells = [8, 8, 8]\n[time]\nduration = 1.0\n[liquid]\n{}[[obstacle]]\n{text}\n",
        pool(0.5)
    );
    fs::write(&path, text).unwrap();
    let scene = Scene::load(&path, &[], 1.0).unwrap();
    let grid = Grid { ..scene.grid() };
    assert!(obstacle_cut(&scene, &grid).unwrap().flux().is_empty());
}
