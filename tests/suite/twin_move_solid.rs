//! `move_solid` against its twin.

use cutwater::gpu::{Gpu, Real, Recorder};
use cutwater::reference;
use cutwater::stages::{ballistic_bodies, move_solid};
use cutwater::state::State;
use glam::{DMat3, DVec3};

use crate::common::{Random, gpu};
use crate::liquid_case::{GRAVITY, single};
use crate::solid_case::{RUBBER, SolidCase, cases, eps, lattice, solids};

/// Runs the stage some times, with or without ballistic bodies.
fn moved(gpu: &Gpu, case: &SolidCase, real: Real, times: usize, ballistic: bool) -> State {
    let buffers = case.upload(gpu, real);
    let release = ballistic_bodies(gpu, &buffers, None).unwrap();
    let stage = move_solid(gpu, &buffers).unwrap();
    let mut recorder = Recorder::new(gpu);
    for _ in 0..times {
        if ballistic {
            release.record(&mut recorder);
        }
        stage.record(&mut recorder);
    }
    recorder.submit();
    let mut state = case.state();
    buffers.read_state(gpu, &mut state).unwrap();
    state
}

/// The twin, for nodes that rest `nudge` (m) from where they do.
fn twin(case: &SolidCase, nudge: DVec3) -> State {
    let mut state = case.state();
    let mut solids = case.solids.clone();
    solids.rest.iter_mut().for_each(|x| *x += nudge);
    let (u, v) = (&mut state.displacement, &mut state.node_velocity);
    let dry = vec![false; u.len()];
    let falling = (GRAVITY.into(), case.dt);
    let ballistic = reference::ballistic_bodies(&solids, &case.grid, &[], &dry, falling, u, v);
    reference::move_solid(&solids, &case.grid, case.dt, (GRAVITY.into(), &ballistic), u, v);
    state
}

/// What turning adds to displacements (m) and velocities (m/s), of nodes whose numbers are off by `noise` times a random part.
fn turning(case: &SolidCase, noise: f64, seed: u64) -> Vec<[DVec3; 2]> {
    let mut solids = case.solids.clone();
    let mut random = Random(seed);
    let mut off = |scale: f64| {
        let parts = [(); 3].map(|()| noise * scale * random.uniform(-1.0, 1.0));
        DVec3::from(parts)
    };
    for (rest, u) in solids.rest.iter_mut().zip(&case.displacement) {
        *rest += off(case.grid.size().max_element() + DVec3::from(*u).length());
    }
    let mut velocity = case.velocity.clone();
    for v in &mut velocity {
        *v = (DVec3::from(*v) + off(case.speed())).to_array();
    }
    let (mut u, mut v) = (case.displacement.clone(), velocity.clone());
    reference::turn_solids(&solids, case.dt, &mut u, &mut v);
    let change =
        |after: &[[f64; 3]], before: &[[f64; 3]], node: usize| DVec3::from(after[node]) - DVec3::from(before[node]);
    (0..u.len()).map(|node| [change(&u, &case.displacement, node), change(&v, &velocity, node)]).collect()
}

/// How far, per node, m and m/s, a device whose numbers are rounded to `eps` may be from what turning adds: several times as far as inputs
/// take it that are off by their last digits.
fn turning_slack(case: &SolidCase, exact: &[[DVec3; 2]], eps: f64) -> Vec<[f64; 2]> {
    let mut slack = vec![[0.0_f64; 2]; exact.len()];
    for seed in 1..=6 {
        let noisy = turning(case, eps, seed);
        for body in case.solids.rotating_bodies() {
            let nodes = body.nodes;
            let off = [0, 1].map(|which| {
                let off = |node: usize| (noisy[node][which] - exact[node][which]).length();
                nodes.clone().map(off).fold(0.0, f64::max)
            });
            // The velocity is added to.
            let off = [4.0 * off[0], 4.0 * (off[1] + eps * case.speed())];
            for slack in &mut slack[nodes] {
                *slack = [slack[0].max(off[0]), slack[1].max(off[1])];
            }
        }
    }
    slack
}

