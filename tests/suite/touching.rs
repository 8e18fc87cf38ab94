//! Solids that touch each other (`solver.solid_contact`), on the f64 path.

use cutwater::geometry::{ContactPair, contact_hits, contact_pairs, obstacle_cut};
use cutwater::reference::{ActiveSurfaces, Contacts, Reference, TimeStep, Touching};
use cutwater::scene::{Placement, Scene, Solid, SolidMesh};
use cutwater::sim::{Backend, Plan, Simulation};
use cutwater::state::{ContactReport, State};
use glam::{DMat3, DVec3};

use crate::common::{Random, adapter, gpu};
use crate::solid_cases::{held, region};
use crate::solid_scene::{block, body, scene_of, solids_of};

/// A sub-step's numbers of the bodies.
struct Sample {
    /// Momentum of each body, kg m/s.
    momentum: Vec<DVec3>,
    /// About the origin, kg m^2/s.
    angular: DVec3,
    /// Kinetic, elastic and potential, J.
    energy: f64,
    /// Largest overlap of bodies, m.
    overlap: f64,
    positions: Vec<DVec3>,
}

/// Runs sub-steps of dt (s) and returns their numbers, those of the start first.
fn run(solids: Vec<Solid>, gravity: f64, dt: f64, steps: usize) -> Vec<Sample> {
    let mut scene = scene_of(solids);
    scene.domain.gravity = DVec3::new(0.0, gravity, 0.0);
    scene.solver.solid_contact = true;
    let solids = solids_of(&scene);
    let cut = obstacle_cut(&scene, &scene.grid()).unwrap();
    let (displacement, node_velocity) = solids.initial_state(&scene);
    let state = State { displacement, node_velocity, ..State::default() };
    let mut reference = Reference::new(&scene, cut, solids.clone(), state).unwrap();
    let sample = |reference: &Reference, energy: f64| {
        let state = reference.state();
        let x = |node: usize| solids.rest[node] + DVec3::from(state.displacement[node]);
        let p = |node: usize| solids.mass[node] * DVec3::from(state.node_velocity[node]);
        let bodies = solids.bodies.iter();
        let positions: Vec<DVec3> = (0..solids.rest.len()).map(x).collect();
        let ranges: Vec<_> = bodies.clone().map(|body| body.triangles.clone()).collect();
        // Edges are told apart from near only.
        let pairs = |reach| contact_pairs(&positions, &solids.triangles, &ranges, &|a, b| (a != b).then_some(reach));
        let of_node = |pair: &ContactPair| pair.points.iter().any(|point| point.1.abs() == 1.0);
        let nodes = pairs(0.1).into_iter().filter(of_node);
        Sample {
            momentum: bodies.map(|body| body.nodes.clone().map(p).sum()).collect(),
            angular: (0..solids.rest.len()).map(|node| x(node).cross(p(node))).sum(),
            energy,
            overlap: nodes.chain(pairs(0.02)).fold(0.0, |worst, pair| f64::max(worst, -pair.gap)),
            positions,
        }
    };
    let mut samples = vec![sample(&reference, f64::NAN)];
    for _ in 0..steps {
        let time_step = TimeStep { dt, ..reference.next_time_step() };
        let report = reference.step(time_step).unwrap().solid.unwrap();
        assert_eq!(report.contact.unsettled, 0, "{report:?}");
        let it = report.diagnosis;
        let energy = it.kinetic_energy + it.elastic_energy + it.potential_energy;
        samples.push(sample(&reference, energy));
    }
    samples
}

