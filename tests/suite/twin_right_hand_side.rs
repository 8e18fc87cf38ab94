//! `right_hand_side` against its twin.

use cutwater::gpu::{Real, Recorder};
use cutwater::reference::{self, VolumeSource, liquid_distance};
use cutwater::stages::right_hand_side;

use crate::common::gpu;
use crate::liquid_case::{ActiveBuffers, EPS, RADIUS, assert_close, cases};

#[test]
fn the_divergence_is_the_twins() {
    let Some(gpu) = gpu() else { return };
    let reals = if gpu.has_f64() { &[Real::F32, Real::F64][..] } else { &[Real::F32] };
    let mut without_surface = 0;
    for (case, sealed) in cases().iter().flat_map(|case| [(case, false), (case, true)]) {
        let grid = &case.grid;
        let (radius, markers) = (RADIUS * grid.dx, &case.state.markers);
        let phi = liquid_distance(grid, &case.cut, markers, radius);
        let mut active = ActiveBuffers::new(case, &phi);
        without_surface += active.cells.closed.len();
        if sealed {
            // As solids that give way would.
            let mut cells = active.cells;
            cells.sealed = std::mem::take(&mut cells.closed);
            active = ActiveBuffers::of(case, cells);
        }
        let open_volumes = reference::open_volumes(grid, &case.cut.solid_distance);
        for (&real, rate) in reals.iter().zip([0.0_f32, -0.17]).chain([(&reals[0], 0.2)]) {
            let buffers = case.upload(gpu);
            let solver = active.solver(gpu, real);
            let stage = right_hand_side(gpu, &buffers, None, &solver).unwrap();
            let run = || {
                gpu.upload(&buffers.velocity_next, &buffers.pad_faces(&case.state.velocity));
                gpu.upload(&buffers.report, &[0, rate.to_bits()]);
                let mut recorder = Recorder::new(gpu);
                stage.record(&mut recorder);
                recorder.submit();
                let device = solver.rhs.download(gpu).unwrap();
                buffers.padded.unpad(grid.cells, &device, |b| b)
            };
            let first = run();
            assert_eq!(first, run(), "{}: again", case.name);
            let mut rhs = first;
            // The solver takes the means out.
            for component in &active.cells.closed {
                let mean = component.iter().map(|&cell| rhs[cell]).sum::<f64>() / component.len() as f64;
                component.iter().for_each(|&cell| rhs[cell] -= mean);
            }
            let source = VolumeSource { rate: f64::from(rate), open_volumes: &open_volumes };
            let (open, u) = (&case.cut.open, &case.state.velocity);
            let twin = reference::right_hand_side(grid, open, u, &active.cells, Some(source));
            // Six products and their sum in the scalar type; dx is an f32, in V_c twice more.
            let terms = if real == Real::F32 { 12.0 * 6.0 * case.speed() } else { 1e-6 };
            let bound = EPS * (terms + 6.0 * f64::from(rate.abs()) * grid.dx);
            assert_close(
                case.name,
                (0..grid.n_cells()).map(|cell| {
                    let twin = twin.values[cell] / (grid.dx * grid.dx);
                    (rhs[cell], twin, bound, grid.cell_at(cell))
                }),
            );
        }
    }
    assert!(without_surface > 0);
}
