//! The solids' solver on the device against the system in f64.

use std::sync::Arc;

use cutwater::elastic::{Bounds, Solids};
use cutwater::fields::{ObstacleBuffers, SolidBuffers, SolidReport, SolidRows, SolidSystemBuffers, variant};
use cutwater::geometry::RigidVelocity;
use cutwater::gpu::{Gpu, Pass, Real, RealBuffer, Recorder};
use cutwater::linalg::{LinearOperator, dot, norm};
use cutwater::reference::{self, BlockPattern, Contacts, Freedom, SolidSystem as Twin};
use cutwater::scene::{Precision, Solver};
use cutwater::solver::{ObstacleField, Outcome, Polynomial, SolidSolver, SolidSystem, rounding};
use cutwater::stages::diagnose_solid;
use cutwater::state::{SolveStatus, State};
use glam::DVec3;

use crate::common::{Random, gpu};
use crate::solid_case::{Material, RUBBER, SolidCase, cases, eps, lattice, pair, solids};

/// The twin of a case's system, from the elements that the device has, with what the device holds.
fn twin(case: &SolidCase, device: &Device) -> Twin {
    let SolidCase { solids, dt, .. } = case;
    let matrices = reference::solid_matrices(solids, &pattern(solids), &case.displacement);
    let rhs = reference::solid_right_hand_side(solids, &matrices, &case.velocity, *dt);
    let (freedom, velocity) = (device.freedom(case), device.velocity());
    let stiffness = matrices.stiffness.clone();
    Twin::new(solids, stiffness, &rhs, &velocity, freedom, *dt)
}

fn pattern(solids: &Solids) -> Arc<BlockPattern> {
    Arc::new(BlockPattern::new(solids))
}

/// The solver on the device, holding a case; its elements are those of the twin.
struct Device<'a> {
    gpu: &'a Gpu,
    fields: SolidBuffers,
    buffers: SolidSystemBuffers,
    system: SolidSystem,
    solver: SolidSolver,
    polynomial: Polynomial,
    n_nodes: usize,
    /// What it starts from.
    state: State,
    /// The distance to the obstacles.
    _obstacles: ObstacleBuffers,
}

