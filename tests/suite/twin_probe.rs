//! `probe` against its twin.

use cutwater::gpu::{Real, Recorder};
use cutwater::reference::{self, liquid_distance};
use cutwater::scene::{ProbeKind, Up};
use cutwater::stages::Probe;
use glam::DVec3;

use crate::common::{Random, gpu};
use crate::liquid_case::{ActiveBuffers, Case, DENSITY, EPS, RADIUS, assert_close, cases, single};

/// Probes at random points, also beyond the walls, every front, and fluxes through random rectangles and whole sections.
fn probes(case: &Case, random: &mut Random) -> Vec<ProbeKind> {
    let size = case.grid.size();
    let mut point = || {
        let [x, y, z] = [0, 1, 2].map(|a| single(size[a] * random.uniform(-0.1, 1.1)));
        DVec3::new(x, y, z)
    };
    let fronts = (0..6).map(|side| ProbeKind::Front { axis: side % 3, lower: side >= 3 });
    let mut probes: Vec<ProbeKind> = fronts.collect();
    for axis in 0..3 {
        for part in [0.0, 0.37, 1.0] {
            let (mut min, mut max) = (DVec3::ZERO, size);
            (min[axis], max[axis]) = (single(part * size[axis]), single(part * size[axis]));
            probes.push(ProbeKind::Flux { axis, min, max });
        }
    }
    for axis in [0, 1, 2, 0, 1, 2] {
        let [a, b] = [point(), point()].map(|point| point.clamp(DVec3::ZERO, size));
        let (min, mut max) = (a.min(b), a.max(b));
        max[axis] = min[axis];
        probes.push(ProbeKind::Flux { axis, min, max });
    }
    for _ in 0..30 {
        let foot = point();
        probes.push(ProbeKind::Velocity { point: point() });
        let up = Up { axis: probes.len() % 3, falling: probes.len().is_multiple_of(2) };
        probes.push(ProbeKind::Height { foot, up });
        probes.push(ProbeKind::Pressure { point: point() });
    }
    probes
}

#[test]
fn probes_read_what_they_read_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    let real = if gpu.has_f64() { Real::F64 } else { Real::F32 };
    for mut case in cases() {
        let grid = case.grid;
        let (radius, markers) = (RADIUS * grid.dx, &case.state.markers);
        case.state.liquid_distance =
            liquid_distance(&grid, &case.cut, markers, radius).into_iter().map(single).collect();
        let active = ActiveBuffers::new(&case, &case.state.liquid_distance);
        case.state.active = active.cells.stencil.active_mask();
        let mut random = Random(11);
        let potential: Vec<f64> = (0..grid.n_cells()).map(|_| single(random.uniform(-0.2, 0.2))).collect();
        let pascal = DENSITY * grid.dx / case.dt;
        case.state.pressure = (0..grid.n_cells())
            .map(|cell| f64::from(u8::from(case.state.active[cell])) * pascal * potential[cell])
            .collect();
        let probes = probes(&case, &mut random);
        let buffers = case.upload(gpu);
        let solver = active.solver(gpu, real);
        solver.potential.upload(gpu, &buffers.padded.pad(grid.cells, &potential, |phi| phi));
        let stage = Probe::new(gpu, &buffers, &solver, &probes).unwrap();
        let run = || {
            let mut recorder = Recorder::new(gpu);
            stage.record(&mut recorder);
            recorder.submit();
            stage.columns(&gpu.download(&stage.values).unwrap())
        };
        let columns = run();
        assert_eq!(columns, run(), "{}: again", case.name);
        let mut found = columns.iter();
        // A position in cells is off by 3 roundings of its size, a weight by as much, three of them per value; the surface
        // moves with the distances over their difference, which is a tenth of dx or more where it is not said to be steep.
        let cells = 3.0 * 3.0 * case.extent() + 20.0;
        let mut pairs = Vec::new();
        for (index, probe) in probes.iter().enumerate() {
            let scale = match probe {
                ProbeKind::Front { .. } => grid.size().max_element() + grid.dx,
                ProbeKind::Height { .. } => 40.0 * grid.dx + grid.size().max_element(),
                // Weights that are left out can leave little weight.
                ProbeKind::Pressure { .. } => 10.0 * 0.2 * pascal,
                ProbeKind::Velocity { .. } => 2.0 * case.speed(),
                // As velocities, over the wet area; and the wet part changes by phi / dx.
                ProbeKind::Flux { axis, min, max } => {
                    let sides = *max - *min + 2.0 * grid.dx;
                    let area = sides[(axis + 1) % 3] * sides[(axis + 2) % 3];
                    4.0 * case.speed() * area
                }
                kind => unreachable!("liquid alone: {kind:?}"),
            };
            for twin in reference::probe(&grid, &case.cut.open, &case.state, probe) {
                let gpu = *found.next().expect("a column per value");
                pairs.push((gpu, twin, EPS * cells * scale, [index, 0, 0]));
            }
        }
        assert_eq!(found.next(), None, "{}: columns", case.name);
        assert_close(case.name, pairs);
    }
}
