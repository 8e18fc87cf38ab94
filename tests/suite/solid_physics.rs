//! Solids of the f64 path against what is known of elasticity and of backward Euler (validation S2 to S13).

use std::path::Path;

use cutwater::geometry::obstacle_cut;
use cutwater::gpu::Gpu;
use cutwater::grid::Grid;
use cutwater::reference::{Reference, TimeStep};
use cutwater::scene::{ElasticModel, Keyframe, Motion, Obstacle, Pin, Placement, Scene, Shape, Solid, SolidMesh};
use cutwater::sim::{Backend, Options, Simulation};
use cutwater::state::{ContactReport, SolidReport, SolveStatus, State};
use glam::{DMat3, DQuat, DVec3};

use crate::common::{adapter, gpu};
use crate::solid_cases::{
    THROWS, TIMOSHENKO, backward_euler, bar_on_rollers, cantilever, cantilever_table, flying_block, held, hung_beam,
    inverted, lame_cube, lame_shape, region, thrown_about, tip, worst_of_nodal_table,
};
use crate::solid_modes::{Dynamics, ringing};
use crate::solid_scene::{alone, block, body, scene_of, solids_of};

/// S2: scikit-fem and CalculiX, all nodes.
#[test]
fn the_cantilever_bends_as_in_other_programs() {
    for (model, tolerance) in [(ElasticModel::Corotational, 1e-4), (ElasticModel::Linear, 1e-8)] {
        let mut solid = cantilever([10, 2, 2]);
        solid.model = model;
        let solids = alone(solid);
        let u = Dynamics::new(&solids).static_displacement();
        let error = worst_of_nodal_table(&solids, &u);
        assert!(error <= tolerance, "{model:?}: off by {error:e} of the tip");
    }
}

/// S3: lumped masses, scikit-fem.
#[test]
fn the_cantilever_rings_as_in_other_programs() {
    let row = &cantilever_table()[1];
    assert_eq!(row.cells, [10, 2, 2]);
    let solids = alone(cantilever(row.cells));
    let modes = Dynamics::new(&solids).modes(5, 300);
    for ((_, square), table) in modes.iter().zip(row.frequencies) {
        let found = square.sqrt() / std::f64::consts::TAU;
        assert!((found - table).abs() <= 1e-7 * table, "{found} Hz, table {table} Hz");
    }
}

/// S4: the stiffness of the mesh converges to that of Timoshenko's beam about with h^2 (linear tetrahedra are too stiff in bending: 2 and 4
/// layers give 0.35 and 0.67 of its deflection). Eight layers are in the validation.
#[test]
fn the_cantilever_converges_to_beam_theory() {
    let excess = [1, 2].map(|refinements| {
        let row = &cantilever_table()[refinements];
        let solids = alone(cantilever(row.cells));
        let found = tip(&solids, &Dynamics::new(&solids).static_displacement());
        assert!((found - row.tip).abs() < 1e-4 * row.tip.abs(), "{found} m, table {} m", row.tip);
        TIMOSHENKO / found - 1.0
    });
    let rate = (excess[0] / excess[1]).log2();
    assert!(rate >= 1.6, "rate {rate} of the excess {excess:?}");
}

/// S3 and S11 in motion: a mode of the cantilever, started by itself, has in every step the angle and the decay of backward Euler, with
/// and without Rayleigh damping: atan(w dt) and 1/sqrt(1 + w^2 dt^2) without.
#[test]
fn modes_ring_and_decay_as_backward_euler_does() {
    for (damping, w_dt) in [([0.0, 0.0], 0.1), ([0.0, 0.0], 1.0), ([0.7, 0.0], 0.2), ([0.3, 0.02], 0.4)] {
        let mut solid = cantilever([10, 2, 2]);
        solid.loads.clear();
        [solid.mass_damping, solid.stiffness_damping] = damping;
        let solids = alone(solid);
        let dynamics = Dynamics::new(&solids);
        let modes = dynamics.modes(3, 400);
        for (shape, square) in [&modes[0], &modes[2]] {
            let w = square.sqrt();
            let dt = w_dt / w;
            let [decay, angle] = backward_euler(w, dt, damping);
            if damping == [0.0, 0.0] {
                assert!((angle - w_dt.atan()).abs() < 1e-12);
            }
            // So small that nothing turns.
            let found = ringing(&dynamics.ring(shape, 1e-7, dt, 12));
            assert!((found[0] - decay).abs() <= 1e-5 * decay, "{damping:?}: {found:?}, exactly {decay}");
            assert!((found[1] - angle).abs() <= 1e-5 * angle, "{damping:?}: {found:?}, exactly {angle}");
        }
    }
}

/// S9 on coarse meshes: 3.1 % and 1.4 % at 4^3 and 8^3. The validation asks for 1 % at 16^3, where it is 0.4 %.
#[test]
fn the_lame_mode_of_a_free_cube_converges() {
    let errors = [4, 8].map(|cells| {
        let (solid, exact) = lame_cube(cells);
        let solids = alone(solid);
        let mut dynamics = Dynamics::new(&solids);
        dynamics.iterative = true;
        let dt = 0.1 / exact;
        let [_, angle] = ringing(&dynamics.ring(&lame_shape(&solids), 1e-6, dt, 40));
        (angle.tan() / dt / exact - 1.0).abs()
    });
    assert!(errors[1] < 0.015 && errors[0] / errors[1] > 2.0, "{errors:?}");
}

/// S10.
#[test]
fn a_bar_on_rollers_has_the_frequency_of_a_bar() {
    let (solid, exact) = bar_on_rollers();
    let solids = alone(solid);
    let found = Dynamics::new(&solids).modes(1, 60)[0].1.sqrt();
    assert!((found / exact - 1.0).abs() < 0.005, "{found} 1/s, exactly {exact} 1/s");
}

