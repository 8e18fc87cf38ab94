//! `advect_markers` against its twin.

use cutwater::fields::{LiquidBuffers, Report};
use cutwater::gpu::{Dispatches, Gpu, Recorder};
use cutwater::measure::bounds::MarkerError;
use cutwater::reference::{self, Lost, Surface};
use cutwater::stages::advect_markers;

use crate::common::{Random, gpu};
use crate::liquid_case::{Case, EPS, RADIUS, assert_close, cases, single};

/// Markers after the stage, and what is lost of them.
fn advected(gpu: &Gpu, case: &Case, buffers: &LiquidBuffers, stage: &Dispatches) -> (Vec<[f32; 4]>, Lost) {
    case.write(gpu, buffers);
    let mut recorder = Recorder::new(gpu);
    stage.record(&mut recorder);
    recorder.submit();
    let markers = gpu.download(buffers.markers.as_ref().unwrap()).unwrap();
    let report = gpu.download(&buffers.report).unwrap();
    let dropped = report[Report::DROPPED].into();
    let left = report.get(Report::LEAVING).copied().unwrap_or(0).into();
    (markers, Lost { dropped, left })
}

/// The cases with the liquid where their markers are.
fn filled_cases() -> Vec<Case> {
    let mut cases = cases();
    for case in &mut cases {
        let radius = RADIUS * case.grid.dx;
        let phi = reference::liquid_distance(&case.grid, &case.cut, &case.state.markers, radius);
        case.state.liquid_distance = phi.into_iter().map(single).collect();
    }
    cases
}

/// The distance to the surface, m.
fn surface_distance(case: &Case) -> Vec<f64> {
    reference::surface_distance(&case.grid, &case.cut.solid_distance, &case.state.liquid_distance)
}

fn surface<'a>(case: &Case, distance: &'a [f64]) -> Surface<'a> {
    Surface { distance, radius: RADIUS * case.grid.dx }
}

/// Where the twin puts a marker; otherwise how it is lost.
fn twin(case: &Case, surface: &Surface, marker: [f64; 3]) -> Result<[f64; 3], Lost> {
    let distance = &case.cut.solid_distance;
    let (kept, lost) = reference::advect_markers(
        &case.grid,
        case.sides,
        &case.state.velocity,
        distance,
        surface,
        &case.ballistic(),
        &[marker],
        case.dt,
    );
    kept.first().copied().ok_or(lost)
}

/// Push-out moves by the distance's error and turns by the normal's.
fn push_error(case: &Case) -> f64 {
    EPS * 3.0 * 64.0 * case.grid.dx * f64::from(u8::from(case.effects.obstacles))
}

#[test]
fn markers_move_as_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    let falling = filled_cases().into_iter().map(Case::with_ballistic);
    for case in filled_cases().into_iter().chain(falling) {
        let distance = surface_distance(&case);
        let surface = surface(&case, &distance);
        let buffers = case.upload(gpu);
        let stage = advect_markers(gpu, &buffers, &case.solved(gpu), None).unwrap();
        let (markers, lost) = advected(gpu, &case, &buffers, &stage);
        let error = MarkerError::new(&case.grid, &case.state.velocity, surface, case.dt);
        let mut pairs = Vec::new();
        let mut expected = Lost::default();
        let mut n_unsteady = 0;
        let mut n_unsteady_lost = 0;
        for (index, (marker, &start)) in markers.iter().zip(&case.state.markers).enumerate() {
            let end = twin(&case, &surface, start);
            let bound = error.at(start.into()) + push_error(&case);
            // Where the gradient of the distance jumps, or its sign decides, a rounding decides: such markers show in the twin.
            let shifted = [1.0, -1.0].map(|side| twin(&case, &surface, start.map(|x| x + side * bound)));
            let steady = shifted.iter().all(|other| match (other, &end) {
                (Ok(a), Ok(b)) => (0..3).all(|c| (a[c] - b[c]).abs() < 100.0 * bound),
                (a, b) => a.is_err() && a == b,
            });
            if !steady {
                n_unsteady += 1;
                n_unsteady_lost += u64::from(marker[3] == 0.0);
                continue;
            }
            assert_eq!(marker[3] == 1.0, end.is_ok(), "{}: alive", case.name);
            match end {
                Ok(end) => pairs.extend((0..3).map(|a| (f64::from(marker[a]), end[a], bound, [index, a, 0]))),
                Err(lost) => {
                    expected.dropped += lost.dropped;
                    expected.left += lost.left;
                }
            }
        }
        // How one is lost that hangs on a rounding is not known.
        let more = [lost.dropped - expected.dropped, lost.left - expected.left];
        assert_eq!(more.iter().sum::<u64>(), n_unsteady_lost, "{}: markers lost", case.name);
        assert!(case.sides.any() || lost.left == 0, "{}: left a closed domain", case.name);
        assert!(
            50 * n_unsteady <= markers.len(),
            "{}: {n_unsteady} of {} markers hang on a rounding",
            case.name,
            markers.len()
        );
        assert_close(case.name, pairs);
        assert_eq!((markers, lost), advected(gpu, &case, &buffers, &stage), "{}: again", case.name);
    }
}

#[test]
fn the_surface_is_where_the_twin_has_it() {
    let Some(gpu) = gpu() else { return };
    for case in filled_cases() {
        let buffers = case.upload(gpu);
        let stage = advect_markers(gpu, &buffers, &case.solved(gpu), None).unwrap();
        let (grid, padded) = (case.grid, buffers.padded);
        // A difference of numbers up to 4 dx, one of which is a product with a root that may be off by four roundings.
        let bound = 6.0 * EPS * 4.0 * grid.dx;
        let check = |case: &Case| {
            advected(gpu, case, &buffers, &stage);
            let stored = gpu.download(&buffers.velocity_next).unwrap();
            let twin = surface_distance(case);
            let pairs = twin.iter().enumerate().map(|(cell, &twin)| {
                let ijk = grid.cell_at(cell);
                (stored[padded.index(ijk)].into(), twin, bound, ijk)
            });
            assert_close(case.name, pairs);
        };
        check(&case);
        // The worst liquid: some of it anywhere.
        let mut random = Random(5);
        let mut rough = case;
        for phi in &mut rough.state.liquid_distance {
            *phi = single(grid.dx * random.uniform(-1.0, 1.2));
        }
        check(&rough);
    }
}

#[test]
fn dropped_markers_stay_dropped() {
    let Some(gpu) = gpu() else { return };
    let case = cases().into_iter().find(|case| case.name == "all solid").unwrap();
    let buffers = case.upload(gpu);
    let stage = advect_markers(gpu, &buffers, &case.solved(gpu), None).unwrap();
    let mut recorder = Recorder::new(gpu);
    stage.record(&mut recorder);
    stage.record(&mut recorder);
    recorder.submit();
    let n = case.state.markers.len();
    assert_eq!(gpu.download(&buffers.report).unwrap()[0] as usize, n, "counted once");
    let mut state = case.state.clone();
    buffers.read_state(gpu, n, &mut state).unwrap();
    assert!(state.markers.is_empty(), "left in the state");
}