/// Two equal bars of 0.5 m meet at 1 m/s: they exchange their momenta, to rounding in sum, while a wave runs to the ends and back, 2 L / c.
#[test]
fn equal_bars_exchange_their_momenta() {
    let bar = |x: f64, speed: f64| {
        let mut bar = block([0.5, 0.1, 0.1], [20, 2, 2]);
        bar.placement.translate = DVec3::new(x, 2.0, 2.0);
        (bar.young, bar.poisson, bar.initial.velocity) = (1e6, 0.0, speed * DVec3::X);
        bar
    };
    // c = sqrt(E / rho) = 31.6 m/s.
    let (dt, c) = (2e-4, 1e3_f64.sqrt());
    let samples = run(vec![bar(1.0, 0.5), bar(1.5005, -0.5)], 0.0, dt, 250);
    let whole = samples[0].momentum[0].length();
    for sample in &samples {
        let sum: DVec3 = sample.momentum.iter().sum();
        assert!(sum.length() <= 1e-11 * whole, "{sum}");
    }
    let forces: Vec<f64> =
        samples.windows(2).map(|pair| (pair[1].momentum[0] - pair[0].momentum[0]).length() / dt).collect();
    // The width of a pulse of constant force.
    let impulse: f64 = forces.iter().map(|f| f * dt).sum();
    let width = impulse * impulse / forces.iter().map(|f| f * f * dt).sum::<f64>();
    let theory = 2.0 * 0.5 / c;
    println!("{width} s for {theory}; {} of the momentum", impulse / whole);
    assert!((width / theory - 1.0).abs() <= 0.05, "{width} s for {theory}");
    // Backward Euler widens the fronts of the wave to sqrt(c dt t) after t = 2 L / c: 0.08 of its way. What is in them, at both ends of
    // the pulse, stays behind as vibration.
    let after = -samples.last().unwrap().momentum[0].x / whole;
    let fronts = (c * dt / (2.0 * 0.5)).sqrt();
    assert!((1.0 - 2.0 * fronts..=1.001).contains(&after), "{after}");
}

/// Bodies thrown at each other in any position keep momentum and angular momentum, gain no energy, and do not pass through each other.
#[test]
fn thrown_bodies_bounce_off_each_other() {
    let mut random = Random(11);
    for case in 0..24 {
        let young = [1e4, 1e5, 1e7, 1e9][case % 4];
        let dt = [1.0 / 240.0, 1.0 / 60.0][case / 4 % 2];
        let mut thrown = |x: f64, speed: f64| {
            let mesh = match random.bits() % 3 {
                0 => SolidMesh::Sphere { radius: 0.12, cell_size: 0.06 },
                1 => SolidMesh::Box { size: DVec3::splat(0.2), cells: [2, 2, 2] },
                _ => SolidMesh::Box { size: DVec3::new(0.3, 0.15, 0.15), cells: [4, 2, 2] },
            };
            let mut any = || DVec3::from([(); 3].map(|()| random.uniform(-1.0, 1.0)));
            let (axis, shift, spin) = (any().normalize(), 0.05 * any(), 2.0 * any());
            let mut solid = body(mesh);
            solid.placement = Placement {
                translate: DVec3::new(x, 2.0, 2.0) + shift * DVec3::new(0.0, 1.0, 1.0),
                rotate: DMat3::from_axis_angle(axis, 2.0),
                ..Placement::default()
            };
            (solid.young, solid.poisson) = (young, 0.3);
            (solid.initial.velocity, solid.initial.spin) = (speed * DVec3::X, spin);
            solid
        };
        let bodies = vec![thrown(1.7, 1.0), thrown(2.3, -1.0)];
        let samples = run(bodies, 0.0, dt, (0.8 / dt) as usize);
        let first = &samples[0];
        let [p, l] = [first.momentum.iter().sum::<DVec3>(), first.angular];
        let scale = first.momentum[0].length();
        let what = format!("case {case}, {young} Pa, {dt} s");
        for pair in samples[1..].windows(2) {
            let sum: DVec3 = pair[1].momentum.iter().sum();
            assert!((sum - p).length() <= 1e-9 * scale, "{what}: {sum} for {p}");
        }
        let last = samples.last().unwrap();
        let most = samples[1..].iter().map(|sample| sample.energy / samples[1].energy);
        let most = most.fold(0.0, f64::max);
        let overlap = samples.iter().map(|sample| sample.overlap).fold(0.0, f64::max);
        let swing = (last.angular - l).length() / l.length().max(scale * 0.1);
        println!("{what}: energy at most {most:.5}, overlap {overlap:.5} m, angular momentum {swing:.1e}");
        // Soft bodies stretch by v / c = 0.3, where the rotations of a sub-step are linearised.
        assert!(most <= 1.005, "{what}: {most}");
        // Relative velocity along x is not what it was: they have met.
        let before = first.momentum[0].x;
        assert!(last.momentum[0].x < 0.6 * before, "{what}: they met");
        // A row holds for the nearest points at the start of a sub-step. Soft bodies crush each other in it: an element is 0.06 to 0.1 m.
        let allowed = if young < 1e5 { 0.025 } else { 0.01 };
        assert!(overlap <= allowed, "{what}: {overlap} m deep");
    }
}