fn start(scene: &Scene) -> Reference {
    let grid = scene.grid();
    let cut = obstacle_cut(scene, &grid).unwrap();
    let solids = solids_of(scene);
    let (displacement, node_velocity) = solids.initial_state(scene);
    let state = State { displacement, node_velocity, ..State::default() };
    Reference::new(scene, cut, solids, state).unwrap()
}

fn step(reference: &mut Reference, dt: f64) -> SolidReport {
    let report = reference.step(TimeStep { dt, ..reference.next_time_step() }).unwrap();
    let solid = report.solid.unwrap();
    assert!(report.liquid.is_none());
    assert_eq!(solid.solve.status, SolveStatus::Converged, "{report:?}");
    solid
}

/// S13: momentum grows by m g exactly, whatever the body does; a body at rest falls without strain.
#[test]
fn bodies_fall_with_g() {
    let (mass, dt, gravity) = (125.0, 1.0 / 240.0, DVec3::new(0.3, -9.81, 0.0));
    for strained in [false, true] {
        let mut scene = flying_block(strained);
        scene.domain.gravity = gravity;
        let drift = scene.solids[0].initial.velocity;
        let mut reference = start(&scene);
        for number in 1..=60 {
            let report = step(&mut reference, dt);
            let exact = mass * (drift + f64::from(number) * dt * gravity);
            let error = DVec3::from(report.diagnosis.momentum).distance(exact);
            assert!(error <= 1e-9 * mass * 9.81, "step {number}: off by {error:e} kg m/s");
            assert!(strained == (report.diagnosis.elastic_energy > 1e-9), "{report:?}");
            assert_eq!(report.diagnosis.inverted, 0);
        }
    }
}

/// The beam of the base scene with its nodes thrown about, so that 35 to 152 of its 336 elements are inverted.
#[test]
fn inverted_elements_recover() {
    for throw in THROWS {
        let scene = hung_beam();
        let (displacement, before) = thrown_about(&scene, throw);
        assert!((35..=152).contains(&before), "{before} inverted");
        let solids = solids_of(&scene);
        let state = State { node_velocity: vec![[0.0; 3]; displacement.len()], displacement, ..State::default() };
        let cut = obstacle_cut(&scene, &scene.grid()).unwrap();
        let mut reference = Reference::new(&scene, cut, solids.clone(), state).unwrap();
        let mut last = 0;
        for _ in 0..240 {
            last = step(&mut reference, 1.0 / 120.0).diagnosis.inverted;
        }
        let u = &reference.state().displacement;
        assert_eq!((last, inverted(&solids, u)), (0, 0), "of {before}");
        let elements = 0..solids.elements.len();
        let determinants = elements.map(|element| solids.stress_and_determinant(element, u)[1]);
        let worst = determinants.fold(f64::INFINITY, f64::min);
        assert!(worst > 0.9, "det F {worst} is left of {before} inverted");
    }
}

/// A cube squashed to an eighth of its volume, and one turned inside out, come back to their size.
#[test]
fn squashed_and_mirrored_cubes_recover() {
    for scale in [DVec3::splat(0.5), DVec3::new(1.0, -1.0, 1.0), DVec3::splat(-1.0)] {
        let mut solid = block([0.5; 3], [4, 4, 4]);
        solid.placement.translate = DVec3::splat(2.0);
        solid.initial.scale = scale;
        solid.mass_damping = 2.0;
        let mut reference = start(&scene_of(vec![solid]));
        let mut report = None;
        for _ in 0..400 {
            report = Some(step(&mut reference, 1.0 / 240.0));
        }
        let diagnosis = report.unwrap().diagnosis;
        assert_eq!(diagnosis.inverted, 0, "{scale}: {diagnosis:?}");
        assert!(diagnosis.min_det > 0.9, "{scale}: {diagnosis:?}");
        let momentum = DVec3::from(diagnosis.momentum).length();
        assert!(momentum < 1e-6, "{scale}: {momentum} kg m/s");
    }
}

/// A block on the floor sinks by its weight, rho g h^2 / (3 E) in the mean of a bar, whatever the sub-step; a floor that stops nodes after
/// the solve presses the lowest layer by (M/m) g dt^2 more, 36 mm at 1/24 s.
#[test]
fn bodies_stand_as_stiff_as_they_are_whatever_the_sub_step() {
    for young in [1e5, 1e7, 1e9] {
        for dt in [1.0 / 24.0, 1.0 / 240.0] {
            let mut solid = block([0.2; 3], [4, 4, 4]);
            solid.placement.translate = DVec3::new(2.0, 0.1, 2.0);
            (solid.young, solid.mass_damping) = (young, 10.0);
            let mut scene = scene_of(vec![solid]);
            scene.domain.gravity = DVec3::new(0.0, -9.81, 0.0);
            let mut reference = start(&scene);
            while reference.state().time < 0.8 {
                let report = step(&mut reference, dt);
                assert!(report.diagnosis.min_det > 0.9, "E {young:e}, dt {dt}");
            }
            let (solids, state) = (solids_of(&scene), reference.state());
            let weighted = solids.mass.iter().zip(&state.displacement);
            let sunk = -weighted.map(|(mass, u)| mass * u[1]).sum::<f64>() / 8.0;
            let weight = 1000.0 * 9.81 * 0.2 * 0.2 / (3.0 * young);
            let off = sunk / weight - 1.0;
            // Four layers are 4 % too stiff.
            assert!(off.abs() < 0.06, "E {young:e}, dt {dt}: sunk by {sunk} m, {off}");
        }
    }
}

