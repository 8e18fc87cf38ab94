//! `move_solid` against its twin.

use cutwater::geometry::CutCells;
use cutwater::gpu::{Gpu, Real, Recorder};
use cutwater::reference;
use cutwater::stages::{MoveSolid, ObstacleBuffers};
use cutwater::state::State;
use glam::{DMat3, DVec3};

use crate::common::gpu;
use crate::liquid_case::single;
use crate::solid_case::{SolidCase, cases, eps};

/// Runs the stage some times.
fn moved(gpu: &Gpu, case: &SolidCase, real: Real, times: usize) -> State {
    let buffers = case.upload(gpu, real);
    let obstacles = ObstacleBuffers::new(gpu, &case.grid, buffers.plan.obstacles).unwrap();
    let solid_distance = case.solid_distance.clone();
    obstacles.write(
        gpu,
        &CutCells {
            open: Default::default(),
            solid_distance,
        },
    );
    let stage = MoveSolid::new(gpu, &buffers, Some(&obstacles)).unwrap();
    let mut recorder = Recorder::new(gpu);
    for _ in 0..times {
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
    let mut distance = case.solid_distance.clone();
    distance.resize(case.grid.n_cells(), 3.0 * case.grid.dx);
    let (u, v) = (&mut state.displacement, &mut state.node_velocity);
    reference::move_solid(&solids, &case.grid, &distance, case.dt, u, v);
    state
}

/// The cases, in the open and among obstacles.
fn with_obstacles() -> Vec<SolidCase> {
    let mut all = cases();
    for mut case in cases() {
        let grid = case.grid;
        let centre = 0.5 * grid.size() + DVec3::new(0.03, -0.05, 0.21);
        let turn = DMat3::from_rotation_z(0.4) * DMat3::from_rotation_x(0.7);
        let box_distance = |x: DVec3| {
            let q = (turn.transpose() * (x - centre)).abs() - DVec3::new(0.3, 0.15, 0.5);
            q.max(DVec3::ZERO).length() + q.max_element().min(0.0)
        };
        let distance = |cell: usize| {
            let d = box_distance(grid.cell_centre(grid.cell_at(cell)));
            single(d.clamp(-3.0 * grid.dx, 3.0 * grid.dx))
        };
        case.solid_distance = (0..grid.n_cells()).map(distance).collect();
        all.push(case);
    }
    all
}

#[test]
fn nodes_move_and_stay_out_of_walls_and_obstacles() {
    let Some(gpu) = gpu() else { return };
    let mut stopped = [0; 2];
    for case in with_obstacles() {
        let speed = case.speed();
        let reach = largest(&case.displacement) + case.dt * speed;
        // Where distances are sampled, and sizes, are f32.
        let sample = 8.0 * eps(Real::F32) * (case.grid.size().max_element() + reach);
        let exact = twin(&case, DVec3::ZERO);
        // What a push does jumps with the cell that a node is sampled in, and with the side of a wall or surface that it is on: a node
        // that rounding puts elsewhere has the twin of a node that is there.
        let nudged: Vec<State> = (0..8)
            .map(|c| [0, 1, 2].map(|axis| if c >> axis & 1 == 0 { -sample } else { sample }))
            .map(|nudge| twin(&case, nudge.into()))
            .collect();
        for real in SolidCase::reals(gpu) {
            let state = moved(gpu, &case, real, 1);
            // What two f32 hold, the rounding of dt v, and what an f32 below the normal ones may be taken for.
            let underflow = f64::from(f32::MIN_POSITIVE);
            let step = 2.0 * eps(real) * case.dt * speed + 2f64.powi(-46) * reach + underflow;
            for node in 0..state.displacement.len() {
                let u = DVec3::from(case.displacement[node]);
                let v = DVec3::from(case.velocity[node]);
                let [found_u, twin_u] = [&state, &exact].map(|s| DVec3::from(s.displacement[node]));
                let [found_v, twin_v] =
                    [&state, &exact].map(|s| DVec3::from(s.node_velocity[node]));
                let held = case.solids.prescribed[node];
                for axis in (0..3).filter(|&axis| held[axis]) {
                    let off = (found_u[axis] - (u + case.dt * v)[axis]).abs();
                    assert!(
                        off <= step,
                        "{}: prescribed node {node}, {off} m off",
                        case.name
                    );
                    assert_eq!(
                        found_v[axis], v[axis],
                        "{}: prescribed node {node}",
                        case.name
                    );
                }
                let stops = |twin: &State| {
                    let twin = DVec3::from(twin.displacement[node]);
                    (twin - (u + case.dt * v)).abs().max_element() > step
                };
                let near = |twin: &State, length: f64, rate: f64| {
                    let off_u = found_u - DVec3::from(twin.displacement[node]);
                    let off_v = found_v - DVec3::from(twin.node_velocity[node]);
                    off_u.abs().max_element() <= length && off_v.abs().max_element() <= rate
                };
                let mut twins = nudged.iter().chain([&exact]);
                let passed = if twins.clone().any(stops) {
                    stopped[usize::from(!case.solid_distance.is_empty())] += 1;
                    // A direction turns by the share of a cell that it is sampled off.
                    let turned = 16.0 * sample / case.grid.dx;
                    let length = sample + turned * 3.0 * case.grid.dx;
                    twins.any(|twin| near(twin, length, turned * speed))
                } else {
                    near(&exact, step, underflow)
                };
                assert!(
                    passed,
                    "{} {real:?}, node {node}: {found_u} m, {found_v} m/s, the twin {twin_u}, {twin_v}",
                    case.name
                );
            }
        }
    }
    assert!(
        stopped[0] > 50 && stopped[1] > 80,
        "{stopped:?} stopped by walls alone, by walls and obstacles"
    );
}

fn largest(vectors: &[[f64; 3]]) -> f64 {
    vectors
        .iter()
        .flatten()
        .fold(0.0, |largest, x| f64::max(largest, x.abs()))
}

/// A thousand steps that f32 alone would not notice.
#[test]
fn small_steps_add_up() {
    let Some(gpu) = gpu() else { return };
    for real in SolidCase::reals(gpu) {
        let mut case = cases().swap_remove(2);
        case.displacement.fill([0.0625, -0.1, 0.3]);
        case.displacement
            .iter_mut()
            .for_each(|u| *u = u.map(single));
        case.dt = 1.0 / 128.0;
        // dt v is exact, and less than half of the last digit of the larger parts.
        let v = [2f64.powi(-24), 2f64.powi(-22), -3.0 * 2f64.powi(-22)];
        case.velocity.fill(v);
        let times = 1000;
        let state = moved(gpu, &case, real, times);
        for (u, start) in state.displacement.iter().zip(&case.displacement) {
            for axis in 0..3 {
                let expected = start[axis] + times as f64 * case.dt * v[axis];
                // A rounding to 46 digits a step.
                let bound = times as f64 * 2f64.powi(-46) * expected.abs();
                assert!(
                    (u[axis] - expected).abs() <= bound,
                    "{real:?}: {} for {expected}",
                    u[axis]
                );
                assert!(
                    (expected - start[axis]).abs() > 100.0 * bound,
                    "the test tests something"
                );
            }
        }
        assert_eq!(state.node_velocity, case.velocity);
    }
}