/// Bodies that move by most of their size in a sub-step do not pass through each other.
#[test]
fn fast_bodies_do_not_pass() {
    let mut random = Random(5);
    for case in 0..12 {
        let mut thrown = |x: f64, speed: f64| {
            let mesh = match random.bits() % 2 {
                0 => SolidMesh::Sphere { radius: 0.12, cell_size: 0.06 },
                _ => SolidMesh::Box { size: DVec3::new(0.2, 0.15, 0.2), cells: [2, 2, 2] },
            };
            let mut any = || DVec3::from([(); 3].map(|()| random.uniform(-1.0, 1.0)));
            let (axis, shift) = (any().normalize(), 0.05 * any());
            let mut solid = body(mesh);
            solid.placement = Placement {
                translate: DVec3::new(x, 2.0, 2.0) + shift,
                rotate: DMat3::from_axis_angle(axis, 2.0),
                ..Placement::default()
            };
            solid.young = 1e8;
            solid.initial.velocity = speed * DVec3::X;
            solid
        };
        let bodies = vec![thrown(1.6, 20.0), thrown(2.4, -20.0)];
        // 0.17 m each in a sub-step.
        let samples = run(bodies, 0.0, 1.0 / 120.0, 8);
        let overlap = samples.iter().map(|sample| sample.overlap).fold(0.0, f64::max);
        let [first, last] = [&samples[0], samples.last().unwrap()];
        println!("case {case}: overlap {overlap:.5} m, {:?}", last.momentum);
        // An element is 0.06 to 0.1 m, and the impact changes its shape by v / c = 0.06 of that.
        assert!(overlap <= 0.01, "case {case}: {overlap} m deep");
        assert!(last.momentum[0].x < 0.6 * first.momentum[0].x, "case {case}: they met");
    }
}

