//! `advect_markers` against its twin.

use cutwater::gpu::{Gpu, Recorder};
use cutwater::measure::bounds::trace_error;
use cutwater::reference::{self, Lost};
use cutwater::stages::{AdvectMarkers, LiquidBuffers, Report};

use crate::common::gpu;
use crate::liquid_case::{Case, EPS, assert_close, cases};

/// Markers after the stage, and what is lost of them.
fn advected(
    gpu: &Gpu,
    case: &Case,
    buffers: &LiquidBuffers,
    stage: &AdvectMarkers,
) -> (Vec<[f32; 4]>, Lost) {
    case.write(gpu, buffers);
    let mut recorder = Recorder::new(gpu);
    stage.record(&mut recorder);
    recorder.submit();
    let markers = gpu
        .download(&buffers.markers.as_ref().unwrap().positions)
        .unwrap();
    let report = gpu.download(&buffers.report).unwrap();
    let dropped = report[Report::DROPPED].into();
    let left = report.get(Report::LEAVING).copied().unwrap_or(0).into();
    (markers, Lost { dropped, left })
}

/// Where the twin puts a marker; otherwise how it is lost.
fn twin(case: &Case, marker: [f64; 3]) -> Result<[f64; 3], Lost> {
    let distance = &case.cut.solid_distance;
    let (kept, lost) = reference::advect_markers(
        &case.grid,
        case.sides,
        &case.state.velocity,
        distance,
        &[marker],
        case.dt,
    );
    kept.first().copied().ok_or(lost)
}

/// Push-out moves by the distance's error and turns by the normal's.
fn bound(case: &Case) -> f64 {
    let pushed = 3.0 * 64.0 * case.grid.dx * f64::from(u8::from(case.effects.obstacles));
    let trace = trace_error(&case.grid, &case.state.velocity, case.dt);
    trace.cells * case.grid.dx + EPS * pushed
}

#[test]
fn markers_move_as_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    for case in cases() {
        let buffers = case.upload(gpu);
        let stage = AdvectMarkers::new(gpu, &buffers).unwrap();
        let (markers, lost) = advected(gpu, &case, &buffers, &stage);
        let bound = bound(&case);
        let mut pairs = Vec::new();
        let mut expected = Lost::default();
        let mut n_unsteady = 0;
        let mut n_unsteady_lost = 0;
        for (index, (marker, &start)) in markers.iter().zip(&case.state.markers).enumerate() {
            let end = twin(&case, start);
            // Where the gradient of the distance jumps, or its sign decides, a rounding decides: such markers show in the twin.
            let shifted = [1.0, -1.0].map(|side| twin(&case, start.map(|x| x + side * bound)));
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
                Ok(end) => pairs
                    .extend((0..3).map(|a| (f64::from(marker[a]), end[a], bound, [index, a, 0]))),
                Err(lost) => {
                    expected.dropped += lost.dropped;
                    expected.left += lost.left;
                }
            }
        }
        // How one is lost that hangs on a rounding is not known.
        let more = [lost.dropped - expected.dropped, lost.left - expected.left];
        assert_eq!(
            more.iter().sum::<u64>(),
            n_unsteady_lost,
            "{}: markers lost",
            case.name
        );
        assert!(
            case.sides.any() || lost.left == 0,
            "{}: left a closed domain",
            case.name
        );
        assert!(
            50 * n_unsteady <= markers.len(),
            "{}: {n_unsteady} of {} markers hang on a rounding",
            case.name,
            markers.len()
        );
        assert_close(case.name, pairs);
        assert_eq!(
            (markers, lost),
            advected(gpu, &case, &buffers, &stage),
            "{}: again",
            case.name
        );
    }
}

#[test]
fn dropped_markers_stay_dropped() {
    let Some(gpu) = gpu() else { return };
    let case = cases()
        .into_iter()
        .find(|case| case.name == "all solid")
        .unwrap();
    let buffers = case.upload(gpu);
    let stage = AdvectMarkers::new(gpu, &buffers).unwrap();
    let mut recorder = Recorder::new(gpu);
    stage.record(&mut recorder);
    stage.record(&mut recorder);
    recorder.submit();
    let n = case.state.markers.len();
    assert_eq!(
        gpu.download(&buffers.report).unwrap()[0] as usize,
        n,
        "counted once"
    );
    let mut state = case.state.clone();
    buffers.read_state(gpu, n, &mut state).unwrap();
    assert!(state.markers.is_empty(), "left in the state");
}