/// A ball falls on the floor, soft and hard, in long steps and short ones: nothing is beyond the floor, nothing turns inside out, and
/// there is never more energy than it had, but for what the first-order fall adds, g dt v / 2 per mass.
#[test]
fn impacts_add_no_energy() {
    for young in [1e5, 1e9] {
        for dt in [1.0 / 48.0, 1.0 / 480.0] {
            let (radius, cell_size) = (0.15, 0.05);
            let mut solid = body(SolidMesh::Sphere { radius, cell_size });
            solid.placement.translate = DVec3::new(2.0, 0.45, 2.0);
            solid.young = young;
            let mut scene = scene_of(vec![solid]);
            scene.domain.gravity = DVec3::new(0.0, -9.81, 0.0);
            let mut reference = start(&scene);
            let solids = solids_of(&scene);
            let mass: f64 = solids.mass.iter().sum();
            let near = 1.01e-4 * scene.grid().dx;
            let (mut first, mut height) = (None, f64::INFINITY);
            while reference.state().time < 0.6 {
                let SolidReport { diagnosis, .. } = step(&mut reference, dt);
                let state = reference.state();
                let energy = diagnosis.kinetic_energy + diagnosis.elastic_energy + diagnosis.potential_energy;
                let start = *first.get_or_insert(energy);
                let added = 0.5 * mass * 9.81 * 9.81 * dt * state.time;
                let what = format!("E {young:e}, dt {dt}, {} s", state.time);
                assert!(energy <= start + added, "{what}: {energy} J of {start} J");
                assert!(diagnosis.min_det > 0.5, "{what}: {diagnosis:?}");
                let pairs = state.displacement.iter().zip(&state.node_velocity);
                for (rest, (u, v)) in solids.rest.iter().zip(pairs) {
                    height = height.min(rest.y + u[1]);
                    let next = rest.y + u[1] + dt * v[1];
                    assert!(next >= -near, "{what}: a node goes to {next} m");
                }
            }
            assert!(height < 1e-6, "it falls as far as the floor");
        }
    }
}

/// A stiff block is thrown at the floor, a wall, or an obstacle, or a moving obstacle comes up to it, with a first sub-step that takes it there, or most of
/// the way, or a third: no sub-step, however much longer than the last, takes it through by more than a thousandth of a cell, and both
/// backends take the same ones.
#[test]
fn longer_sub_steps_take_no_body_through_a_surface() {
    let mut throws = Vec::new();
    for (speed, gap, obstacle) in [(-2.0, 0.02, ""), (2.0, 0.02, ""), (-2.0, 0.02, "rest"), (0.0, 0.02, "moves")] {
        let mut solid = block([0.4; 3], [2; 3]);
        solid.young = 1e8;
        solid.initial.velocity.y = speed;
        let floor = if obstacle.is_empty() { 0.0 } else { 1.0 };
        let height = if speed > 0.0 { 3.8 - gap } else { floor + 0.2 + gap };
        solid.placement.translate = DVec3::new(2.0, height, 2.0);
        let mut scene = scene_of(vec![solid]);
        scene.domain.cells = [40; 3];
        if !obstacle.is_empty() {
            let key = |time: f64| Keyframe { time, translate: 2.0 * time * DVec3::Y, axis: DVec3::Y, angle: 0.0 };
            let motion = Motion { keyframes: vec![key(0.0), key(1.0)], pivot: None };
            scene.obstacles = vec![Obstacle {
                shape: Shape::Box { min: DVec3::new(-1.0, -1.0, -1.0), max: DVec3::new(5.0, 1.0, 5.0) },
                placement: Placement::default(),
                inside_out: false,
                motion: (obstacle == "moves").then_some(motion),
                friction: 0.0,
            }];
        }
        throws.push((scene, (speed, obstacle)));
    }
    let device = gpu().map(|_| Backend::Gpu(adapter()));
    for ((scene, what), share) in throws.iter().flat_map(|throw| [1.0, 0.7, 0.3].map(|share| (throw, share))) {
        let mut steps = Vec::new();
        for backend in [Some(Backend::Cpu), device.clone()].into_iter().flatten() {
            let mut simulation = Simulation::new(scene, &backend).unwrap();
            let solids = simulation.solids().clone();
            let mut state = simulation.state().unwrap();
            assert!((state.contact_step - 0.01005).abs() < 1e-6, "{what:?}: {} s", state.contact_step);
            state.contact_step *= share;
            let carried = simulation.carried().unwrap();
            simulation.resume(&state, &carried).unwrap();
            let mut taken = Vec::new();
            for _ in 0..12 {
                let contact = simulation.step().unwrap().solid.unwrap().contact;
                let state = simulation.state().unwrap();
                taken.push((state.dt_last, contact.closing_rate));
                let floor = match what.1 {
                    "" => 0.0,
                    "rest" => 1.0,
                    _ => 1.0 + 2.0 * state.time,
                };
                let nodes = solids.rest.iter().zip(&state.displacement);
                for (rest, u) in nodes {
                    let y = rest.y + u[1];
                    let through = (floor - y).max(y - 4.0);
                    assert!(
                        through <= 1.1e-3 * scene.grid().dx,
                        "{what:?}, {share}, {backend:?}: {through} m at {} s",
                        state.time
                    );
                }
            }
            steps.push(taken);
        }
        for (a, b) in steps[0].iter().zip(steps.last().unwrap()) {
            assert!((a.0 - b.0).abs() <= 1e-3 * a.0, "{what:?}, {share}: {steps:?}");
        }
    }
}

