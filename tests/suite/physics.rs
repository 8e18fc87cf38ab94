//! The GPU path against what is known exactly, and against itself.

use cutwater::scene::{Scene, Surface};
use cutwater::sim::{Backend, Simulation};
use cutwater::state::{SolveStatus, State};

use crate::common::{adapter, area_from_above, digest, gpu, same_with_any_number_of_threads};
use crate::reference_physics::{
    DAM, DAM_RELEASE_ERROR, GRAVITY, dam_release_error, dam_release_scene, flies_on, flights, pool, rest_cases, scene,
};

fn simulation(scene: &Scene) -> Simulation {
    Simulation::new(scene, &Backend::Gpu(adapter())).unwrap()
}

/// F1, F2 in `mixed`: ten times the tolerance, or what f32 velocities of g dt leave of a difference of potentials.
#[test]
fn water_at_rest_stays_at_rest_on_the_gpu() {
    let Some(_) = gpu() else { return };
    for (name, mut scene) in rest_cases() {
        scene.time.fixed_step = Some(1.0 / 48.0);
        let mut simulation = simulation(&scene);
        for number in 0..20 {
            let report = simulation.step().unwrap();
            let liquid = report.liquid.unwrap();
            let bound = f64::max(10.0 * scene.solver.tolerance, 2e-6) * GRAVITY * report.dt;
            let speed = liquid.diagnosis.max_speed;
            assert!(
                liquid.solve.unknowns > 0 && speed <= bound,
                "{name}, step {number}: {speed:e} m/s, allowed {bound:e}: {report:?}"
            );
        }
    }
}

/// F1 and F2 with markers: what their spheres are too high or too low starts currents, and leaves no hole where a fixed surface has liquid. Bumps
/// of an eighth of a cell, or a surface taken to be 0.15 cells, d, from a centre, with wave numbers up to pi/dx give them pi d^2 / dx over the depth
/// of the kinetic energy of what falls freely.
#[test]
fn markers_at_rest_start_slowly_on_the_gpu() {
    let Some(_) = gpu() else { return };
    for (name, fixed) in rest_cases() {
        let mut markers = fixed.clone();
        markers.liquid.as_mut().unwrap().surface = Surface::Markers;
        markers.solver.theta_floor = 0.15.into();
        let [fixed, markers] = [fixed, markers].map(|scene| {
            let mut simulation = simulation(&scene);
            let report = simulation.step().unwrap();
            (report, simulation.state().unwrap(), scene.grid())
        });
        let (report, state, grid) = markers;
        let fall = GRAVITY * report.dt;
        let diagnosis = report.liquid.unwrap().diagnosis;
        let speed = diagnosis.max_speed;
        assert!(speed < fall, "{name}: {} of g dt", speed / fall);
        let of_fall = 0.5 * 1000.0 * diagnosis.volume * fall.powi(2);
        let depth = diagnosis.volume / area_from_above(&grid, &state.active);
        let bound = std::f64::consts::PI * 0.15_f64.powi(2) * grid.dx / depth;
        let share = diagnosis.kinetic_energy / of_fall;
        assert!(share <= bound, "{name}: {share} of free fall, allowed {bound}");
        let height = |cell: usize| grid.cell_centre(grid.cell_at(cell)).y;
        let filled = || (0..grid.n_cells()).filter(|&cell| fixed.1.active[cell]);
        let top = filled().map(height).fold(0.0, f64::max);
        // The level is above the highest centre in the liquid: this asks for more than two cells below it.
        for cell in filled().filter(|&cell| height(cell) < top - grid.dx) {
            assert!(state.active[cell], "{name}: air at {} m", height(cell));
        }
    }
}

#[test]
fn a_full_container_rests_on_the_gpu_and_is_closed() {
    let Some(_) = gpu() else { return };
    let sphere = "[[obstacle]]\nsphere = { centre = [0.5, 0.5, 0.5], radius = 0.44 }\ninside_out = true\n";
    for rest in [pool(2.0), pool(2.0) + sphere] {
        let mut simulation = simulation(&scene([12, 12, 12], &rest));
        let report = simulation.step().unwrap();
        let liquid = report.liquid.unwrap();
        assert_eq!(liquid.closed_components, 1, "{report:?}");
        assert_eq!(liquid.solve.status, SolveStatus::Converged, "{report:?}");
        let bound = 2e-6 * GRAVITY * report.dt;
        assert!(liquid.diagnosis.max_speed <= bound, "{report:?}");
    }
}