/// A node that crosses a face and an edge that crosses an edge are found, with the gap of the start; what leaves, passes beside or stays is not.
#[test]
fn motions_through_surfaces_are_found() {
    // Two tetrahedra, the second with a face in the plane y = 0 and the first with a corner, or an edge, above it.
    let base = [
        DVec3::new(-1.0, 0.0, -1.0),
        DVec3::new(1.0, 0.0, -1.0),
        DVec3::new(0.0, 0.0, 1.5),
        DVec3::new(0.0, -1.0, 0.0),
    ];
    let corner =
        [DVec3::new(0.0, 0.1, 0.0), DVec3::new(-1.0, 2.0, -1.0), DVec3::new(1.0, 2.0, -1.0), DVec3::new(0.0, 2.0, 1.5)];
    let faces = |first: u32, points: &[DVec3]| -> Vec<[u32; 3]> {
        let middle = points.iter().sum::<DVec3>() / 4.0;
        let corners = [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]];
        let outwards = |&[a, b, c]: &[usize; 3]| {
            let normal = (points[b] - points[a]).cross(points[c] - points[a]);
            let turned = normal.dot(points[a] - middle) < 0.0;
            [a, if turned { c } else { b }, if turned { b } else { c }]
        };
        let faces = corners.iter().map(outwards);
        faces.map(|face| face.map(|corner| first + corner as u32)).collect()
    };
    let hits = |moving: &[DVec3], way: DVec3| {
        let positions = [moving, &base].concat();
        let triangles = [faces(0, moving), faces(4, &base)].concat();
        let ways: Vec<DVec3> = (0..8).map(|node| if node < 4 { way } else { DVec3::ZERO }).collect();
        contact_hits(&positions, &ways, &triangles, (&[0..4, 4..8], &|a, b| (a != b).then_some(1e-9)), 1e-9)
    };
    let down = hits(&corner, DVec3::new(0.0, -0.3, 0.0));
    assert_eq!(down.len(), 1, "{down:?}");
    assert!(down[0].points.contains(&(0, 1.0)) && down[0].points.len() == 4);
    assert!((down[0].gap - 0.1).abs() < 1e-12 && down[0].normal.distance(DVec3::Y) < 1e-12);
    for way in [DVec3::Y, DVec3::new(0.0, -0.05, 0.0), DVec3::new(5.0, -0.3, 0.0), DVec3::ZERO] {
        assert_eq!(hits(&corner, way), [], "{way}");
    }
    // An edge along z comes down on the face's edge along x, beyond whose ends it reaches.
    let edge = [
        DVec3::new(0.1, 0.2, -2.0),
        DVec3::new(0.1, 0.2, -0.5),
        DVec3::new(0.0, 2.0, -1.0),
        DVec3::new(1.0, 2.0, -1.2),
    ];
    let crossed = hits(&edge, DVec3::new(0.0, -0.4, 0.0));
    let pairs: Vec<Vec<u32>> = (crossed.iter()).map(|pair| pair.points.iter().map(|point| point.0).collect()).collect();
    assert!(pairs.contains(&vec![0, 1, 4, 5]), "{crossed:?}");
    for pair in &crossed {
        let sum: f64 = pair.points.iter().map(|point| point.1).sum();
        assert!(sum.abs() < 1e-12 && (pair.gap - 0.2).abs() < 1e-9, "{pair:?}");
    }
}

/// A bar through a slab has pairs although its ends are outside: of the deepest points of its edges or of its deepest nodes. A motion in which they come
/// deeper is found.
#[test]
fn deep_overlaps_have_pairs() {
    // The slab from y = 1.8 to 2, the bar from 1.44 to 2.44 beside its middle. One of the nine points of an edge is at 1.94, 0.06 below the top. One of
    // edges half as long is at 1.8775. With eight edges one end is at 1.815, and the deepest point between is at 1.893125.
    let cases = [(1, &[0.06][..]), (2, &[0.06, 0.0775]), (8, &[0.093125])];
    for (cells, depths) in cases {
        let (mut slab, mut bar) = (block([1.0, 0.2, 1.0], [2, 1, 2]), block([0.1, 1.0, 0.1], [1, cells, 1]));
        slab.placement.translate = DVec3::new(1.5, 1.9, 1.5);
        bar.placement.translate = DVec3::new(1.36, 1.94, 1.47);
        let solids = solids_of(&scene_of(vec![slab, bar]));
        let bodies: Vec<_> = solids.bodies.iter().map(|body| body.triangles.clone()).collect();
        let reach = |one: usize, other: usize| (one != other).then_some(1e-6);
        let pairs = contact_pairs(&solids.rest, &solids.triangles, &bodies, &reach);
        for depth in depths {
            let deep = pairs.iter().filter(|pair| (pair.gap + depth).abs() < 1e-9 && pair.normal.y.abs() > 1.0 - 1e-9);
            assert!(deep.count() >= 4, "{cells} {depth}: {pairs:?}");
        }
        // Down, the points at 1.94 come deeper, and those at 1.8775 come out.
        let way = |node: usize| if solids.bodies[1].nodes.contains(&node) { -0.03 * DVec3::Y } else { DVec3::ZERO };
        let ways: Vec<DVec3> = (0..solids.rest.len()).map(way).collect();
        let hits = contact_hits(&solids.rest, &ways, &solids.triangles, (&bodies, &reach), 1e-6);
        assert!(hits.len() >= 4 && hits.iter().all(|hit| (hit.gap + 0.06).abs() < 1e-9), "{cells}: {hits:?}");
    }
}