/// On a slope without friction a block slides with g sin(angle), and stays on it.
#[test]
fn bodies_slide_down_a_slope() {
    let angle: f64 = 0.35;
    let turn = DMat3::from_rotation_z(angle);
    let [along, normal] = [DVec3::X, DVec3::Y].map(|axis| turn * axis);
    for (young, dt) in [(1e5, 1.0 / 120.0), (1e9, 1.0 / 24.0)] {
        let mut solid = block([0.4, 0.2, 0.4], [4, 2, 4]);
        let foot = DVec3::splat(2.0);
        solid.placement.translate = foot + 0.1 * normal;
        solid.placement.rotate = turn;
        solid.young = young;
        let mut scene = scene_of(vec![solid]);
        scene.domain.cells = [24; 3];
        scene.domain.gravity = DVec3::new(0.0, -9.81, 0.0);
        scene.obstacles = vec![Obstacle {
            shape: Shape::Box { min: DVec3::splat(-8.0), max: DVec3::splat(8.0) },
            placement: Placement { translate: foot - 8.0 * normal, rotate: turn, ..Placement::default() },
            inside_out: false,
            motion: None,
            friction: 0.0,
        }];
        let mut reference = start(&scene);
        let solids = solids_of(&scene);
        let mut n = 0.0;
        while reference.state().time < 0.4 {
            step(&mut reference, dt);
            n += 1.0;
        }
        let state = reference.state();
        let mean = solids.mass.iter().zip(&state.displacement);
        let mean = mean.map(|(m, u)| *m * DVec3::from(*u)).sum::<DVec3>() / solids.mass.iter().sum::<f64>();
        // Velocities after a step move the next one.
        let way = -9.81 * angle.sin() * dt * dt * 0.5 * n * (n - 1.0);
        let off = mean.dot(along) / way - 1.0;
        assert!(off.abs() < 0.01, "{} m of {way} m", mean.dot(along));
        assert!(mean.dot(DVec3::Z).abs() < 1e-3 * way.abs());
        for (rest, u) in solids.rest.iter().zip(&state.displacement) {
            let above = normal.dot(*rest + DVec3::from(*u) - foot);
            assert!(above > -1e-3 * scene.grid().dx, "{above} m above the slope");
        }
    }
}

/// A body dropped on the floor stays above it and comes to rest.
#[test]
fn bodies_rest_on_the_floor() {
    let mut solid = block([0.5; 3], [3, 3, 3]);
    solid.placement.translate = DVec3::new(2.0, 0.4, 2.0);
    solid.mass_damping = 5.0;
    let mut scene = scene_of(vec![solid]);
    scene.domain.gravity = DVec3::new(0.0, -9.81, 0.0);
    let mut reference = start(&scene);
    let solids = solids_of(&scene);
    for _ in 0..720 {
        step(&mut reference, 1.0 / 240.0);
        let state = reference.state();
        let nodes = solids.rest.iter().zip(&state.displacement);
        let lowest = nodes.map(|(rest, u)| rest.y + u[1]).fold(f64::INFINITY, f64::min);
        assert!(lowest >= -1e-15, "a node is {lowest} m below the floor");
    }
    let report = step(&mut reference, 1.0 / 240.0);
    let speed = report.diagnosis.max_speed;
    assert!(speed < 1e-5 * 240.0, "still moves at {speed} m/s");
    assert!(report.diagnosis.min_det > 0.9, "{report:?}");
}

#[test]
fn bodies_that_start_outside_or_in_an_obstacle_are_refused() {
    let refused = |solid: Solid, obstacles: Vec<Obstacle>| {
        let mut scene = scene_of(vec![solid]);
        scene.obstacles = obstacles;
        Simulation::new(&scene, &Backend::Cpu).unwrap_err().to_string()
    };
    let mut outside = block([0.4; 3], [2, 2, 2]);
    outside.placement.translate = DVec3::new(3.9, 2.0, 2.0);
    let text = refused(outside, Vec::new());
    assert!(
        text.contains("solid[0]") && text.contains("outside the domain") && text.contains("placement.at"),
        "{text}"
    );
    let stone = Obstacle {
        shape: region([1.0; 3], [3.0; 3]),
        placement: Placement::default(),
        inside_out: false,
        motion: None,
        friction: 0.0,
    };
    let inside = |y: f64| {
        let mut solid = block([0.4; 3], [2, 2, 2]);
        solid.placement.translate = DVec3::new(2.0, y, 2.0);
        solid
    };
    let text = refused(inside(2.3), vec![stone.clone()]);
    assert!(text.contains("solid[0]") && text.contains("deep in obstacle[0]") && text.contains("solid.pin"), "{text}");
    // On it, it may start; and in it where it is held.
    let mut held_inside = inside(2.3);
    held_inside.pins = vec![held(region([0.0; 3], [4.0; 3]), [true; 3])];
    for solid in [inside(3.2), held_inside] {
        let mut scene = scene_of(vec![solid]);
        scene.obstacles = vec![stone.clone()];
        Simulation::new(&scene, &Backend::Cpu).unwrap();
    }
}

/// A soft block forced into a slot narrower than itself, whose sides end just above the floor: where their ends and the floor hold the
/// same nodes, the search for what holds the block goes in circles, and ends all the same.
#[test]
fn the_search_for_contacts_comes_to_its_end() {
    let mut solid = block([0.2; 3], [4, 4, 4]);
    solid.placement.translate = DVec3::new(0.5, 0.52, 0.5);
    solid.initial.velocity = DVec3::new(0.0, -2.0, 0.0);
    (solid.young, solid.poisson) = (1e4, 0.3);
    let mut scene = scene_of(vec![solid]);
    scene.domain.size = DVec3::ONE;
    scene.domain.cells = [32; 3];
    scene.domain.gravity = DVec3::new(0.0, -9.81, 0.0);
    let post = |low: f64, high: f64| Obstacle {
        shape: region([low, 0.01, 0.0], [high, 0.4, 1.0]),
        placement: Placement::default(),
        inside_out: false,
        motion: None,
        friction: 0.0,
    };
    scene.obstacles = vec![post(0.0, 0.41), post(0.59, 1.0)];
    let mut reference = start(&scene);
    let mut most = 0;
    for number in 1..=60 {
        let contact = step(&mut reference, 1.0 / 240.0).contact;
        assert_eq!(contact.unsettled, 0, "step {number}: {contact:?}");
        most = contact.solves.max(most);
    }
    assert!(most > 2, "{most} solves at most");
}

