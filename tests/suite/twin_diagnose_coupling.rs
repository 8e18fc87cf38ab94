//! `diagnose`: the force of the liquid on solids against its twin.

use cutwater::fields::CouplingReport;
use cutwater::gpu::{Dispatches, Real, RealBuffer, Recorder};
use cutwater::measure::base_scene::DeviceScene;
use cutwater::reference::base_scene::{BaseBeam, BaseScene};
use cutwater::scene::{Precision, Solver};
use cutwater::stages::diagnose_coupling;
use glam::DVec3;

use crate::common::{Random, gpu};
use crate::liquid_case::EPS;

#[test]
fn forces_add_up_as_the_twins() {
    let Some(gpu) = gpu() else { return };
    let scene = BaseScene::new(12, &BaseBeam::default()).unwrap();
    let system = scene.coupled_system();
    let solver = Solver { precision: Precision::F32, ..Solver::default() };
    let device = DeviceScene::new(gpu, &scene, &system, &solver).unwrap();
    device.reset();
    device.record_systems().submit();
    let fields = device.fields();
    let grid = device.grid;
    let mut random = Random(3);
    // Also where nothing is active, which counts for nothing.
    let potential: Vec<f64> = (0..grid.n_cells()).map(|_| f64::from(random.uniform(-1.0, 1.0) as f32)).collect();
    let padded = grid.padded().pad(grid.cells, &potential, |phi| phi);
    fields.liquid.potential.upload(gpu, &padded);
    // Forces of pressure within cells, over ten decades.
    let n = fields.coupling.n_nodes;
    let forces: Vec<f64> = (0..4 * n)
        .map(|_| random.uniform(-1.0, 1.0) * 10_f64.powf(random.uniform(-6.0, 4.0)))
        .map(|force| f64::from(force as f32))
        .collect();
    let correction = RealBuffer::new(gpu, "test.correction", 4 * n, Real::F32).unwrap();
    correction.upload(gpu, &forces);
    let stage = |correction| diagnose_coupling(gpu, fields.liquid, fields.coupling, correction).unwrap();
    let run = |stage: &Dispatches| {
        let mut recorder = Recorder::new(gpu);
        stage.record(&mut recorder);
        recorder.submit();
        gpu.download(&fields.coupling.report).unwrap()
    };
    let without = CouplingReport::from_words(&run(&stage(None)));
    assert_eq!(without.correction, [0.0; 3]);
    let with_correction = stage(Some(&correction));
    let words = run(&with_correction);
    assert_eq!(words, run(&with_correction));
    let found = CouplingReport::from_words(&words);
    assert_eq!(found.force, without.force);
    // Pa per m/s of potential; the pairs of the system are those of active cells.
    let pascal = cutwater::reference::base_block::DENSITY * grid.dx / scene.dt;
    let (mut sum, mut gross) = (DVec3::ZERO, DVec3::ZERO);
    for pair in system.coupling.pairs() {
        let force = pascal * potential[pair.cell] * pair.value;
        sum += force;
        gross += force.abs();
    }
    assert!(gross.min_element() > 0.0 && sum.length() < 0.5 * gross.length());
    // Areas and the mass of a cell are f32, and so are the sums: four roundings of a term, and one per pair of a node, node of a share and
    // level of the tree.
    assert_eq!(fields.coupling.partials.real, Real::F32);
    for axis in 0..3 {
        let off = (found.force[axis] - sum[axis]).abs();
        assert!(off <= 64.0 * EPS * gross[axis], "{found:?} and {sum}");
    }
    // As many roundings of the sum of what is an f32 as it is.
    let sums = forces.chunks_exact(4).fold([DVec3::ZERO; 2], |[sum, gross], force| {
        let force = DVec3::from_slice(force);
        [sum + force, gross + force.abs()]
    });
    for axis in 0..3 {
        let off = (found.correction[axis] - sums[0][axis]).abs();
        assert!(off <= 64.0 * EPS * sums[1][axis], "{found:?} and {sums:?}");
    }
}
