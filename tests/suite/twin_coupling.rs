//! Kernels between liquid and solids, each by itself, against their twins: which components solids seal, what prescribed nodes take up of
//! those they leave closed, what pushes nodes, and what pressure does within cells.
//!
//! The patches are random, and uglier than those of any solid: of many triangles in one cell, thin as 1e-8 of a face, with corners that
//! take no part, along an axis, in air, and none at all.

use cutwater::elastic::Solids;
use cutwater::fields::{
    CouplingBuffers, CouplingReport, CouplingSize, Pair, SolidBuffers, SolidPlan, SolidRows, SolidSystemBuffers,
};
use cutwater::geometry::{Coupling, Patch};
use cutwater::gpu::{Gpu, Real, Recorder};
use cutwater::reference::{ActiveCells, patch_pressure, pressure_gradient};
use cutwater::scene::{Precision, Solver};
use cutwater::stages::{OpenFaces, PatchPressure, Seal};
use glam::{DMat3, DVec3};

use crate::common::{Random, gpu};
use crate::components::assert_labels;
use crate::coupled_case::pairs;
use crate::liquid_case::{EPS, assert_close, single};
use crate::solid_case::{RUBBER, eps, lattice, solids};
use crate::solver::{Case, Device};

/// kg/m^3
const DENSITY: f64 = 1000.0;

/// A liquid, solids, and patches between them.
struct Joint {
    name: String,
    case: Case,
    solids: Solids,
    triangles: Vec<[u32; 3]>,
    patches: Vec<Patch>,
    /// s
    dt: f64,
}

impl Joint {
    /// Patches in about this share of the cells. Of the nodes a third are prescribed, a third are rollers.
    fn new(name: String, case: Case, share: f64, seed: u64) -> Joint {
        let mut random = Random(seed);
        let parts = [0.2, 0.5].map(|low| {
            let size = DVec3::new(0.3, 0.2, 0.4);
            (lattice(DVec3::splat(low), size, [3, 2, 4]), RUBBER)
        });
        let mut solids = solids(&parts);
        let n = solids.rest.len();
        for prescribed in &mut solids.prescribed {
            *prescribed = match random.uniform(0.0, 3.0) {
                kind if kind < 1.0 => [true; 3],
                kind if kind < 2.0 => [0, 1, 2].map(|_| random.uniform(0.0, 1.0) < 0.7),
                _ => [false; 3],
            };
        }
        let node = |random: &mut Random| random.uniform(0.0, n as f64) as u32;
        let triangles: Vec<[u32; 3]> = (0..4 * n)
            .map(|_| {
                loop {
                    let corners = [0, 1, 2].map(|_| node(&mut random));
                    let [a, b, c] = corners;
                    if a != b && b != c && c != a {
                        return corners;
                    }
                }
            })
            .collect();
        let grid = case.grid;
        let mut patches = Vec::new();
        for cell in 0..grid.n_cells() {
            if random.uniform(0.0, 1.0) >= share {
                continue;
            }
            for _ in 0..1 + random.uniform(0.0, 3.0) as usize {
                let triangle = random.uniform(0.0, triangles.len() as f64) as usize;
                patches.push(patch(&mut random, &case, cell, triangle));
            }
        }
        Joint { name, case, solids, triangles, patches, dt: single(0.0125) }
    }

    /// J.
    fn coupling(&self) -> Coupling {
        Coupling::new(&self.patches, &self.triangles, self.solids.rest.len())
    }

    /// The unknowns, with the components that solids seal taken out of the closed ones.
    fn active(&self) -> ActiveCells {
        let mut active = self.case.twin();
        active.seal(&self.coupling(), &self.solids.prescribed);
        active
    }

    /// Pressure of a potential of 1 m/s over an area of dx^2, kg/s, and over nothing, Pa.
    fn units(&self) -> [f64; 2] {
        let dx = self.case.grid.dx;
        [dx * dx, 1.0].map(|area| area * DENSITY * dx / self.dt)
    }
}