/// A stiff dinosaur that lands on the edge of a step, with sub-steps in which it falls a seventh of its length: what holds it is found in every
/// one of them, and none gives it energy worth telling of its fall's.
#[test]
fn stiff_bodies_are_not_thrown() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/dinosaur_step.toml");
    let stiff = ["solid[0].young=1e9", "solid[0].damping.mass=0"].map(str::to_owned);
    let scene = Scene::load(&file, &stiff, 1.0).unwrap();
    let mut reference = start(&scene);
    let (mut at_first, mut least, mut most) = (None, f64::INFINITY, 0);
    for number in 1..=48 {
        let SolidReport { contact, diagnosis, .. } = step(&mut reference, 1.0 / 48.0);
        assert_eq!(contact.unsettled, 0, "step {number}: {contact:?}");
        most = contact.solves.max(most);
        let at_first = *at_first.get_or_insert(diagnosis.potential_energy);
        let energy = diagnosis.kinetic_energy + diagnosis.elastic_energy + diagnosis.potential_energy;
        assert!(energy - least <= 0.1 * at_first, "step {number}: {least} to {energy} J, {at_first} J at the start");
        assert!(diagnosis.min_det > 0.9, "step {number}: {diagnosis:?}");
        least = f64::min(least, energy);
    }
    assert!(most > 3, "{most} solves at most");
}

/// A stiff beam that is held inside one obstacle, as far in as its nodes never may be, strikes another with its free end: what lies in the
/// first stops no search for what the second holds.
#[test]
fn nodes_held_in_an_obstacle_stop_no_search() {
    let mut solid = block([1.0, 0.2, 0.2], [10, 2, 2]);
    solid.placement.translate = DVec3::splat(2.0);
    (solid.young, solid.poisson) = (1e8, 0.3);
    solid.initial.velocity = DVec3::new(0.0, -2.0, 0.0);
    let inside = region([0.0; 3], [1.61, 4.0, 4.0]);
    solid.pins = vec![held(inside, [true; 3])];
    let mut scene = scene_of(vec![solid]);
    scene.domain.cells = [40; 3];
    scene.domain.gravity = DVec3::new(0.0, -9.81, 0.0);
    let stone = |low: [f64; 3], high: [f64; 3]| Obstacle {
        shape: region(low, high),
        placement: Placement::default(),
        inside_out: false,
        motion: None,
        friction: 0.0,
    };
    scene.obstacles = vec![stone([1.0, 1.5, 1.5], [1.65, 2.5, 2.5]), stone([2.3, 1.0, 1.5], [2.7, 1.895, 2.5])];
    let mut reference = start(&scene);
    let mut several = 0;
    for number in 1..=48 {
        let contact = step(&mut reference, 1.0 / 96.0).contact;
        assert_eq!(contact.unsettled, 0, "step {number}: {contact:?}");
        several += u32::from(contact.solves > 1);
    }
    assert!(several > 0, "no step of more than one solve");
}

/// A light, stiff block that strikes the floor with a corner. On the f64 path solves end at their rounding, far from the tolerance, and lead
/// the search for what holds it to its end all the same. On the device a search allocates nothing, and a solve that is cut short ends it.
#[test]
fn a_search_goes_on_from_solves_that_end_at_their_rounding() {
    let mut solid = block([0.3, 0.2, 0.2], [3, 2, 2]);
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7);
    solid.placement.rotate = DMat3::from_quat(turn);
    solid.placement.translate = DVec3::new(0.5, 0.4, 0.5);
    solid.initial.velocity = DVec3::new(0.0, -1.0, 0.0);
    (solid.density, solid.young, solid.poisson) = (10.0, 1e10, 0.4);
    let mut scene = scene_of(vec![solid]);
    scene.domain.size = DVec3::ONE;
    scene.domain.cells = [16; 3];
    scene.domain.gravity = DVec3::new(0.0, -9.81, 0.0);
    scene.time.fixed_step = Some(1.0 / 24.0);
    scene.solver.tolerance = 1e-14;
    let run = |scene: &Scene, backend: &Backend| -> Vec<SolidReport> {
        let mut simulation = Simulation::new(scene, backend).unwrap();
        let allocated = |simulation: &Simulation| simulation.gpu().map(Gpu::allocated);
        let before = allocated(&simulation);
        let reports = (0..5).map(|_| simulation.step().unwrap().solid.unwrap());
        let reports = reports.collect();
        assert_eq!(allocated(&simulation), before, "a search allocates");
        reports
    };
    let assert_settled = |backend: &Backend, reports: &[SolidReport]| {
        let contacts: Vec<ContactReport> = reports.iter().map(|report| report.contact).collect();
        let settled = contacts.iter().all(|contact| contact.unsettled == 0);
        let searched = contacts.iter().any(|contact| contact.solves > 1);
        assert!(settled && searched, "{backend:?}: {contacts:?}");
    };

    let reports = run(&scene, &Backend::Cpu);
    assert_settled(&Backend::Cpu, &reports);
    // The last before it touches: the next begins with a solve of the same system.
    let falls = reports.iter().take_while(|report| report.contact.solves == 1);
    let status = falls.last().unwrap().solve.status;
    assert_eq!(status, SolveStatus::Stagnated, "{reports:?}");

    let Some(_) = gpu() else { return };
    let backend = Backend::Gpu(adapter());
    assert_settled(&backend, &run(&scene, &backend));
    scene.solver.max_iterations = 1;
    let reports = run(&scene, &backend);
    let cut_short = |report: &SolidReport| report.solve.status == SolveStatus::IterationLimit;
    let searched_on = |report: &SolidReport| report.contact.solves > 2;
    assert!(reports.iter().any(cut_short) && !reports.iter().any(searched_on), "{reports:?}");
}