impl<'a> Device<'a> {
    fn holding(gpu: &'a Gpu, case: &SolidCase, solver: &Solver) -> Device<'a> {
        let solids = &case.solids;
        let real = variant(gpu.has_f64(), solver.precision).real;
        let fields = case.upload(gpu, real);
        let matrices = reference::solid_matrices(solids, &pattern(solids), &case.displacement);
        let m = solids.elements.len();
        let (mut rotated, mut forces) = (vec![0.0; 12 * m], vec![0.0; 12 * m]);
        for element in 0..m {
            let body = solids.body_of_element(element);
            let volume = body.zeta_stiffness(case.dt) * solids.volume[element];
            let deformation = &matrices.deformations[element];
            let fourth = [volume * body.lambda, volume * body.mu, deformation.determinant()];
            for (section, fourth) in fourth.into_iter().enumerate() {
                let at = 4 * (section * m + element);
                let turned = deformation.rotation * solids.gradients[element][section + 1];
                rotated[at..at + 4].copy_from_slice(&turned.extend(fourth).to_array());
                let force = matrices.element_forces[element][section + 1];
                forces[at..at + 3].copy_from_slice(&force.to_array());
            }
        }
        fields.rotated.upload(gpu, &rotated);
        fields.element_forces.upload(gpu, &forces);
        let rows = SolidRows::new(solids).unwrap();
        let buffers = SolidSystemBuffers::new(gpu, &rows, solver).unwrap();
        let bounds = Bounds::new(solids);
        let degree = bounds.chebyshev_degree(solids, case.dt);
        let obstacles = ObstacleBuffers::new(gpu, &case.grid, fields.plan.obstacles).unwrap();
        obstacles.write(gpu, &case.solid_distance);
        let field =
            fields.level.as_ref().map(|level| ObstacleField { level, solid_distance: &obstacles.solid_distance });
        let device = Device {
            gpu,
            system: SolidSystem::new(gpu, &buffers, &fields, field).unwrap(),
            solver: SolidSolver::new(gpu, &buffers, &fields, solver).unwrap(),
            polynomial: Polynomial::new(degree, bounds.block_jacobi),
            fields,
            buffers,
            n_nodes: solids.rest.len(),
            state: case.state(),
            _obstacles: obstacles,
        };
        device.prepare().submit();
        device
    }

    fn prepare(&self) -> Recorder {
        let mut recorder = Recorder::new(self.gpu);
        recorder.stage("solid_matrices", |pass| self.system.record_matrices(pass));
        recorder.stage("right_hand_side", |pass| {
            self.system.record_right_hand_side(pass);
            self.system.record_contacts(pass);
        });
        recorder
    }

    /// How the nodes may move.
    fn freedom(&self, case: &SolidCase) -> Vec<Freedom> {
        let words = self.gpu.download(&self.fields.freedom).unwrap();
        let nodes = case.solids.prescribed.iter().zip(words);
        nodes
            .map(|(&prescribed, [x, y, z, flags])| {
                let components = [0, 1, 2].map(|axis| flags as u32 >> axis & 1 == 1);
                let held = DVec3::new(x.into(), y.into(), z.into()).normalize_or_zero();
                Freedom::left(prescribed, components, held)
            })
            .collect()
    }

    fn velocity(&self) -> Vec<[f64; 3]> {
        self.nodes(&self.fields.velocity)
    }

    fn nodes(&self, buffer: &RealBuffer) -> Vec<[f64; 3]> {
        nodes(&three(&buffer.download(self.gpu).unwrap()))
    }

    /// What kernels of the search for contacts make of two words when they are told a third.
    fn ask(&self, of: [u32; 2], told: u32, record: impl FnOnce(&mut Pass)) -> [u32; 2] {
        self.gpu.upload(&self.fields.answer, &[of[0], of[1], told]);
        let mut recorder = Recorder::new(self.gpu);
        recorder.stage("solve", record);
        recorder.submit();
        let answer = self.gpu.download(&self.fields.answer).unwrap();
        [answer[0], answer[1]]
    }

    /// The verdict, and the velocities: three numbers per node.
    fn solve(&self) -> (Outcome, Vec<f64>) {
        let (gpu, fields) = (self.gpu, &self.fields);
        self.fields.write_state(gpu, &self.state);
        let to = self.prepare();
        let solve = self.solver.solve(gpu, to, &self.buffers, fields, &self.polynomial);
        let (outcome, _) = solve.unwrap();
        let velocity = self.fields.velocity.download(gpu).unwrap();
        (outcome, three(&velocity))
    }

    fn apply(&self, x: &[f64]) -> Vec<f64> {
        let fields = &self.fields;
        let answer = self.solver.apply(self.gpu, &self.buffers, fields, &four(x));
        three(&answer.unwrap()[..4 * self.n_nodes])
    }

    fn precondition(&self, r: &[f64]) -> Vec<f64> {
        let (gpu, fields) = (self.gpu, &self.fields);
        let answer = self.solver.precondition(gpu, &self.buffers, fields, &self.polynomial, &four(r));
        three(&answer.unwrap()[..4 * self.n_nodes])
    }
}

/// Three numbers per node of four.
fn three(x: &[f64]) -> Vec<f64> {
    x.chunks_exact(4).flat_map(|node| node[..3].to_vec()).collect()
}

/// Four numbers per node of three.
fn four(x: &[f64]) -> Vec<f64> {
    let nodes = x.chunks_exact(3);
    nodes.flat_map(|node| [node[0], node[1], node[2], 0.0]).collect()
}

/// Uniform in -1..1 for free components, as f32 has them; 0 for prescribed ones.
fn noise(case: &SolidCase, seed: u64) -> Vec<f64> {
    let mut random = Random(seed);
    let prescribed = case.solids.prescribed.as_flattened().iter();
    prescribed
        .map(|&prescribed| match prescribed {
            true => 0.0,
            false => f64::from(random.uniform(-1.0, 1.0) as f32),
        })
        .collect()
}

/// The beam of the base scene, hung up at its top, bent and in motion.
fn hanging(cells: [usize; 3], material: Material, dt: f64) -> SolidCase {
    let low = DVec3::new(0.43, 0.47, 0.24);
    let mesh = lattice(low, DVec3::new(0.08, 0.08, 0.56), cells);
    let mut case = SolidCase::new("beam", solids(&[(mesh, material)])).deformed(bend);
    case.dt = f64::from(dt as f32);
    for (node, x) in case.solids.rest.iter().enumerate() {
        if x.z > 0.8 - 1e-6 {
            case.solids.prescribed[node] = [true; 3];
            continue;
        }
        let wave = [0.3 * (3.0 * x.z).sin(), 0.2 * (4.0 * x.x).cos(), 0.1 * (2.0 * x.y).sin() - 9.81 * dt];
        case.velocity[node] = wave.map(|v| f64::from(v as f32));
    }
    case
}

fn bend(x: DVec3) -> DVec3 {
    let s = 0.8 - x.z;
    let (angle, curvature, xi) = (0.5 * s / 0.56, 0.5 / 0.56, x.x - 0.47);
    DVec3::new(
        0.47 + (1.0 - angle.cos()) / curvature + xi * angle.cos(),
        x.y + 0.02 * (3.0 * s).sin(),
        0.8 - angle.sin() / curvature + xi * angle.sin(),
    )
}

/// The ugly cases, with velocities in prescribed components as `forces` leaves them, and beams: in one workgroup, in a dispatch for each
/// step of the polynomial, with two bodies.
fn systems() -> Vec<SolidCase> {
    let mut all = cases();
    for case in &mut all {
        for (node, v) in case.velocity.iter_mut().enumerate() {
            for axis in 0..3 {
                if case.solids.prescribed[node][axis] {
                    v[axis] = case.scripted.get(node).map_or(0.0, |v| v[axis]);
                }
            }
        }
    }
    let stiff = Material { young: 1e9, density: 10.0, ..RUBBER };
    all.push(hanging([2, 2, 14], RUBBER, 1.0 / 120.0));
    all.push(hanging([4, 4, 28], RUBBER, 1.0 / 120.0));
    all.push(hanging([3, 3, 21], stiff, 1.0 / 24.0));
    let stiffest = Material { young: 1e11, ..RUBBER };
    all.push(hanging([3, 3, 21], stiffest, 1.0 / 240.0));
    all.extend([in_a_corner(RUBBER), in_a_corner(stiff)]);
    all.extend([on_a_slope(RUBBER, 4), on_a_slope(stiffest, 7)]);
    // One that rises, turns and pushes, and one that recedes.
    for (name, velocity) in
        [("on a rising slope", DVec3::new(-0.5, 0.25, 1.0)), ("on a receding slope", DVec3::new(0.25, 0.0, -0.5))]
    {
        let mut case = on_a_slope(RUBBER, 4);
        case.name = name;
        case.motion =
            Some(RigidVelocity { velocity, spin: DVec3::new(0.5, -1.0, 0.25), centre: DVec3::new(0.25, 0.5, 0.0) });
        all.push(case);
    }
    all
}

/// A block in a corner of the domain, on three walls, partly pressed to them and partly lifted.
fn in_a_corner(material: Material) -> SolidCase {
    let mesh = lattice(DVec3::ZERO, DVec3::splat(0.5), [4, 4, 4]);
    let mut case = SolidCase::new("in a corner", solids(&[(mesh, material)])).shaken(0.0, 1.0);
    let mut random = Random(3);
    for (node, rest) in case.solids.rest.iter().enumerate() {
        // On the walls, or a little off them, which f32 holds exactly.
        let off = |x: f64, random: &mut Random| match (x == 0.0, random.uniform(0.0, 1.0)) {
            (true, share) if share < 0.7 => 0.0,
            (_, share) => 2f64.powi(-12) * (64.0 * share).round(),
        };
        case.displacement[node] = rest.to_array().map(|x| off(x, &mut random));
    }
    case
}

/// A block on a slope whose foot is a wall, which holds some nodes along with it.
fn on_a_slope(material: Material, seed: u64) -> SolidCase {
    let mut case = in_a_corner(material);
    case.name = "on a slope";
    let grid = case.grid;
    let (normal, foot) = (DVec3::new(-0.6, 0.0, 0.8), DVec3::new(0.25, 0.0, 0.1));
    let distance = |cell: usize| {
        let d = normal.dot(grid.cell_centre(grid.cell_at(cell)) - foot);
        f64::from(d.clamp(-3.0 * grid.dx, 3.0 * grid.dx) as f32)
    };
    case.solid_distance = (0..grid.n_cells()).map(distance).collect();
    let mut random = Random(seed);
    for (node, rest) in case.solids.rest.iter().enumerate() {
        // Nodes below the slope stand on it, some a little above.
        let depth = normal.dot(*rest - foot);
        let lift = [0.0, 1e-5, 0.02][(random.uniform(0.0, 3.0) as usize).min(2)];
        let out = if depth < lift { lift - depth } else { 0.0 };
        case.displacement[node] = pair(out * normal);
        case.solids.prescribed[node] = [random.uniform(0.0, 1.0) < 0.1, false, false];
    }
    case
}

/// Vectors per node.
fn nodes(x: &[f64]) -> Vec<[f64; 3]> {
    x.as_chunks::<3>().0.to_vec()
}

/// |S| |x|: what rounding of S x is a part of.
fn magnitudes(twin: &Twin, x: &[f64]) -> Vec<f64> {
    let matrix = twin.to_csr();
    let row = |row| matrix.row(row).map(|(column, s)| (s * x[column]).abs()).sum();
    (0..x.len()).map(row).collect()
}

fn precisions(gpu: &Gpu) -> Vec<Solver> {
    let all = [(Precision::F32, 1e-5), (Precision::Mixed, 1e-8), (Precision::F64, 1e-10)];
    let there = all.into_iter();
    there
        .filter(|(precision, _)| gpu.has_f64() || *precision != Precision::F64)
        .map(|(precision, tolerance)| Solver { precision, tolerance, ..Solver::default() })
        .collect()
}

/// The operator, the preconditioner and the solve of every system, on one device each: compiling the kernels is most of the time.
#[test]
fn the_velocities_solve_the_system() {
    let Some(gpu) = gpu() else { return };
    let mut held = [0; 2];
    for case in systems() {
        for solver in precisions(gpu) {
            let what = format!("{} {:?}", case.name, solver.precision);
            let device = Device::holding(gpu, &case, &solver);
            let twin = twin(&case, &device);
            let contacts = assert_contacts(&what, &case, &twin, &device);
            assert_operator(&what, &case, &twin, &device);
            assert_preconditioner(&what, &case, &twin, &device, &solver);
            // Forces of 1e-25 N, whose squares are nothing in f32.
            if case.name != "denormals" || device.fields.velocity.real == Real::F64 {
                assert_solution(&what, &case, &twin, &device, &solver);
                assert_search(&what, &case, &twin, contacts, &device);
            }
            let by_obstacles = usize::from(!case.solid_distance.is_empty());
            let ranks = twin.freedom().iter().map(Freedom::rank).sum::<usize>();
            held[by_obstacles] += twin.components().len() - ranks;
        }
    }
    let held = held.map(|held| held / precisions(gpu).len());
    assert!(held[0] > 10 && held[1] > 80, "{held:?} directions held");
}

/// What walls and obstacles hold from the start, and at which velocities, is the twin's: gaps, and normals of obstacles, are f32.
fn assert_contacts(what: &str, case: &SolidCase, twin: &Twin, device: &Device) -> Contacts {
    let contacts = Contacts::new(&case.solids, &case.obstacles(), &case.displacement, twin.forces(), case.dt);
    let mut wanted = case.velocity.clone();
    let freedom = contacts.hold(&mut wanted);
    let found = device.velocity();
    for (node, (freedom, found_freedom)) in freedom.iter().zip(twin.freedom()).enumerate() {
        let off = freedom.projector - found_freedom.projector;
        let off = off.to_cols_array().map(f64::abs).into_iter().fold(0.0, f64::max);
        assert!(off < 1e-5, "{what}: node {node}: {freedom:?}, {found_freedom:?}");
        let (wanted, found) = (DVec3::from(wanted[node]), DVec3::from(found[node]));
        let reach = DVec3::from(case.displacement[node]).length() + case.grid.size().length();
        let bound = 1e-5 * wanted.length() + 16.0 * eps(Real::F32) * reach / case.dt;
        let touched = freedom.rank() < Freedom::of(case.solids.prescribed[node]).rank();
        let bound = if touched { bound } else { 0.0 };
        let off = wanted.distance(found);
        assert!(off <= bound, "{what}: node {node}: {found} m/s for {wanted}");
    }
    let mut recorder = Recorder::new(device.gpu);
    diagnose_solid(device.gpu, &device.fields).unwrap().record(&mut recorder);
    recorder.submit();
    let report = SolidReport::from_words(&device.gpu.download(&device.fields.report).unwrap());
    let rate = contacts.closing_rate(&found);
    let reach = largest_length(&case.displacement) + case.grid.size().length();
    // Over a gap of at least a thousandth of a cell; a device may take velocities below the least normal f32 as 0.
    let gap = 1e-3 * case.grid.dx;
    let bound = (1e-4 + 16.0 * eps(Real::F32) * reach / gap) * rate + f64::from(f32::MIN_POSITIVE) / gap;
    assert!((report.closing_rate - rate).abs() <= bound, "{what}: {} of {rate} 1/s", report.closing_rate);
    contacts
}

/// Between solves the search for contacts does what the twin does, up to rounding, as gaps are f32: where it starts from, what is on the way
/// from there to what the solve found, whether phi grows on it, where it first stops, what is wrong, and who is held and let go.
fn assert_search(what: &str, case: &SolidCase, twin: &Twin, mut contacts: Contacts, device: &Device) {
    let search = device.system.search();
    let found = device.velocity();
    let reach = largest_length(&case.displacement) + case.grid.size().length();
    let gap = 16.0 * eps(Real::F32) * reach;
    let assert_near = |of: &str, wanted: &[[f64; 3]], found: &[[f64; 3]]| {
        for (node, (wanted, found)) in wanted.iter().zip(found).enumerate() {
            let (wanted, found) = (DVec3::from(*wanted), DVec3::from(*found));
            let bound = 1e-4 * wanted.length() + gap / case.dt;
            let off = wanted.distance(found);
            assert!(off <= bound, "{what}, {of}: node {node}: {found} for {wanted} m/s");
        }
    };
    let assert_held = |of: &str, contacts: &Contacts| {
        let twins = contacts.hold(&mut device.velocity());
        for (node, (twin, found)) in twins.iter().zip(device.freedom(case)).enumerate() {
            let off = twin.projector - found.projector;
            let off = off.to_cols_array().map(f64::abs);
            let off = off.into_iter().fold(0.0, f64::max);
            assert!(off < 1e-5, "{what}, {of}: node {node}: {found:?} for {twin:?}");
        }
    };
    device.ask([0; 2], 0, |pass| search.record_rest(pass));
    let best = device.nodes(&device.buffers.best);
    assert_near("rest", &contacts.at_rest(&found), &best);
    for share in [1.0, 0.5, 0.125, 0.0] {
        let told = (share as f32).to_bits();
        let [grows, _] = device.ask([0; 2], told, |pass| search.record_approach(pass));
        let next = device.nodes(&device.buffers.z);
        let of = format!("{share} of the way");
        assert_near(&of, &contacts.approach(&best, &found, share), &next);
        let gain = twin.gain(&best, &next);
        let [from, to] = [&best, &next].map(|v| v.as_flattened());
        let sums: Vec<f64> = from.iter().zip(to).map(|(v, w)| v + w).collect();
        let forces = twin.forces().as_flattened().iter();
        let terms = forces.zip(magnitudes(twin, &sums)).zip(from.iter().zip(to));
        let terms = terms.map(|((f, s), (v, w))| (w - v).abs() * (0.5 * s + f.abs()));
        let rounding = 64.0 * eps(device.fields.velocity.real) * terms.sum::<f64>();
        assert!(
            gain.abs() <= rounding || (grows == 1) == (gain > 0.0),
            "{what}, {of}: {grows} of {gain:e} W, give or take {rounding:e}"
        );
    }
    let one = [1_f32.to_bits(), 0];
    let [stop, _] = device.ask(one, 0, |pass| search.record_first_stop(pass));
    let (stop, wanted) = (f64::from(f32::from_bits(stop)), contacts.first_stop(&best, &found));
    // Gaps over a way of more than what is taken for beyond.
    let bound = 1e-5 + 2.0 * gap / contacts.near();
    assert!((stop - wanted).abs() <= bound, "{what}: {stop}, {wanted} of the way");
    assert_eq!(device.velocity(), found, "{what}: the search changes what was found");

    for told in [0, 1] {
        let wrong = contacts.judge(twin, &found);
        let answer = device.ask([0; 2], told, |pass| search.record_judge(pass));
        assert_eq!(answer, [wrong.beyond, wrong.pulled], "{what}, told {told}");
        if told == 1 {
            contacts.let_go(twin, &found);
        }
        assert_held("what is let go", &contacts);
    }
    device.ask([0; 2], 0, |pass| search.record_hold_stopped(pass));
    contacts.hold_stopped(&best, &found);
    assert_held("what is stopped", &contacts);
    // Of what the solve found nodes are on their surfaces or far away; the best may be in between, where rounding decides.
    let all_found = four(found.as_flattened());
    device.buffers.best.upload(device.gpu, &all_found);
    device.ask([0; 2], 1, |pass| search.record_hold_stopped(pass));
    contacts.hold_all_touching(&found);
    assert_held("all that touch", &contacts);
}

fn largest_length(vectors: &[[f64; 3]]) -> f64 {
    let lengths = vectors.iter().map(|v| DVec3::from(*v).length());
    lengths.fold(0.0, f64::max)
}

/// Velocities that solve the system, as the reported residual says; those that are prescribed stay to the bit.
fn assert_solution(what: &str, case: &SolidCase, twin: &Twin, device: &Device, solver: &Solver) {
    let (outcome, velocity) = device.solve();
    assert_eq!(outcome.status, SolveStatus::Converged, "{what}: {outcome:?}");
    assert_eq!(outcome.unknowns as usize, twin.n_unknowns(), "{what}");
    let held = case.velocity.as_flattened();
    let prescribed = case.solids.prescribed.as_flattened();
    for (at, _) in prescribed.iter().enumerate().filter(|(_, held)| **held) {
        assert_eq!(velocity[at], held[at], "{what}: component {at}");
    }
    let residual = norm(&twin.residual(&twin.free_part(&nodes(&velocity))));
    let goal = (solver.tolerance * norm(&twin.rhs)).max(rounding(solver) * twin.rhs_scale);
    // The device has moduli, masses and, without f64, gradients in f32: rounding of the terms of S v.
    let size = norm(&magnitudes(twin, &velocity)) + twin.rhs_scale;
    let coarse = 32.0 * eps(device.fields.velocity.real) * size;
    assert!(residual <= goal + coarse, "{what}: |r| is {residual:e} N, not {goal:e} and {coarse:e}; {outcome:?}");
    let reported = outcome.residual * norm(&twin.rhs);
    assert!(
        (reported - residual).abs() <= 1e-3 * residual + coarse,
        "{what}: |r| is {residual:e} N, reported {reported:e}, give or take {coarse:e}"
    );
}

/// S x as conjugate gradients evaluate it is the twin's, symmetric and positive. A translation strains nothing: S times it is the mass
/// part alone, to the bit of one rounding.
fn assert_operator(what: &str, case: &SolidCase, twin: &Twin, device: &Device) {
    let [x, y] = [1, 2].map(|seed| twin.free_part(&nodes(&noise(case, seed))));
    let mut wanted = vec![0.0; x.len()];
    twin.apply(&x, &mut wanted);
    let size = magnitudes(twin, &x);
    let eps = eps(device.fields.velocity.real);
    let [sx, sy] = [&x, &y].map(|x| device.apply(x));
    // Elements cancel in the sums of a node: by their number there, 24, at most.
    let bound = 64.0 * eps * norm(&size);
    for (at, (found, wanted)) in sx.iter().zip(&wanted).enumerate() {
        let off = (found - wanted).abs();
        assert!(off <= bound, "{what}: component {at} is off by {off:e} of {bound:e}");
    }
    let (xsy, ysx) = (dot(&x, &sy), dot(&y, &sx));
    let terms = 64.0 * eps * size.iter().sum::<f64>();
    assert!((xsy - ysx).abs() <= terms, "{what}: {xsy} and {ysx}");
    assert!(dot(&x, &sx) > 0.0, "{what}: not positive");
    let prescribed = case.solids.prescribed.as_flattened();
    let free = twin.freedom().iter().all(|freedom| freedom.rank() == 3);
    if prescribed.iter().any(|held| *held) || !free {
        return;
    }
    let moved = device.apply(&vec![0.75; x.len()]);
    for (node, found) in moved.chunks_exact(3).enumerate() {
        let zeta = case.solids.body_of_node(node).zeta_mass(case.dt);
        let wanted = 0.75 * zeta * case.solids.mass[node];
        for found in found {
            let off = (found - wanted).abs();
            assert!(off <= 4.0 * eps * wanted, "{what}: node {node}: {found} N");
        }
    }
}

/// The preconditioner is symmetric and positive, and what is prescribed stays 0. In f32 symmetric up to rounding, which the polynomial lets
/// grow with its degree.
fn assert_preconditioner(what: &str, case: &SolidCase, twin: &Twin, device: &Device, solver: &Solver) {
    let [x, y] = [3, 4].map(|seed| twin.free_part(&nodes(&noise(case, seed))));
    let [hx, hy] = [&x, &y].map(|r| device.precondition(r));
    let real = device.fields.velocity.real;
    for (hx, free) in nodes(&hx).iter().zip(nodes(&twin.free_part(&nodes(&hx)))) {
        let (hx, free) = (DVec3::from(*hx), DVec3::from(free));
        let off = hx.distance(free);
        assert!(off <= 8.0 * eps(real) * hx.length(), "{what}: {hx} is not free");
    }
    for (at, held) in case.solids.prescribed.as_flattened().iter().enumerate() {
        assert!(!held || hx[at] == 0.0, "{what}: component {at} moves");
    }
    let (xhx, yhy) = (dot(&x, &hx), dot(&y, &hy));
    assert!(xhx > 0.0 && yhy > 0.0, "{what}: {xhx} and {yhy}");
    let off = (dot(&x, &hy) - dot(&y, &hx)).abs();
    let inner = variant(device.gpu.has_f64(), solver.precision).inner;
    let degree = f64::from(device.polynomial.degree);
    let bound = 64.0 * (degree + 1.0) * eps(inner) * (xhx * yhy).sqrt();
    assert!(off <= bound, "{what}: asymmetric by {off:e}, of {bound:e}");
}

/// All steps in one workgroup are the same iteration as a dispatch for each.
#[test]
fn the_polynomial_is_the_same_in_one_workgroup() {
    let Some(gpu) = gpu() else { return };
    let small = hanging([2, 2, 14], RUBBER, 1.0 / 120.0);
    // A second body of more than a workgroup's rows makes all steps dispatches.
    let low = DVec3::new(0.1, 0.1, 1.0);
    let other = lattice(low, DVec3::splat(0.8), [7, 7, 7]);
    let beam = lattice(DVec3::new(0.43, 0.47, 0.24), DVec3::new(0.08, 0.08, 0.56), [2, 2, 14]);
    let mut both = SolidCase::new("both", solids(&[(beam, RUBBER), (other, RUBBER)]));
    let n = small.solids.rest.len();
    both.displacement[..n].copy_from_slice(&small.displacement);
    both.solids.prescribed[..n].copy_from_slice(&small.solids.prescribed);
    both.dt = small.dt;
    let r = noise(&small, 7);
    let mut r_both = r.clone();
    r_both.resize(3 * both.solids.rest.len(), 0.0);
    for solver in precisions(gpu) {
        let in_one = Device::holding(gpu, &small, &solver);
        let one_by_one = Device::holding(gpu, &both, &solver);
        // The other body may need a higher degree or bound; the rows of the beam see only the polynomial.
        let device = Device { polynomial: in_one.polynomial, ..one_by_one };
        let (a, b) = (in_one.precondition(&r), device.precondition(&r_both));
        let inner = variant(gpu.has_f64(), solver.precision).inner;
        let bound = 64.0 * eps(inner) * norm(&a);
        for (a, b) in a.iter().zip(&b) {
            assert!((a - b).abs() <= bound, "{:?}: {a} and {b}", solver.precision);
        }
        assert!(b[3 * n..].iter().all(|&z| z == 0.0), "the other body moves");
    }
}

/// Sums of more partials than a workgroup folds, and rows of many slices.
#[test]
fn a_large_solid_converges() {
    let Some(gpu) = gpu() else { return };
    let mesh = lattice(DVec3::splat(0.1), DVec3::splat(1.0), [25; 3]);
    let case = SolidCase::new("large", solids(&[(mesh, RUBBER)])).shaken(1e-3, 1.0);
    let case = SolidCase { dt: f64::from(1e-3_f32), ..case };
    let solver = Solver::default();
    let device = Device::holding(gpu, &case, &solver);
    assert_solution("large", &case, &twin(&case, &device), &device, &solver);
}

/// The residual that is told is the one of the velocities that are left, whatever ended the solve.
#[test]
fn a_limit_is_told_with_the_true_residual() {
    let Some(gpu) = gpu() else { return };
    let case = hanging([4, 4, 28], RUBBER, 1.0 / 24.0);
    let mut last = f64::INFINITY;
    for max_iterations in 1..=7 {
        let solver = Solver { max_iterations, tolerance: 1e-12, ..Solver::default() };
        let device = Device::holding(gpu, &case, &solver);
        let twin = twin(&case, &device);
        let (outcome, velocity) = device.solve();
        assert_eq!(outcome.status, SolveStatus::IterationLimit, "{outcome:?}");
        assert_eq!(outcome.iterations, max_iterations);
        let unknowns = twin.free_part(&nodes(&velocity));
        let residual = norm(&twin.residual(&unknowns)) / norm(&twin.rhs);
        let coarse = 32.0 * eps(device.fields.velocity.real) * norm(&magnitudes(&twin, &velocity)) / norm(&twin.rhs);
        assert!(
            (residual - outcome.residual).abs() <= 1e-3 * residual + coarse,
            "{max_iterations}: {residual:e}, reported {:e}",
            outcome.residual
        );
        last = last.min(residual);
    }
    assert!(last < 0.5, "seven iterations leave {last}");
}

#[test]
fn not_a_number_is_told() {
    let Some(gpu) = gpu() else { return };
    let mut case = hanging([2, 2, 14], RUBBER, 1.0 / 120.0);
    case.velocity[0][1] = f64::NAN;
    for solver in precisions(gpu) {
        let (outcome, _) = Device::holding(gpu, &case, &solver).solve();
        assert_eq!(outcome.status, SolveStatus::NonFinite, "{outcome:?}");
    }
}

#[test]
fn the_same_solve_gives_the_same_bits() {
    let Some(gpu) = gpu() else { return };
    for cells in [[2, 2, 14], [4, 4, 28]] {
        let case = hanging(cells, RUBBER, 1.0 / 120.0);
        for solver in precisions(gpu) {
            let device = Device::holding(gpu, &case, &solver);
            let (first, velocity) = device.solve();
            let (second, again) = device.solve();
            assert_eq!(first.iterations, second.iterations);
            assert!(velocity == again, "{:?} differs", solver.precision);
        }
    }
}