/// A random one in a cell.
fn patch(random: &mut Random, case: &Case, cell: usize, triangle: usize) -> Patch {
    let grid = &case.grid;
    let vector = |random: &mut Random| DVec3::from([0, 1, 2].map(|_| random.uniform(-1.0, 1.0)));
    let normal = match random.uniform(0.0, 1.0) {
        kind if kind < 0.3 => DVec3::AXES[random.uniform(0.0, 3.0) as usize],
        _ => vector(random).normalize(),
    };
    let weights = [0, 1, 2].map(|_| random.uniform(-0.3, 1.0).max(0.0));
    let sum: f64 = weights.iter().sum();
    let barycentric = match sum > 0.0 {
        true => weights.map(|weight| weight / sum),
        false => [0.0, 1.0, 0.0],
    };
    let area = grid.dx.powi(2) * 10_f64.powf(random.uniform(-8.0, 0.3));
    let [a, b] = [0, 1].map(|_| 0.1 * area * grid.dx * vector(random));
    Patch {
        cell,
        triangle,
        area,
        normal,
        centroid: grid.cell_centre(grid.cell_at(cell)) + 0.5 * grid.dx * vector(random),
        barycentric,
        moments: [a, b, -(a + b)],
    }
}

/// Random patterns of narrow and closed faces, from clusters at the percolation threshold to droplets, and named ones.
fn joints() -> Vec<Joint> {
    let full = |_: [usize; 3]| true;
    let mut joints = Vec::new();
    for (seed, (cells, blocked, air, share)) in [
        ([13, 7, 9], 0.75, 0.0, 0.1),
        ([13, 7, 9], 0.75, 0.01, 0.4),
        ([16, 16, 16], 0.7, 0.0, 0.03),
        ([3, 30, 7], 0.0, 0.8, 0.5),
        ([5, 3, 2], 0.3, 0.2, 1.0),
    ]
    .into_iter()
    .enumerate()
    {
        let value = |salt: u64, at: [usize; 3]| {
            let [i, j, k] = at.map(|n| n as u64);
            let mut random = Random(seed as u64 + 7 * (salt + 4 * (i + 100 * (j + 100 * k))));
            random.bits();
            random.uniform(0.0, 1.0)
        };
        let case = Case::new(cells, |at| value(3, at) >= air).narrow(|axis, at| {
            let open = value(axis.index() as u64, at);
            if open < blocked { 0.0 } else { open }
        });
        let name = format!("{cells:?}, {blocked} blocked, {air} air");
        joints.push(Joint::new(name, case, share, seed as u64));
    }
    let dominoes =
        || Case::new([10, 10, 10], full).narrow(|axis, [_, j, _]| f64::from(u8::from(axis.index() == 1 && j % 2 == 1)));
    joints.push(Joint::new("dominoes".into(), dominoes(), 0.3, 11));
    joints.push(Joint::new("no patches".into(), dominoes(), 0.0, 12));
    let tank = Case::new([9, 10, 11], full);
    let mut held = Joint::new("a tank with solids that are held".into(), tank, 0.4, 13);
    held.solids.prescribed.fill([true; 3]);
    joints.push(held);
    // Rollers along x, and patches across y and z: nothing gives way.
    let slabs = Case::new([10, 9, 8], full).narrow(|axis, _| f64::from(u8::from(axis.index() < 2)));
    let mut rolling = Joint::new("slabs with rollers".into(), slabs, 0.2, 14);
    rolling.solids.prescribed.fill([false, true, true]);
    for (number, patch) in rolling.patches.iter_mut().enumerate() {
        // But in one slab of eight.
        if patch.cell >= 90 {
            patch.normal = DVec3::AXES[1 + number % 2];
        }
    }
    joints.push(rolling);
    joints
}

/// A joint on the device, with the unknowns found.
struct OnDevice<'a> {
    gpu: &'a Gpu,
    liquid: Device<'a>,
    fields: SolidBuffers,
    solids: SolidSystemBuffers,
    coupling: CouplingBuffers,
    pairs: Vec<Pair>,
    seal: Seal,
}