/// Where velocities after the last solve still take bodies through each other, the next sub-step is halved until they do not; where a longer one
/// alone would, it is no longer.
#[test]
fn the_next_sub_step_is_halved() {
    // Two cubes 0.05 m apart.
    let cube = |x: f64| {
        let mut cube = block([0.2; 3], [1; 3]);
        cube.placement.translate = DVec3::new(x, 2.0, 2.0);
        cube
    };
    let scene = scene_of(vec![cube(1.0), cube(1.25)]);
    let solids = solids_of(&scene);
    let (grid, dt) = (scene.grid(), 0.1);
    let field = obstacle_cut(&scene, &grid).unwrap().contact_field(&grid);
    let displacement = vec![[0.0; 3]; solids.rest.len()];
    let contacts = Contacts::holding(&solids, &field, &displacement, &[ActiveSurfaces::default(); 16], dt);
    let touching = Touching { solids: &solids, contacts: &contacts, positions: &solids.rest, dt, dx: grid.dx };
    // Way of the first cube in a sub-step over the gap.
    for (way, expected) in [(-4.0, None), (0.4, None), (0.9, Some(0)), (1.9, Some(1)), (3.9, Some(2)), (7.9, Some(3))] {
        let first = solids.bodies[0].nodes.len();
        let velocity: Vec<f64> =
            (0..16).flat_map(|i| [if i < first { way * 0.05 / dt } else { 0.0 }, 0.0, 0.0]).collect();
        let mut report = ContactReport::default();
        touching.shorten(&velocity, &mut report);
        assert_eq!((report.next_halvings, report.unsettled), (expected, 0), "{way}");
        let longest = expected.map_or(0.0, |times| dt / f64::from(1 << times));
        assert!((report.next_step(dt, 0.0) - longest).abs() <= 1e-12, "{way}");
    }
}

/// Solids that the initial velocities take through each other in the first sub-step do not pass.
#[test]
fn the_first_sub_step_is_limited_too() {
    let cube = |x: f64, speed: f64| {
        let mut cube = block([0.2; 3], [1; 3]);
        cube.placement.translate = DVec3::new(x, 2.0, 2.0);
        (cube.young, cube.initial.velocity) = (1e8, speed * DVec3::X);
        cube
    };
    // 0.2 m apart; 0.42 m each in a frame.
    let mut scene = scene_of(vec![cube(1.0, 10.0), cube(1.4, -10.0)]);
    scene.solver.solid_contact = true;
    let mut simulation = Simulation::new(&scene, &Backend::Cpu).unwrap();
    let solids = simulation.solids().clone();
    let first = simulation.step().unwrap().dt;
    assert!(first <= 0.01, "{first} s");
    while simulation.clock().time < 1.0 / 24.0 - 1e-9 {
        simulation.step().unwrap();
    }
    let state = simulation.state().unwrap();
    let middle = |body: usize| {
        let nodes = solids.bodies[body].nodes.clone();
        let n = nodes.len() as f64;
        nodes.map(|node| solids.rest[node].x + state.displacement[node][0]).sum::<f64>() / n
    };
    assert!(middle(0) < middle(1) - 0.15, "{} and {}", middle(0), middle(1));
}