#[test]
fn nodes_move_and_stay_out_of_walls() {
    let Some(gpu) = gpu() else { return };
    let (mut stopped, mut fell) = (0, 0);
    for case in cases() {
        let fall = 0.5 * case.dt * case.dt * DVec3::from(GRAVITY);
        let speed = case.speed() + fall.length() / case.dt;
        let reach = largest(&case.displacement) + case.dt * speed;
        // Sizes are f32.
        let sample = 8.0 * eps(Real::F32) * (case.grid.size().max_element() + reach);
        let exact = twin(&case, DVec3::ZERO);
        let turned = turning(&case, 0.0, 0);
        // What a wall does jumps with the side that a node is on: one that rounding puts elsewhere has the twin of a node that is there.
        let nudged: Vec<State> = (0..8)
            .map(|c| [0, 1, 2].map(|axis| if c >> axis & 1 == 0 { -sample } else { sample }))
            .map(|nudge| twin(&case, nudge.into()))
            .collect();
        for real in SolidCase::reals(gpu) {
            let state = moved(gpu, &case, real, 1, true);
            // What two f32 hold, the rounding of dt v, and what an f32 below the normal ones may be taken for.
            let underflow = f64::from(f32::MIN_POSITIVE);
            let step = 2.0 * eps(real) * case.dt * speed + 2f64.powi(-46) * reach + underflow;
            let slack = turning_slack(&case, &turned, eps(real));
            for node in 0..state.displacement.len() {
                let u = DVec3::from(case.displacement[node]);
                let v = DVec3::from(case.velocity[node]);
                let [found_u, twin_u] = [&state, &exact].map(|s| DVec3::from(s.displacement[node]));
                let [found_v, twin_v] = [&state, &exact].map(|s| DVec3::from(s.node_velocity[node]));
                let held = case.solids.prescribed[node];
                for axis in (0..3).filter(|&axis| held[axis]) {
                    let off = (found_u[axis] - (u + case.dt * v)[axis]).abs();
                    assert!(off <= step, "{}: prescribed node {node}, {off} m off", case.name);
                    assert_eq!(found_v[axis], v[axis], "{}: prescribed node {node}", case.name);
                }
                let [turned_u, turned_v] = [u + turned[node][0], v + turned[node][1]];
                let stops = |twin: &State| {
                    let twin = DVec3::from(twin.displacement[node]);
                    let free = turned_u + case.dt * turned_v;
                    let off = [free, free + fall].map(|free| (twin - free).abs().max_element());
                    off[0].min(off[1]) > step + slack[node][0]
                };
                let near = |twin: &State, length: f64, rate: f64| {
                    let [length, rate] = [length + slack[node][0], rate + slack[node][1]];
                    let off_u = found_u - DVec3::from(twin.displacement[node]);
                    let off_v = found_v - DVec3::from(twin.node_velocity[node]);
                    off_u.abs().max_element() <= length && off_v.abs().max_element() <= rate
                };
                let mut twins = nudged.iter().chain([&exact]);
                let passed = if twins.clone().any(stops) {
                    stopped += 1;
                    twins.any(|twin| near(twin, 2.0 * sample, underflow))
                } else {
                    // Rounding decides whether its body just touches a wall.
                    twins.any(|twin| near(twin, step, underflow))
                };
                let falls = |twin: &State| {
                    (DVec3::from(twin.displacement[node]) - turned_u - case.dt * turned_v - fall).abs().max_element()
                        <= step
                };
                fell += usize::from(falls(&exact));
                assert!(
                    passed,
                    "{} {real:?}, node {node}: {found_u} m, {found_v} m/s, the twin {twin_u}, {twin_v}",
                    case.name
                );
            }
        }
    }
    assert!(stopped > 50, "{stopped} stopped by walls");
    assert!(fell > 50, "{fell} nodes of ballistic bodies");
}

fn largest(vectors: &[[f64; 3]]) -> f64 {
    vectors.iter().flatten().fold(0.0, |largest, x| f64::max(largest, x.abs()))
}