impl<'a> OnDevice<'a> {
    fn new(gpu: &'a Gpu, joint: &Joint, precision: Precision) -> OnDevice<'a> {
        let solver = Solver { precision, ..Solver::default() };
        let liquid = Device::holding(gpu, &joint.case, &solver);
        let grid = joint.case.grid;
        let rows = SolidRows::new(&joint.solids).unwrap();
        let solids = SolidSystemBuffers::new(gpu, &rows, &solver).unwrap();
        let plan = SolidPlan::new(grid, &joint.solids, liquid.buffers.variant.real);
        let fields = SolidBuffers::new(gpu, plan, &joint.solids).unwrap();
        let pairs = pairs(&grid, &joint.coupling());
        let size = CouplingSize { quads: pairs.len().max(1), pairs: pairs.len().max(1) };
        let mut coupling = CouplingBuffers::new(gpu, &liquid.buffers, &solids, size).unwrap();
        coupling.write(gpu, &pairs, joint.units()[0]).unwrap();
        let seal = {
            let of_nodes = (&fields.flags, &fields.velocity);
            Seal::new(gpu, &liquid.buffers, of_nodes, &coupling)
        }
        .unwrap();
        let device = OnDevice { gpu, liquid, fields, solids, coupling, pairs, seal };
        device.liquid.prepare_sealed(Some(&device.seal)).submit();
        device
    }

    fn real(&self) -> Real {
        self.liquid.buffers.variant.real
    }
}

fn precisions(gpu: &Gpu) -> Vec<Precision> {
    match gpu.has_f64() {
        true => vec![Precision::F32, Precision::Mixed],
        false => vec![Precision::F32],
    }
}

/// Numbers that are f32.
fn noise(random: &mut Random, n: usize) -> Vec<f64> {
    (0..n).map(|_| single(random.uniform(-1.0, 1.0))).collect()
}

/// The nodes' first three of four numbers.
fn vectors(quads: &[f64]) -> impl Iterator<Item = DVec3> {
    quads.chunks_exact(4).map(DVec3::from_slice)
}

/// Labels, flags and their number are exact.
#[test]
fn sealed_components_are_the_twins() {
    let Some(gpu) = gpu() else { return };
    let (mut closed, mut sealed) = (0, 0);
    for joint in joints() {
        let device = OnDevice::new(gpu, &joint, Precision::F32);
        let active = joint.active();
        assert_labels(&device.liquid, &joint.name, &joint.case, &active);
        let mut cells = joint.patches.iter().map(|patch| patch.cell);
        let touching = cells.any(|cell| active.stencil.active(cell));
        let words = gpu.download(&device.coupling.report).unwrap();
        let told = CouplingReport::from_words(&words).touching;
        assert_eq!(told, touching, "{}: touching", joint.name);
        closed += active.closed.len();
        sealed += active.sealed.len();
        match &joint.name[..] {
            "no patches" => assert_eq!(active.closed.len(), 500),
            "a tank with solids that are held" => assert_eq!(active.closed.len(), 1),
            "slabs with rollers" => assert_eq!([active.closed.len(), active.sealed.len()], [7, 1]),
            _ => {}
        }
    }
    assert!(closed > 700 && sealed > 100, "{closed} and {sealed}");
}

/// b - J v in closed components, b elsewhere. J is rounded once, and the sum once per pair, product and sum of three.
#[test]
fn what_prescribed_nodes_take_up_is_the_twins() {
    let Some(gpu) = gpu() else { return };
    let mut n_changed = 0;
    for joint in joints() {
        for precision in precisions(gpu) {
            let device = OnDevice::new(gpu, &joint, precision);
            let (grid, eps) = (&joint.case.grid, eps(device.real()));
            let padded = grid.padded();
            let mut random = Random(21);
            let b = noise(&mut random, grid.n_cells());
            let v = noise(&mut random, 4 * joint.solids.rest.len());
            let rhs = &device.liquid.buffers.rhs;
            rhs.upload(gpu, &padded.pad(grid.cells, &b, |b| b));
            device.fields.velocity.upload(gpu, &v);
            let mut recorder = Recorder::new(gpu);
            recorder.stage("closed_components", |pass| device.seal.record_close(pass));
            recorder.submit();
            let found = device.liquid.cells(rhs);
            let (mut twin, mut bound) = (b.clone(), vec![0.0; b.len()]);
            let coupling = joint.coupling();
            for &cell in joint.active().closed.iter().flatten() {
                let pairs = coupling.cell_pairs(cell);
                let of_node = |node: usize| DVec3::from_slice(&v[4 * node..]);
                let values = || pairs.iter().map(|pair| (pair.value / grid.dx.powi(2), pair.node));
                twin[cell] -= values().map(|(j, node)| j.dot(of_node(node))).sum::<f64>();
                let gross: f64 = values().map(|(j, node)| j.abs().dot(of_node(node).abs())).sum();
                bound[cell] = gross * (EPS + eps * (pairs.len() as f64 + 4.0)) + eps * twin[cell].abs();
                n_changed += usize::from(gross > 0.0);
            }
            let name = format!("{}, {precision:?}", joint.name);
            let cells = (0..b.len()).map(|at| (found[at], twin[at], bound[at], grid.cell_at(at)));
            assert_close(&name, cells);
        }
    }
    assert!(n_changed > 100, "{n_changed}");
}

/// F + J^T p, with a rounding of J, of the mass of a cell and of every sum.
#[test]
fn what_pushes_nodes_is_the_twins() {
    let Some(gpu) = gpu() else { return };
    for joint in joints() {
        for precision in precisions(gpu) {
            let device = OnDevice::new(gpu, &joint, precision);
            let (grid, eps, n) = (&joint.case.grid, eps(device.real()), joint.solids.rest.len());
            let mut random = Random(22);
            let potential = noise(&mut random, grid.n_cells());
            let forces = noise(&mut random, 4 * n);
            let buffers = &device.liquid.buffers;
            let padded = grid.padded().pad(grid.cells, &potential, |phi| phi);
            buffers.potential.upload(gpu, &padded);
            device.solids.rhs.upload(gpu, &forces);
            let pushed = cutwater::gpu::RealBuffer::new(gpu, "test.pushed", 4 * n, device.real());
            let pushed = pushed.unwrap();
            let bound = cutwater::gpu::Kernel::new(gpu, &cutwater::wgsl!("couple_push"), device.real())
                .unwrap()
                .bind(
                    gpu,
                    &[
                        ("coupling", (&device.coupling.coupling).into()),
                        ("words", (&device.coupling.words).into()),
                        ("node_pairs", (&device.coupling.node_pairs).into()),
                        ("flags", (&buffers.flags).into()),
                        ("p", (&buffers.potential).into()),
                        ("rhs", (&device.solids.rhs).into()),
                        ("pushed", (&pushed).into()),
                    ],
                    &[],
                )
                .unwrap();
            let mut recorder = Recorder::new(gpu);
            recorder.stage("solve", |pass| pass.dispatch(&bound, n));
            recorder.submit();
            let found = pushed.download(gpu).unwrap();
            let stencil = joint.case.twin().stencil;
            let pascal = joint.units()[1];
            let coupling = joint.coupling();
            let name = format!("{}, {precision:?}", joint.name);
            let of_nodes = vectors(&forces).zip(vectors(&found)).enumerate();
            assert_close(
                &name,
                of_nodes.flat_map(|(node, (force, found))| {
                    let pairs = coupling.node_pairs(node).iter();
                    let pairs = pairs.filter(|pair| stencil.active(pair.cell));
                    let terms = pairs.map(|pair| pascal * potential[pair.cell] * pair.value);
                    let terms: Vec<DVec3> = terms.collect();
                    let twin = force + terms.iter().sum::<DVec3>();
                    let gross: DVec3 = terms.iter().map(|term| term.abs()).sum();
                    let roundings = 2.0 * EPS + eps * (terms.len() as f64 + 4.0);
                    let bound = roundings * gross + eps * (force.abs() + twin.abs());
                    (0..3).map(move |a| (found[a], twin[a], bound[a], [node, a, 0]))
                }),
            );
        }
    }
}

/// The gradients of the last pressure, and what they, or that of liquid at rest, do to the nodes.
#[test]
fn pressure_within_cells_acts_as_the_twins() {
    let Some(gpu) = gpu() else { return };
    let at_rest = DVec3::new(500.0, -9750.0, 250.0);
    for joint in joints() {
        for precision in precisions(gpu) {
            let device = OnDevice::new(gpu, &joint, precision);
            for follows in [false, true] {
                let name = format!("{}, {precision:?}, {follows}", joint.name);
                within_cells(&device, &joint, &name, at_rest, follows);
            }
        }
    }
}

fn within_cells(device: &OnDevice, joint: &Joint, name: &str, at_rest: DVec3, follows: bool) {
    let OnDevice { gpu, liquid, .. } = device;
    let (grid, eps, n) = (&joint.case.grid, eps(device.real()), joint.solids.rest.len());
    let (padded, buffers) = (grid.padded(), &liquid.buffers);
    let level = gpu.uniform("test.level", &padded.layout()).unwrap();
    let open = &liquid.open;
    let faces = follows.then_some(OpenFaces { level: &level, open });
    let fields = &device.fields;
    // Gravity may change after the start.
    let mut stage =
        PatchPressure::new(gpu, buffers, &device.solids, fields, &device.coupling, (2.0 * at_rest, faces)).unwrap();
    let coupling = joint.coupling();
    let moment = |patch: &Patch, corner: usize| {
        let way = patch.centroid - grid.cell_centre(grid.cell_at(patch.cell));
        let weighted = patch.barycentric[corner] * patch.area * way + patch.moments[corner];
        DMat3::from_cols(weighted.x * patch.normal, weighted.y * patch.normal, weighted.z * patch.normal)
    };
    let moments = coupling.sums(DMat3::ZERO, &joint.patches, &joint.triangles, moment);
    let scale = single(DENSITY / joint.dt);
    stage.write(gpu, &device.pairs, &moments, (at_rest, scale));
    let mut random = Random(23);
    let potential = noise(&mut random, grid.n_cells());
    let host = padded.pad(grid.cells, &potential, |phi| phi);
    buffers.potential.upload(gpu, &host);
    let mut forces = noise(&mut random, 4 * n);
    for terms in forces.iter_mut().skip(3).step_by(4) {
        *terms = terms.abs();
    }
    device.solids.rhs.upload(gpu, &forces);
    let mut recorder = Recorder::new(gpu);
    recorder.stage("clip", |pass| stage.record_slopes(pass));
    recorder.stage("right_hand_side", |pass| stage.record(pass));
    recorder.submit();

    // Two differences of potentials, their sum, half of it, to f32, and a factor.
    let stencil = joint.case.twin().stencil;
    let active: Vec<bool> = (0..grid.n_cells()).map(|cell| stencil.active(cell)).collect();
    let pressure: Vec<f64> = potential.iter().map(|phi| scale * grid.dx * phi).collect();
    let slopes = gpu.download(stage.slopes()).unwrap();
    let mut slope_of = vec![at_rest; grid.n_cells()];
    let mut quads: Vec<usize> = device.pairs.iter().map(|pair| pair.cell / 4).collect();
    quads.dedup();
    let mut found = Vec::new();
    for (wet, &quad) in quads.iter().enumerate() {
        let first = padded.cell_of(quad);
        for lane in (0..4).filter(|lane| first[0] + lane < grid.cells[0]) {
            let at = [first[0] + lane, first[1], first[2]];
            let cell = grid.cell(at);
            let slope = DVec3::from([0, 1, 2].map(|a| f64::from(slopes[4 * wet + lane][a])));
            slope_of[cell] = slope;
            let twin = match follows {
                true => pressure_gradient(grid, &joint.case.open, &active, &pressure, at_rest, cell),
                false => at_rest,
            };
            let bound = 4.0 * EPS * twin.abs() + DVec3::splat(8.0 * eps * scale);
            found.extend((0..3).map(|a| (slope[a], twin[a], bound[a], at)));
        }
    }
    assert_close(&format!("{name}: gradients"), found);

    // From the device's gradients: its integrals are f32, a product of three terms and a sum per pair.
    let twin = patch_pressure(&stencil, &joint.patches, &joint.triangles, n, |cell| slope_of[cell]).sum_over(|_| true);
    let mut gross = vec![DVec3::ZERO; n];
    let mut count = vec![0.0; n];
    for (pair, moment) in coupling.pairs().iter().zip(&moments) {
        if stencil.active(pair.cell) {
            let size = DMat3::from_cols(moment.x_axis.abs(), moment.y_axis.abs(), moment.z_axis.abs());
            gross[pair.node] += size * slope_of[pair.cell].abs();
            count[pair.node] += 1.0;
        }
    }
    let bound = |node: usize| gross[node] * (EPS + eps * (count[node] + 4.0));
    let correction = stage.correction.download(gpu).unwrap();
    let rhs = device.solids.rhs.download(gpu).unwrap();
    let mut found = Vec::new();
    for (node, correction) in vectors(&correction).enumerate() {
        let free = DVec3::from(joint.solids.prescribed[node].map(|p| f64::from(u8::from(!p))));
        let before = DVec3::from_slice(&forces[4 * node..]);
        let acts = free * twin[node];
        let after = before + acts;
        let of_rhs = free * bound(node) + eps * (before.abs() + after.abs());
        for a in 0..3 {
            found.push((correction[a], twin[node][a], bound(node)[a], [node, a, 0]));
            found.push((rhs[4 * node + a], after[a], of_rhs[a], [node, a, 1]));
        }
        let terms = forces[4 * node + 3].sqrt() + acts.length();
        let off = (free * bound(node)).length() + 8.0 * eps * terms;
        let of_terms = 2.0 * terms * off + off * off;
        found.push((rhs[4 * node + 3], terms * terms, of_terms, [node, 3, 1]));
    }
    assert_close(&format!("{name}: forces"), found);
    assert!(joint.patches.is_empty() || gross.iter().any(|g| g.length() > 0.0), "{name}");
}