/// A beam twisted and stretched by a script: the scripted end lands on its keyframes, the other end is held.
#[test]
fn a_scripted_end_takes_the_beam_along() {
    let mut solid = block([1.0, 0.2, 0.2], [6, 2, 2]);
    solid.placement.translate = DVec3::splat(2.0);
    let frame = |time, x: f64, angle| Keyframe { time, translate: DVec3::new(x, 0.0, 0.0), axis: DVec3::X, angle };
    let end = region([2.5, 1.9, 1.9], [2.5, 2.1, 2.1]);
    solid.pins = vec![
        held(region([1.5, 0.0, 0.0], [1.5, 4.0, 4.0]), [true; 3]),
        Pin {
            region: end,
            components: [true; 3],
            keyframes: vec![frame(0.0, 0.0, 0.0), frame(0.25, 0.2, 1.5)],
            pivot: None,
        },
    ];
    solid.mass_damping = 5.0;
    let scene = scene_of(vec![solid]);
    let mut reference = start(&scene);
    let solids = solids_of(&scene);
    let script = &solids.scripts[0];
    let dt = 1.0 / 96.0;
    for number in 1..=96 {
        let report = step(&mut reference, dt);
        assert_eq!(report.diagnosis.inverted, 0);
        let state = reference.state();
        for &node in &script.nodes {
            let node = node as usize;
            let exact = script.displacement(solids.rest[node], state.time);
            let error = DVec3::from(state.displacement[node]).distance(exact);
            assert!(error <= 1e-13, "step {number}: off by {error:e} m");
        }
    }
    let middle: Vec<usize> = (0..solids.rest.len()).filter(|&node| (solids.rest[node].x - 2.0).abs() < 1e-9).collect();
    for node in middle {
        // Half the stretch and half the turn, about.
        let u = DVec3::from(reference.state().displacement[node]);
        assert!((u.x - 0.1).abs() < 0.03, "{u}");
        let arm = DVec3::new(0.0, solids.rest[node].y - 2.0, solids.rest[node].z - 2.0);
        let turned = DQuat::from_axis_angle(DVec3::X, 0.75) * arm;
        assert!((arm + u).with_x(0.0).distance(turned) < 0.03, "{arm} {u}");
    }
}

/// Keyframes that come sooner than the end of the first sub-step, to which a tangent would lead past them.
#[test]
fn a_script_may_be_faster_than_the_first_step() {
    let mut solid = block([0.4; 3], [2, 2, 2]);
    solid.placement.translate = DVec3::splat(2.0);
    let frame = |time, x: f64| Keyframe { time, translate: DVec3::new(x, 0.0, 0.0), axis: DVec3::X, angle: 0.0 };
    solid.pins = vec![Pin {
        region: region([1.8, 1.8, 1.8], [1.8, 2.2, 2.2]),
        components: [true, false, true],
        keyframes: vec![frame(0.0, 0.0), frame(0.002, 0.02), frame(0.1, 0.03)],
        pivot: None,
    }];
    let mut scene = scene_of(vec![solid]);
    let dt = 1.0 / 96.0;
    scene.time.fixed_step = Some(dt);
    let solids = solids_of(&scene);
    let script = &solids.scripts[0];
    let mut backends = vec![(Backend::Cpu, 1e-13)];
    if gpu().is_some() {
        // Velocities of prescribed components are f32.
        backends.push((Backend::Gpu(adapter()), 1e-8));
    }
    for (backend, bound) in backends {
        let mut simulation = Simulation::new(&scene, &backend).unwrap();
        for number in 1..=12 {
            simulation.step().unwrap();
            let state = simulation.state().unwrap();
            for &node in &script.nodes {
                let exact = script.displacement(solids.rest[node as usize], state.time);
                let u = DVec3::from(state.displacement[node as usize]);
                let error = (u - exact).with_y(0.0).length();
                assert!(error <= bound, "{backend:?}, step {number}: off by {error:e} m");
            }
        }
    }
}

