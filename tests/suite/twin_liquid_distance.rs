//! `liquid_distance` against its twin, and the volume that it encloses.

use cutwater::fields::{LiquidBuffers, Report, Step};
use cutwater::gpu::{Dispatches, Gpu, Real, Recorder};
use cutwater::reference;
use cutwater::stages;

use crate::common::gpu;
use crate::liquid_case::{Case, DENSITY, EPS, GRAVITY, RADIUS, assert_close, cases, single};

/// The stage after the band, on one set of buffers.
struct Run<'a> {
    gpu: &'a Gpu,
    case: &'a Case,
    volume_0: f64,
    buffers: LiquidBuffers,
    band: Dispatches,
    stage: Dispatches,
}

impl Run<'_> {
    fn new<'a>(gpu: &'a Gpu, case: &'a Case) -> Run<'a> {
        let buffers = case.upload(gpu);
        Run {
            gpu,
            case,
            volume_0: single(0.7 * case.grid.size().element_product()),
            band: stages::band(gpu, &buffers, None).unwrap(),
            stage: stages::liquid_distance(gpu, &buffers, None, None).unwrap(),
            buffers,
        }
    }

    /// Starts again from the state.
    fn write(&self) {
        self.case.write(self.gpu, &self.buffers);
        let step = Step { volume_0: self.volume_0 as f32, ..self.case.step() };
        self.gpu.upload(&self.buffers.step, &[step]);
    }

    /// One sub-step; the bits that it leaves.
    fn record(&self) -> Vec<u32> {
        let mut recorder = Recorder::new(self.gpu);
        self.band.record(&mut recorder);
        self.stage.record(&mut recorder);
        recorder.submit();
        let phi = self.gpu.download(&self.buffers.liquid_distance).unwrap();
        let report = self.gpu.download(&self.buffers.report).unwrap();
        phi.into_iter().map(f32::to_bits).chain(report).collect()
    }
}

#[test]
fn the_liquid_lies_where_it_lies_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    for case in cases() {
        let grid = &case.grid;
        let run = Run::new(gpu, &case);
        run.write();
        let first = run.record();
        let in_band = case.in_band(gpu, &run.buffers);
        let padded = gpu.download(&run.buffers.liquid_distance).unwrap();
        let phi = run.buffers.padded.unpad(grid.cells, &padded, f64::from);
        let radius = single(RADIUS) * grid.dx;
        let twin = reference::liquid_distance(grid, &case.cut, &case.state.markers, radius);
        // A position in cells is off by its size times 3 roundings per axis; root, product and difference add a few.
        let outside = EPS * grid.dx * (3.0 * 3.0 * case.extent() + 14.0);
        // A pass into solids takes values up to 1.2 dx with coefficients whose magnitudes add up to less than 3, a slope being made of
        // differences: it triples what they are off by. Sums over up to 30 pairs and 6 neighbours add 110 roundings.
        let pass = |off: f64| 3.0 * off + 110.0 * EPS * grid.dx;
        let in_solid = pass(pass(pass(outside)));
        let far = |cell: usize| {
            assert!(twin[cell] > 0.0, "{}: liquid outside the band", case.name);
            grid.dx
        };
        assert_close(
            case.name,
            (0..grid.n_cells()).map(|cell| {
                let ijk = grid.cell_at(cell);
                let twin = if in_band(ijk) { twin[cell] } else { far(cell) };
                let solid = case.cut.solid_distance[cell] < 0.0;
                (phi[cell], twin, if solid { in_solid } else { outside }, ijk)
            }),
        );
        let liquid = padded.iter().filter(|&&phi| phi < 0.0).count();
        let cells = phi.iter().filter(|&&phi| phi < 0.0).count();
        assert_eq!(liquid, cells, "{}: liquid in spare cells", case.name);
        check_volume(&run, &phi);
        // Again from the start, and again from what the stage left behind.
        run.write();
        for time in [1, 2] {
            assert!(first == run.record(), "{}: run {time} after", case.name);
        }
    }
}

/// The volume that phi (m) encloses, the rate at which it should change, the potential energy.
fn check_volume(run: &Run, phi: &[f64]) {
    let (case, grid) = (run.case, &run.case.grid);
    let report = Report::from_words(&run.gpu.download(&run.buffers.report).unwrap());
    let open = reference::open_volumes(grid, &case.cut.solid_distance);
    let volume = reference::liquid_volume(grid, &open, phi);
    // dx is an f32 (cubed, and divided by twice); sums in f32 add about one rounding per level of the tree and share.
    let deep = if run.buffers.partials.real == Real::F32 { 64.0 } else { 0.0 };
    let whole = grid.size().element_product();
    let bound = EPS * (6.0 + deep) * whole;
    let rate = reference::volume_rate(run.volume_0, volume, 1.0, case.dt);
    let energy: f64 = (0..grid.n_cells())
        .map(|cell| {
            let volume = open[cell] * (0.5 - phi[cell] / grid.dx).clamp(0.0, 1.0);
            let at = grid.cell_centre(grid.cell_at(cell));
            -DENSITY * volume * glam::DVec3::from(GRAVITY).dot(at)
        })
        .sum();
    let diagnosis = report.diagnosis;
    // (V_0/V - 1) is off by the errors of V_0/V, over half the control time at least.
    let ratio = run.volume_0 / volume.max(bound);
    let rate_bound = 48.0 * ratio * (8.0 * EPS + bound / volume.max(bound));
    let energy_bound = 10.5 * DENSITY * 2.0 * bound * grid.size().max_element();
    assert_close(
        case.name,
        [
            (diagnosis.volume, volume, bound, [0; 3]),
            (report.volume_rate, rate, rate_bound, [1, 0, 0]),
            (diagnosis.potential_energy, energy, energy_bound, [2, 0, 0]),
        ],
    );
}