#[test]
fn liquid_flies_on_along_a_diagonal_on_the_gpu() {
    let Some(_) = gpu() else { return };
    for scene in flights() {
        let mut simulation = simulation(&scene);
        let before = simulation.state().unwrap();
        for _ in 0..3 {
            simulation.step().unwrap();
        }
        // Positions and velocities are f32.
        flies_on(&scene, &before, &simulation.state().unwrap(), 1e-5);
    }
}

#[test]
fn dam_release_has_the_exact_pressure_on_the_gpu() {
    let Some(_) = gpu() else { return };
    let scene = dam_release_scene();
    let mut simulation = simulation(&scene);
    simulation.step().unwrap();
    // Rounding to f32 is far below it.
    let largest = dam_release_error(&scene.grid(), &simulation.state().unwrap().pressure);
    assert!(largest < DAM_RELEASE_ERROR, "largest error {largest} of rho g H");
}

/// A dam break past a pillar: violent enough to exercise every stage.
fn dam_break() -> Simulation {
    simulation(&scene([32, 24, 8], DAM))
}

/// Steps to the end of a frame; the state, and the least and largest volume ratio.
fn run(simulation: &mut Simulation, n_frames: u64) -> (State, [f64; 2]) {
    let mut volume = [1.0_f64; 2];
    while simulation.clock().frame < n_frames {
        let report = simulation.step().unwrap();
        let liquid = report.liquid.unwrap();
        assert_eq!(liquid.solve.status, SolveStatus::Converged, "{report:?}");
        let ratio = simulation.volume_ratio(&report).unwrap();
        volume = [volume[0].min(ratio), volume[1].max(ratio)];
    }
    (simulation.state().unwrap(), volume)
}

#[test]
fn a_run_repeats_bit_for_bit_on_one_device() {
    let Some(_) = gpu() else { return };
    let (once, _) = run(&mut dam_break(), 12);
    let (again, _) = run(&mut dam_break(), 12);
    assert!(once == again, "two runs of the same scene differ");
}

/// Prints all bits of a run, for [`a_run_does_not_depend_on_the_number_of_threads`].
#[test]
fn digest_of_a_run() {
    let Some(_) = gpu() else { return };
    let (state, _) = run(&mut dam_break(), 6);
    let markers = digest(state.markers.iter().flatten().copied());
    let velocity = digest(state.velocity.iter().flatten().copied());
    let pressure = digest(state.pressure);
    println!("digest of a run: {markers:016x} {velocity:016x} {pressure:016x}");
}

#[test]
fn a_run_does_not_depend_on_the_number_of_threads() {
    let Some(_) = gpu() else { return };
    same_with_any_number_of_threads("physics::digest_of_a_run", 1);
}

/// What an earlier run left in the device's fields counts for nothing, be it further on or somewhere else.
#[test]
fn a_state_put_in_place_goes_on_as_if_it_had_come_there() {
    let Some(_) = gpu() else { return };
    let mut simulation = dam_break();
    let start = simulation.state().unwrap();
    let (fourth, _) = run(&mut simulation, 4);
    let (eighth, _) = run(&mut simulation, 8);
    let mut go_on = |from: &State, n_frames: u64| {
        simulation.reset(from).unwrap();
        run(&mut simulation, n_frames).0
    };
    assert!(go_on(&start, 4) == fourth, "back to the start");
    assert!(go_on(&start, 8) == eighth, "and again, further");
    assert!(go_on(&fourth, 8) == eighth, "on from half the way");
    // Before the next sub-step too.
    simulation.reset(&fourth).unwrap();
    assert!(fourth.pressure.iter().any(|p| *p > 0.0));
    assert!(simulation.state().unwrap() == fourth, "as it was put in place");
    // Markers that were dropped before are not among those of the state.
    let dropped = State { markers_dropped: 7 + fourth.markers.len() as u64, ..fourth };
    simulation.reset(&dropped).unwrap();
    let liquid = simulation.step().unwrap().liquid.unwrap();
    assert_eq!(liquid.markers + liquid.dropped as usize, dropped.markers.len());
}

/// Spray on a grid as coarse as this adds volume fast; at 64x32x32 cells and 10 s the ratio stays within 3 %.
#[test]
fn volume_control_holds_a_violent_dam_break() {
    let Some(_) = gpu() else { return };
    let (state, volume) = run(&mut dam_break(), 36);
    assert!(state.markers.len() > 1000, "the liquid is still there");
    assert!(volume[0] > 0.97 && volume[1] < 1.06, "{volume:?}");
}