/// A bar that nothing holds and that turns by a quarter of a radian in a sub-step neither gains energy nor swells, also where it tumbles
/// and where it is stiff; what a soft one stretches by as it spins is what short sub-steps find. Along tangents the stiff bar comes to four
/// times its energy and the soft one to thirty times its stretch.
#[test]
fn bars_spin_in_long_sub_steps() {
    // The most energy of all, and the elastic one at the end, over the energy of the start.
    let run = |young: f64, damping: f64, spin: DVec3, frames: f64| {
        let mut bar = block([0.6, 0.1, 0.1], [12, 2, 2]);
        bar.placement.translate = DVec3::splat(1.0);
        (bar.young, bar.poisson, bar.stiffness_damping) = (young, 0.3, damping);
        bar.initial.spin = spin;
        let mut scene = scene_of(vec![bar]);
        scene.domain.gravity = DVec3::ZERO;
        (scene.time.duration, scene.time.frames_per_second) = (1.0, frames);
        let mut reference = start(&scene);
        let solids = solids_of(&scene);
        let at_start = reference.state().node_velocity.iter().zip(&solids.mass);
        let energy: f64 = at_start.map(|(v, mass)| 0.5 * mass * DVec3::from(*v).length_squared()).sum();
        let (mut most, mut elastic) = (0.0, 0.0);
        for _ in 0..frames as usize {
            let report = reference.step(reference.next_time_step()).unwrap();
            let it = report.solid.unwrap().diagnosis;
            most = f64::max(most, (it.kinetic_energy + it.elastic_energy) / energy);
            elastic = it.elastic_energy / energy;
        }
        [most, elastic]
    };
    let about_z = DVec3::new(0.0, 0.0, 6.0);
    for spin in [about_z, DVec3::new(3.0, 6.0, 1.0)] {
        let [most, elastic] = run(1e8, 0.0, spin, 24.0);
        assert!(most <= 1.005 && elastic <= 1e-3, "{spin}: {most}, {elastic}");
    }
    let [most, long] = run(5e4, 0.05, about_z, 24.0);
    let [_, short] = run(5e4, 0.05, about_z, 240.0);
    assert!(most <= 1.005, "{most}");
    // A thin bar of half length a stretches by rho w^2 (a^2 - x^2) / (2 E): its elastic energy over the kinetic energy of the start is
    // 0.4 e k^2, e = rho w^2 a^2 / E, where its longer arm slows it to w sqrt(k), k = (1 + 0.8 e k)^-2.
    let e = 1000.0 * 36.0 * 0.3 * 0.3 / 5e4;
    let k = (0..50).fold(1.0, |k: f64, _| (1.0 + 0.8 * e * k).powi(-2));
    // Lumped masses of n cells have 1 + 2 / n^2 of each square; those of the bar's width count too.
    let of_squares = (0.36 * (1.0 + 2.0 / 144.0) + 0.01 * (1.0 + 2.0 / 4.0)) / 0.36;
    let theory = 0.4 * e * k * k / of_squares;
    println!("{short} for {theory}, {long}");
    assert!((short / theory - 1.0).abs() <= 0.15, "{short} for {theory}");
    assert!((long / short - 1.0).abs() <= 0.2, "{long} for {short}");
}

/// The same of a bar that turns about the edge of its end, or about a corner of it: along tangents it comes to three times its energy.
#[test]
fn bars_swing_about_what_holds_them() {
    let run = |[min, max]: [DVec3; 2], spin: DVec3| {
        let mut bar = block([0.6, 0.1, 0.1], [12, 2, 2]);
        bar.placement.translate = DVec3::splat(1.0);
        (bar.young, bar.poisson) = (1e8, 0.3);
        bar.pins = vec![held(region(min, max), [true; 3])];
        // Of the end's corner at low y and z.
        let arm = DVec3::new(0.3, 0.05, 0.05);
        (bar.initial.spin, bar.initial.velocity) = (spin, spin.cross(arm));
        let mut scene = scene_of(vec![bar]);
        scene.domain.gravity = DVec3::ZERO;
        (scene.time.duration, scene.time.frames_per_second) = (1.0, 24.0);
        let mut reference = start(&scene);
        let solids = solids_of(&scene);
        let at_start = reference.state().node_velocity.iter().zip(&solids.mass);
        let energy: f64 = at_start.map(|(v, mass)| 0.5 * mass * DVec3::from(*v).length_squared()).sum();
        let (mut most, mut end) = (0.0, [0.0; 2]);
        for _ in 0..24 {
            let report = reference.step(reference.next_time_step()).unwrap();
            let it = report.solid.unwrap().diagnosis;
            most = f64::max(most, (it.kinetic_energy + it.elastic_energy) / energy);
            end = [it.kinetic_energy, it.elastic_energy].map(|part| part / energy);
        }
        let state = reference.state();
        let held = |node: &usize| solids.prescribed[*node] != [false; 3];
        for node in (0..solids.rest.len()).filter(held) {
            let moved = [state.displacement[node], state.node_velocity[node]];
            assert_eq!(moved, [[0.0; 3]; 2], "what is held stays");
        }
        (most, end)
    };
    let low = DVec3::new(0.69, 0.94, 0.94);
    for (held, spin) in [
        ([low, DVec3::new(0.71, 0.96, 1.06)], DVec3::new(0.0, 0.0, 6.0)),
        ([low, DVec3::new(0.71, 0.96, 0.96)], DVec3::new(0.0, 6.0, 1.0)),
    ] {
        let (most, [kinetic, elastic]) = run(held, spin);
        assert!(most <= 1.005 && elastic <= 1e-3, "{spin}: {most}, {elastic}");
        assert!(kinetic >= 0.9, "{spin}: it swings on, {kinetic}");
    }
}