/// A thousand steps that f32 alone would not notice.
#[test]
fn small_steps_add_up() {
    let Some(gpu) = gpu() else { return };
    for real in SolidCase::reals(gpu) {
        let mut case = cases().swap_remove(2);
        case.displacement.fill([0.0625, -0.1, 0.3]);
        case.displacement.iter_mut().for_each(|u| *u = u.map(single));
        case.dt = 1.0 / 128.0;
        // dt v is exact, and less than half of the last digit of the larger parts.
        let v = [2f64.powi(-24), 2f64.powi(-22), -3.0 * 2f64.powi(-22)];
        case.velocity.fill(v);
        let times = 1000;
        let state = moved(gpu, &case, real, times, false);
        for (u, start) in state.displacement.iter().zip(&case.displacement) {
            for axis in 0..3 {
                let expected = start[axis] + times as f64 * case.dt * v[axis];
                // A rounding to 46 digits a step.
                let bound = times as f64 * 2f64.powi(-46) * expected.abs();
                assert!((u[axis] - expected).abs() <= bound, "{real:?}: {} for {expected}", u[axis]);
                assert!((expected - start[axis]).abs() > 100.0 * bound, "the test tests something");
            }
        }
        assert_eq!(state.node_velocity, case.velocity);
    }
}

/// A bar that turns by a third of a radian keeps its shape, the way of its centroid and both momenta, on the device too.
#[test]
fn what_turns_keeps_its_shape_and_its_momenta() {
    let Some(gpu) = gpu() else { return };
    let low = DVec3::new(0.4, 0.5, 0.3);
    let mesh = lattice(low, DVec3::new(0.1, 0.15, 0.7), [2, 2, 9]);
    let mut case = SolidCase::new("a bar", solids(&[(mesh, RUBBER)]));
    case.dt = single(1.0 / 64.0);
    let middle = low + DVec3::new(0.05, 0.075, 0.35);
    let (spin, drift) = (DVec3::new(15.0, -12.0, 9.0), DVec3::new(0.5, 1.0, -0.25));
    for (v, rest) in case.velocity.iter_mut().zip(&case.solids.rest) {
        *v = (drift + spin.cross(rest - middle)).to_array();
    }
    let sums = |state: &State| {
        let nodes = 0..case.solids.rest.len();
        nodes.fold([DVec3::ZERO; 3], |[x, p, l], node| {
            let mass = case.solids.mass[node];
            let at = case.solids.rest[node] + DVec3::from(state.displacement[node]);
            let momentum = mass * DVec3::from(state.node_velocity[node]);
            [x + mass * at, p + momentum, l + at.cross(momentum)]
        })
    };
    let [x, p, l] = sums(&case.state());
    for real in SolidCase::reals(gpu) {
        let state = moved(gpu, &case, real, 1, false);
        let elements = 0..case.solids.elements.len();
        let mut turn = DMat3::ZERO;
        for element in elements {
            let found = case.solids.deformation(element, &state.displacement);
            let strain = found.strain.to_cols_array().map(f64::abs);
            let strain = strain.into_iter().fold(0.0, f64::max);
            // Positions of about 1 m in elements of 0.05 m; along tangents it would be 0.055.
            assert!(strain <= 64.0 * eps(real) + 1e-12, "{real:?}: strain {strain}");
            turn = found.rotation;
        }
        let angle = (0.5 * (turn.x_axis.x + turn.y_axis.y + turn.z_axis.z - 1.0)).acos();
        assert!((0.25..0.4).contains(&angle), "{real:?}: {angle} rad");
        let [to, p_after, l_after] = sums(&state);
        let scale = l.length().max(p.length());
        for (what, after, before) in
            [("centroid", to, x + case.dt * p), ("momentum", p_after, p), ("angular momentum", l_after, l)]
        {
            let off = (after - before).length();
            assert!(off <= 16.0 * eps(real) * scale, "{real:?}: {what} off by {off} of {scale}");
        }
    }
}
