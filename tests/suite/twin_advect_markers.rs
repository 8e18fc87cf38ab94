//! `advect_markers` against its twin.

use cutwater::gpu::{Gpu, Recorder};
use cutwater::measure::bounds::trace_error;
use cutwater::reference;
use cutwater::stages::{AdvectMarkers, LiquidBuffers};

use crate::common::gpu;
use crate::liquid_case::{Case, EPS, assert_close, cases};

/// Markers after the stage, and the number dropped.
fn advected(
    gpu: &Gpu,
    case: &Case,
    buffers: &LiquidBuffers,
    stage: &AdvectMarkers,
) -> (Vec<[f32; 4]>, u32) {
    case.write(gpu, buffers);
    let mut recorder = Recorder::new(gpu);
    stage.record(&mut recorder);
    recorder.submit();
    let markers = gpu
        .download(&buffers.markers.as_ref().unwrap().positions)
        .unwrap();
    let report = gpu.download(&buffers.report).unwrap();
    (markers, report[0])
}

/// Where the twin puts a marker; `None` when it drops it.
fn twin(case: &Case, marker: [f64; 3]) -> Option<[f64; 3]> {
    let distance = &case.cut.solid_distance;
    let (kept, _) = reference::advect_markers(
        &case.grid,
        &case.state.velocity,
        distance,
        &[marker],
        case.dt,
    );
    kept.first().copied()
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
        let (markers, dropped) = advected(gpu, &case, &buffers, &stage);
        let bound = bound(&case);
        let mut pairs = Vec::new();
        let mut n_dropped = 0;
        let mut n_unsteady = 0;
        for (index, (marker, &start)) in markers.iter().zip(&case.state.markers).enumerate() {
            let end = twin(&case, start);
            // Where the gradient of the distance jumps, or its sign decides, a rounding decides: such markers show in the twin.
            let shifted = [1.0, -1.0].map(|side| twin(&case, start.map(|x| x + side * bound)));
            let steady = shifted.iter().all(|other| match (other, &end) {
                (Some(a), Some(b)) => (0..3).all(|c| (a[c] - b[c]).abs() < 100.0 * bound),
                (a, b) => a.is_none() && b.is_none(),
            });
            if !steady {
                n_unsteady += 1;
                n_dropped += u32::from(marker[3] == 0.0);
                continue;
            }
            assert_eq!(marker[3] == 1.0, end.is_some(), "{}: alive", case.name);
            match end {
                Some(end) => pairs
                    .extend((0..3).map(|a| (f64::from(marker[a]), end[a], bound, [index, a, 0]))),
                None => n_dropped += 1,
            }
        }
        assert_eq!(dropped, n_dropped, "{}: markers dropped", case.name);
        assert!(
            50 * n_unsteady <= markers.len(),
            "{}: {n_unsteady} of {} markers hang on a rounding",
            case.name,
            markers.len()
        );
        assert_close(case.name, pairs);
        assert_eq!(
            (markers, dropped),
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
    assert_eq!(state.markers_dropped, n as u64, "reported");
}