/// A stiff block that nothing holds keeps energy and angular momentum over ten turns, however far it turns in a sub-step, and so does one
/// on rollers or on a hinge. Along tangents the one on rollers comes to 4,000 times its energy at 0.3 rad.
#[test]
fn stiff_bodies_spin_ten_turns() {
    let everywhere = region(DVec3::ZERO, DVec3::splat(4.0));
    let edge = DVec3::new(1.0, 1.0, 1.05);
    let near_edge = region(edge - DVec3::new(0.01, 0.01, 0.2), edge + DVec3::new(0.01, 0.01, 0.2));
    let about_z = DVec3::new(0.0, 0.0, 12.0);
    for (pins, about, spin) in [
        (vec![], None, about_z),
        (vec![], None, DVec3::new(5.0, 10.0, 4.0)),
        (vec![held(everywhere, [false, false, true])], None, about_z),
        (vec![held(near_edge, [true; 3])], Some(edge), about_z),
    ] {
        for angle in [0.05, 0.1, 0.3] {
            let mut solid = block([0.3, 0.2, 0.1], [6, 4, 2]);
            solid.placement.translate += DVec3::ONE;
            (solid.young, solid.pins) = (1e9, pins.clone());
            solid.initial.spin = spin;
            let centre = solid.placement.translate;
            solid.initial.velocity = about.map_or(DVec3::ZERO, |about| spin.cross(centre - about));
            let scene = scene_of(vec![solid]);
            let solids = solids_of(&scene);
            let mut reference = start(&scene);
            // About the hinge's line, else about the centroid.
            let momentum = |reference: &Reference| {
                let state = reference.state();
                let x = |node: usize| solids.rest[node] + DVec3::from(state.displacement[node]);
                let v = |node: usize| DVec3::from(state.node_velocity[node]);
                let nodes = || 0..solids.rest.len();
                let sum =
                    |of: &dyn Fn(usize) -> DVec3| -> DVec3 { nodes().map(|node| solids.mass[node] * of(node)).sum() };
                let mass: f64 = solids.mass.iter().sum();
                let centre = about.unwrap_or_else(|| sum(&x) / mass);
                let total = sum(&|node| (x(node) - centre).cross(v(node)));
                if pins.is_empty() { total } else { total * DVec3::Z }
            };
            let before = momentum(&reference);
            let dt = angle / spin.length();
            let at_start: f64 = (0..solids.rest.len())
                .map(|node| {
                    let v = DVec3::from(reference.state().node_velocity[node]);
                    0.5 * solids.mass[node] * v.length_squared()
                })
                .sum();
            for _ in 0..(10.0 * std::f64::consts::TAU / angle) as usize {
                let it = step(&mut reference, dt).diagnosis;
                let energy = (it.kinetic_energy + it.elastic_energy) / at_start;
                let turned = (momentum(&reference) - before).length() / before.length();
                let what = format!("{spin}, {} pins, {angle} rad: {energy}, {turned}", pins.len());
                assert!((energy - 1.0).abs() <= 0.01 && turned <= 0.01, "{what}");
            }
        }
    }
}

/// The same bits whatever the number of threads.
#[test]
fn a_run_of_solids_repeats_bit_for_bit() {
    let mut solid = block([0.5; 3], [4, 4, 4]);
    solid.placement.translate = DVec3::splat(1.0);
    solid.initial.spin = DVec3::new(3.0, 5.0, -2.0);
    let mut scene = scene_of(vec![solid]);
    scene.domain.gravity = DVec3::new(0.0, -9.81, 0.0);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut reference = start(&scene);
            for _ in 0..10 {
                let next = reference.next_time_step();
                reference.step(next).unwrap();
            }
            reference.state().clone()
        })
    };
    let once = run(1);
    assert!(once == run(3), "the states differ");
    assert!(once.velocity.iter().all(Vec::is_empty) && once.pressure.is_empty());
}

#[test]
fn a_state_of_other_solids_is_refused() {
    let scene = scene_of(vec![block([0.5; 3], [1, 1, 1])]);
    let cut = obstacle_cut(&scene, &scene.grid()).unwrap();
    let refused = |scene: &Scene| {
        let error = Reference::new(scene, cut.clone(), solids_of(scene), State::default());
        error.unwrap_err().to_string()
    };
    assert!(refused(&scene).contains("the 8 nodes of the scene's solids"));
    assert!(refused(&scene_of(Vec::new())).contains("neither liquid nor solids"));
}

/// The command line's way: a scene without liquid, run on the CPU.
#[test]
fn a_scene_of_solids_runs_on_the_cpu() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fall.toml");
    let text = "[domain]\nsize = [1.0, 1.0, 1.0]\ncells = [8, 8, 8]\ngravity = [0.0, -9.81, 0.0]\n\
        [time]\nduration = 0.125\nframes_per_second = 24\n\
        [[solid]]\nname = \"cube\"\nmesh = { box = { size = [0.2, 0.2, 0.2], cells = [2, 2, 2] } }\n\
        placement = { translate = [0.5, 0.8, 0.5] }\ndensity = 1000.0\nyoung = 1e5\npoisson = 0.3\n";
    std::fs::write(&path, text).unwrap();
    let scene = Scene::load(&path, &[], 1.0).unwrap();
    let options = Options {
        backend: Backend::Cpu,
        out: folder.path().join("out"),
        frames: None,
        overwrite: false,
        keep_going: false,
        resume: false,
    };
    let summary = cutwater::sim::run(&scene, &options, &mut |_| {}, &false.into()).unwrap();
    assert_eq!((summary.frames, summary.tally.missed, summary.tally.volume_ratio), (3, 0, None));
    assert!(options.out.join("frames/fall_000003.vtu").exists());
    let mut table = csv::Reader::from_path(options.out.join("steps.csv")).unwrap();
    let head: Vec<String> = table.headers().unwrap().iter().map(str::to_owned).collect();
    let stages = ["move_solid", "forces", "solid_matrices", "right_hand_side", "solve", "diagnose"];
    let columns = stages.map(|stage| format!("seconds_{stage}"));
    assert_eq!(head[head.len() - 6..], columns);
    let momentum = head.iter().position(|name| name == "solid_momentum_y").unwrap();
    let last = table.records().last().unwrap().unwrap();
    let found: f64 = last[momentum].parse().unwrap();
    assert!((found + 8.0 * 9.81 * 0.125).abs() < 1e-9, "{found} kg m/s");

    let mut simulation = Simulation::new(&scene, &Backend::Cpu).unwrap();
    let start = simulation.state().unwrap();
    simulation.step().unwrap();
    let after = simulation.state().unwrap();
    assert!(start != after);
    simulation.reset(&start).unwrap();
    simulation.step().unwrap();
    assert!(simulation.state().unwrap() == after, "a reset start repeats");
    let grid: Grid = scene.grid();
    assert_eq!(simulation.cut_cells().solid_distance.len(), grid.n_cells());
}