/// Both backends take the limit of contact from a state.
#[test]
fn a_state_limits_the_next_sub_step() {
    let mut scene = scene_of(vec![block([0.2; 3], [1; 3])]);
    scene.solver.solid_contact = true;
    scene.time.fixed_step = Some(0.01);
    let device = gpu().map(|_| Backend::Gpu(adapter()));
    for backend in [Some(Backend::Cpu), device].into_iter().flatten() {
        let mut simulation = Simulation::new(&scene, &backend).unwrap();
        let whole = simulation.step().unwrap().dt;
        let mut state = simulation.state().unwrap();
        assert_eq!(state.contact_step, 0.0, "{backend:?}");
        state.contact_step = 0.25 * whole;
        let carried = simulation.carried().unwrap();
        simulation.resume(&state, &carried).unwrap();
        let dt = simulation.step().unwrap().dt;
        assert!(dt <= 0.25 * whole * (1.0 + 1e-9) && dt >= 0.2 * whole, "{backend:?}: {dt} s after {whole} s");
    }
}

/// Three blocks on each other, guided along y since nothing rubs, come to rest and stay there. Each is smaller than what it stands on: where
/// edges lie on each other, they may slip past.
#[test]
fn a_stack_stands() {
    for young in [1e5, 1e8] {
        let level = |n: usize| {
            let mut block = block([[0.2, 0.16, 0.12][n]; 3], [[2, 3, 2][n]; 3]);
            block.placement.translate = DVec3::new(2.0, [0.1, 0.281, 0.422][n], 2.0);
            (block.young, block.mass_damping) = (young, 5.0);
            let everywhere = region(DVec3::ZERO, DVec3::splat(4.0));
            block.pins = vec![held(everywhere, [true, false, true])];
            block
        };
        let samples = run((0..3).map(level).collect(), -9.81, 1.0 / 60.0, 180);
        let [late, last] = [&samples[120], samples.last().unwrap()];
        let drift = late.positions.iter().zip(&last.positions);
        let drift = drift.fold(0.0, |most, (a, b)| f64::max(most, a.distance(*b)));
        println!("{young}: drift {drift} m, overlap {} m", last.overlap);
        // A hundredth of an element.
        assert!(drift <= 1e-3, "{young}: {drift} m in a second");
        assert!(last.overlap <= 1e-3, "{young}: {} m", last.overlap);
    }
}

/// Liquid and solids must share a solve, and the device needs residuals in f64.
#[test]
fn contact_of_solids_is_refused_where_it_is_missing() {
    let text = |solver: &str| {
        format!(
            "[domain]\nsize = [1, 1, 1]\ncells = [8, 8, 8]\n[time]\nduration = 1\n[[liquid.region]]\nbox = {{ min = [0, 0, 0], max = [1, 0.2, 1] }}\n\
             [[solid]]\nname = \"block\"\nmesh = {{ box = {{ size = [0.2, 0.2, 0.2], cells = [1, 1, 1] }} }}\n\
             placement = {{ translate = [0.5, 0.7, 0.5] }}\ndensity = 1000\nyoung = 1e5\npoisson = 0.3\n[solver]\nsolid_contact = true\n{solver}"
        )
    };
    let parse = |text: &str| Scene::parse("touch.toml".as_ref(), text, &[], 1.0);
    for coupling in ["weak", "damping_only"] {
        let text = text(&format!("coupling = \"{coupling}\"\n"));
        let refused = parse(&text).unwrap_err().to_string();
        assert!(refused.contains("solver.solid_contact") && refused.contains("strong"), "{refused}");
    }
    let scene = parse(&text("precision = \"f32\"")).unwrap();
    assert!(Simulation::new(&scene, &Backend::Cpu).is_ok());
    let refused = Simulation::new(&scene, &Backend::Gpu(adapter()));
    let refused = refused.err().unwrap().to_string();
    assert!(refused.contains("--backend cpu"), "{refused}");
    let scene = parse(&text("")).unwrap();
    let plan = Plan::new(&scene, None).unwrap();
    assert!(plan.effects.iter().any(|effect| effect.name == "solid_contact" && effect.active));
}
