//! Cases of liquid and elastic solids together: the solve, mostly on the f64 path.

use std::sync::Arc;
use std::time::Instant;

use cutwater::Error;
use cutwater::geometry::{ObstacleCut, SolidClip};
use cutwater::gpu::{AdapterChoice, Gpu, Real};
use cutwater::linalg::{SymbolicCholesky, norm};
use cutwater::measure::base_scene::DeviceScene;
use cutwater::reference::base_block::DENSITY;
use cutwater::reference::base_scene::{BaseBeam, BaseScene};
use cutwater::reference::{
    ActiveCells, BlockPattern, CoupledSolution, CoupledSystem, Formulation, RightHandSide, SIGMA, SolidSolver, Stencil,
    StressVariables, larger, solve_coupled,
};
use cutwater::scene::{Formulation as Form, Precision, Solver};
use cutwater::sim::{Simulation, SolidSnapshot, StoredPressure, coupled_system, stored_coupling};
use cutwater::state::SolveStatus;
use glam::DVec3;

use crate::Case;
use crate::lane::Lane;
use crate::liquid::written;
use crate::sheet::Sheet;
use crate::solid_scene::solids_of;

pub(crate) fn cases() -> Vec<Case> {
    let mut cases = vec![
        Case::new("C1", formulations),
        Case::new("C2", iterations),
        Case::new("C3", parameters),
        Case::new("C3/device", stored),
        Case::alone("C4", seconds_of_clip),
    ];
    for lane in Lane::PRECISE {
        cases.push(Case::new(format!("C5/{}", lane.name()), move |sheet| neutral_block(lane, sheet)));
    }
    cases
}

/// The base scene's system with its beam.
struct Base {
    scene: BaseScene,
    system: CoupledSystem,
    solver: SolidSolver,
}

impl Base {
    fn new(n: usize, beam: &BaseBeam) -> Base {
        let scene = BaseScene::new(n, beam).expect("the base scene has a beam");
        Base { system: scene.coupled_system(), solver: SolidSolver::new(&scene.solids), scene }
    }

    fn solve(&self, formulation: Formulation, tolerance: f64) -> CoupledSolution {
        let settings = Solver { tolerance, max_iterations: 20_000, ..Solver::default() };
        let (system, solids) = (&self.system, &self.scene.solids);
        let solution = solve_coupled(system, formulation, &self.solver, solids, &settings);
        let solution = solution.unwrap_or_else(|error| panic!("{error}"));
        for report in solution.reports {
            assert_eq!(report.status, SolveStatus::Converged, "{}: {report:?}", formulation.name());
        }
        solution
    }
}

/// Largest differences of p and v, relative to the largest of them; not a number where one is not.
fn differences(a: &CoupledSolution, b: &CoupledSolution) -> [f64; 2] {
    let relative = |a: &[f64], b: &[f64]| {
        let largest = b.iter().fold(0.0, |m, b| larger(m, b.abs()));
        let off = a.iter().zip(b).map(|(a, b)| (a - b).abs());
        off.fold(0.0, larger) / largest
    };
    [relative(&a.pressure, &b.pressure), relative(a.velocity.as_flattened(), b.velocity.as_flattened())]
}

/// All forms at 40^3 have the same answer. Direct solves with one correction: rounding, times condition numbers of at most 1e7 (two fields) and 1e5
/// (stress). Iterative ones to a residual of 1e-10: errors are at most 1000 times that, the square root of the condition number.
fn formulations(sheet: &mut Sheet) {
    let base = Base::new(40, &BaseBeam::default());
    let exact = base.solve(Formulation::Indefinite, 1e-12);
    let deformations = base.scene.matrices().deformations;
    let stress = StressVariables::new(&base.scene.solids, &deformations, |body| body.zeta_stiffness(base.scene.dt));
    for (formulation, tolerance, bound) in [
        (Formulation::TwoField(SIGMA), 1e-2, 1e-9),
        (Formulation::TwoField(0.9), 1e-2, 1e-9),
        (Formulation::Stress(&stress), 1e-2, 1e-11),
        (Formulation::IndefiniteIterative, 1e-10, 1e-7),
        (Formulation::IndefiniteMinimalResidual, 1e-10, 1e-7),
        (Formulation::TwoFieldIncomplete(0.9), 1e-10, 1e-7),
        (Formulation::StressIncomplete(&stress), 1e-10, 1e-7),
        (Formulation::TwoFieldIterative(SIGMA), 1e-10, 1e-7),
        (Formulation::Condensed, 1e-10, 1e-7),
    ] {
        let start = Instant::now();
        let solution = base.solve(formulation, tolerance);
        let seconds = start.elapsed().as_secs_f64();
        let [p, v] = differences(&solution, &exact);
        let mut name = formulation.name().to_owned();
        if let Formulation::TwoField(sigma) = formulation {
            name += &format!(", {sigma} of the mass in Z1");
        }
        sheet.at_most(&format!("{name}: p against the indefinite system"), p, bound);
        sheet.at_most(&format!("{name}: v"), v, bound);
        let iterations = solution.reports[0].iterations;
        sheet.info(&format!("{name}: iterations"), format!("{iterations} in {seconds:.2} s"));
    }
    let matrix = base.system.blocks().two_field(0.9).expect("it fits into memory");
    let symbolic = SymbolicCholesky::new(&matrix).expect("it fits into memory");
    let definite = symbolic.factorise(&matrix).is_ok();
    sheet.holds(
        "the matrix of the two fields has a Cholesky factor",
        "yes",
        if definite { "yes" } else { "no" }.to_owned(),
        definite,
    );
}

/// Conjugate gradients to 1e-8 of both residuals, from 20^3 to 100^3. Iterations grow more slowly than the square root of the cells along an edge, with
/// which those of modified incomplete Cholesky grow (Gustafsson 1978).
fn iterations(sheet: &mut Sheet) {
    let beams = [(20, [2, 2, 14]), (40, [2, 2, 14]), (60, [3, 3, 21]), (80, [4, 4, 28]), (100, [4, 4, 28])];
    let mut found = [Vec::new(), Vec::new()];
    let forms = [Formulation::Condensed, Formulation::TwoFieldIterative(SIGMA)];
    for (n, bricks) in beams {
        let base = Base::new(n, &BaseBeam { bricks, ..BaseBeam::default() });
        for (formulation, found) in forms.into_iter().zip(&mut found) {
            let start = Instant::now();
            let iterations = base.solve(formulation, 1e-8).reports[0].iterations;
            found.push((n, iterations, start.elapsed().as_secs_f64()));
        }
    }
    for (formulation, found) in forms.into_iter().zip(found) {
        let name = formulation.name();
        let [(first, few, _), .., (last, many, _)] = found[..] else { panic!("{found:?}") };
        let order = (f64::from(many) / f64::from(few)).ln() / (last as f64 / first as f64).ln();
        let what = format!("{name}: order in 1/dx of the iterations, {first}³ to {last}³");
        sheet.at_most(&what, order, 0.5);
        let each = found.iter().map(|(n, iterations, seconds)| format!("{n}³ {iterations} in {seconds:.2} s"));
        sheet.info(&format!("{name}: iterations and seconds"), each.collect::<Vec<_>>().join(", "));
    }
}

/// The condensed form with one parameter of the base scene changed by up to a factor of 1e3, which may double the iterations, and with two.
fn parameters(sheet: &mut Sheet) {
    let base = BaseBeam::default();
    let iterations = |beam: &BaseBeam| {
        let solution = Base::new(40, beam).solve(Formulation::Condensed, 1e-8);
        f64::from(solution.reports[0].iterations)
    };
    let of_base = iterations(&base);
    let mut beams = Vec::new();
    for young in [1e4, 1e5, 1e7, 1e8, 1e9] {
        beams.push((format!("E = {young:e} Pa"), 2.0, BaseBeam { young, ..base }));
    }
    for density in [20.0, 100.0, 500.0, 5000.0, 20_000.0] {
        beams.push((format!("density {density}"), 2.0, BaseBeam { density, ..base }));
    }
    let (young, density) = (1e4, 20.0);
    let both = BaseBeam { young, density, ..base };
    beams.push(("E = 1e4 Pa, density 20".into(), 4.0, both));
    sheet.info("condensed, base scene: iterations", of_base.to_string());
    for (name, bound, beam) in beams {
        let what = format!("condensed, {name}: iterations over those of the base scene");
        sheet.at_most(&what, iterations(&beam) / of_base, bound);
    }
}

/// The system of a base scene as stored on a device after its set-up.
fn stored_system(gpu: &Gpu, device: &DeviceScene, base: &Base) -> Result<CoupledSystem, Error> {
    let (grid, scene, fields) = (&device.grid, &base.scene, device.fields());
    let prescribed = &scene.solids.prescribed;
    let snapshot = SolidSnapshot::read(gpu, fields.fields, fields.solids, prescribed)?;
    let solids = snapshot.on_device(&scene.solids);
    let solid = snapshot.system(&solids, &Arc::new(BlockPattern::new(&solids)), f64::from(scene.dt as f32));
    let (clip, pressure) = (scene.clip(), StoredPressure::read(gpu, grid, fields.liquid)?);
    let (coupling, density) = stored_coupling(clip.coupling(), grid.dx, DENSITY, scene.dt);
    let mut active = ActiveCells::new(Stencil::new(*grid, pressure.weight, pressure.dirichlet));
    active.seal(&coupling, prescribed);
    // As uploaded: a solve subtracts J v.
    let area = grid.dx * grid.dx;
    let values = base.system.pressure.rhs.iter().map(|b| match fields.liquid.rhs.real {
        Real::F32 => area * f64::from((b / area) as f32),
        Real::F64 => area * (b / area),
    });
    let values: Vec<f64> = values.collect();
    Ok(coupled_system((active, &[]), RightHandSide { scale: norm(&values), values }, solid, &coupling, density))
}

/// Solution of a device against the direct solve of the system that it stored, and that against the one assembled in f64, over stiffness,
/// step, density and Poisson's ratio. `mixed` to a tolerance of 1e-10, which it has to reach; `f32` until rounding stops it.
///
/// Errors may be 100 times the tolerance (mixed), and 500 times the rounding unit of f32 (6e-8). The assembly stores coefficients in f32: twice the
/// tolerance of such a solve.
fn stored(sheet: &mut Sheet) {
    let gpu = Gpu::new(&AdapterChoice::Best).expect("there is an adapter");
    sheet.info("adapter", gpu.report().name.clone());
    let base = BaseBeam::default();
    let mut beams = vec![("base".to_owned(), base)];
    for young in [1e4, 1e5, 1e7, 1e8, 1e9] {
        beams.push((format!("E = {young:e} Pa"), BaseBeam { young, ..base }));
    }
    for dt in [1e-3, 5e-3, 2e-2] {
        beams.push((format!("dt = {dt:e} s"), BaseBeam { dt, ..base }));
    }
    for density in [100.0, 500.0, 5000.0, 20_000.0] {
        beams.push((format!("density {density}"), BaseBeam { density, ..base }));
    }
    for poisson in [0.0, 0.3, 0.49] {
        beams.push((format!("nu = {poisson}"), BaseBeam { poisson, ..base }));
    }
    let (young, density) = (1e7, 500.0);
    let both = BaseBeam { young, density, ..base };
    beams.push(("E = 1e7 Pa, density 500".to_owned(), both));
    for (name, beam) in beams {
        let assembled = Base::new(20, &beam);
        let exact = assembled.solve(Formulation::Indefinite, 1e-12);
        for (precision, tolerance) in [(Precision::Mixed, 1e-10), (Precision::F32, 1e-5)] {
            if precision == Precision::Mixed && !gpu.has_f64() {
                continue;
            }
            for formulation in [Form::TwoField, Form::Condensed] {
                // Whose dense inverse comes from a factor in f64.
                if precision == Precision::F32 && formulation == Form::Condensed {
                    continue;
                }
                let settings = Solver { precision, tolerance, formulation, max_iterations: 1000, ..Solver::default() };
                let device = DeviceScene::new(&gpu, &assembled.scene, &assembled.system, &settings);
                let device = device.expect("the adapter is large enough");
                device.reset();
                let outcome = device.solve().expect("the device works");
                let (mut pressure, velocity) = device.answer().expect("the device works");
                let active = &assembled.system.pressure.stencil;
                for (cell, pressure) in pressure.iter_mut().enumerate() {
                    if !active.active(cell) {
                        *pressure = 0.0;
                    }
                }
                let mut of_device = exact.clone();
                (of_device.pressure, of_device.velocity) = (pressure, velocity);
                let stored = Base {
                    system: stored_system(&gpu, &device, &assembled).expect("the device works"),
                    solver: SolidSolver::new(&assembled.scene.solids),
                    scene: BaseScene::new(20, &beam).expect("the base scene has a beam"),
                };
                let direct = stored.solve(Formulation::Indefinite, 1e-12);
                let [p, v] = differences(&of_device, &direct);
                let what = format!("{name}: {precision:?}, {formulation:?}");
                let bounds = match precision {
                    Precision::F32 => [3e-5, 3e-5],
                    _ => [1e-8, 1e-8],
                };
                let (status, iterations) = (outcome.parts[0].status, outcome.parts[0].iterations);
                let ended = format!("{} after {iterations} iterations", status.name());
                let what_ended = format!("{what}: ended");
                if precision == Precision::Mixed {
                    let converged = status == SolveStatus::Converged;
                    sheet.holds(&what_ended, "converged", ended, converged);
                } else {
                    sheet.info(&what_ended, ended);
                }
                // Conjugate gradients in f32 end before a beam as stiff as this is solved for, and say so.
                if status == SolveStatus::Converged || beam.young < 1e9 || bounds[0] < 1e-5 {
                    sheet.at_most(&format!("{what}: p against its direct solve"), p, bounds[0]);
                    sheet.at_most(&format!("{what}: v"), v, bounds[1]);
                }
                if formulation == Form::TwoField {
                    let [p, v] = differences(&direct, &exact);
                    sheet.at_most(&format!("{what}: assembly, p"), p, 1e-5);
                    sheet.at_most(&format!("{what}: assembly, v"), v, 1e-5);
                }
            }
        }
    }
}

/// Clipping, open areas, distances and J at 100^3, of solids with about 3,000 surface triangles: at most 15 % of a step of 2 s.
fn seconds_of_clip(sheet: &mut Sheet) {
    for (what, size, bricks) in [
        ("beam", [0.1, 0.6, 0.1], [6, 58, 6]),
        ("block", [0.4, 0.4, 0.4], [16, 16, 16]),
        ("plate", [0.8, 0.04, 0.8], [26, 1, 26]),
    ] {
        let scene = written(&format!(
            "[domain]
size = [1, 1, 1]
cells = [100, 100, 100]
[time]
duration = 1
[[solid]]
name = \"body\"
mesh = {{ box = {{ size = {size:?}, cells = {bricks:?} }} }}
placement = {{ translate = [0.5, 0.5, 0.5], rotate = {{ axis = [1, 2, 3], degrees = 20 }} }}
density = 1000
young = 1e6
poisson = 0.3
"
        ));
        let (grid, solids) = (scene.grid(), solids_of(&scene));
        let mut clip = SolidClip::new(&grid, ObstacleCut::none(&grid), &scene.solver);
        let mut seconds: Vec<f64> = (0..11)
            .map(|step| {
                let moved = vec![[1e-3 * f64::from(step), 2e-3, 0.0]; solids.rest.len()];
                let start = Instant::now();
                clip.clip(&solids.moved(&moved));
                start.elapsed().as_secs_f64()
            })
            .collect();
        seconds.sort_by(f64::total_cmp);
        let triangles = solids.triangles.len();
        let what = format!("clip of a {what} of {triangles} triangles: median seconds of 11");
        sheet.at_most(&what, seconds[5], 0.3);
        sheet.info(
            "patches; least and most seconds",
            format!("{}; {:.3}, {:.3}", clip.patches().len(), seconds[0], seconds[10]),
        );
    }
}

/// A turned block as heavy as the liquid around it, one step from rest: its accelerations, in g. Its nodes move by its compression alone, at most
/// rho g H (1 - 2 nu) / E times its diagonal, and its middle by at most half of that.
fn neutral_block(lane: Lane, sheet: &mut Sheet) {
    const DT: f64 = 1.0 / 120.0;
    let diagonal = DVec3::new(0.3, 0.24, 0.2).length();
    let compression = 1000.0 * 0.81 * (1.0 - 2.0 * 0.3) / 1e10 * diagonal / (DT * DT);
    for (n, pressure) in [(20, "hydrostatic"), (30, "hydrostatic"), (40, "hydrostatic"), (20, "cell"), (40, "cell")] {
        let scene = written(&format!(
            "[domain]
size = [1, 1, 1]
cells = [{n}, {n}, {n}]
[time]
duration = 1
frames_per_second = 120
fixed_step = {DT:?}
[liquid]
surface = \"fixed\"
[[liquid.region]]
box = {{ min = [0, 0, 0], max = [1, 0.81, 1] }}
[[solid]]
name = \"block\"
mesh = {{ box = {{ size = [0.3, 0.24, 0.2], cells = [6, 5, 4] }} }}
placement = {{ translate = [0.51, 0.43, 0.47], rotate = {{ axis = [1, 2, 3], degrees = 37 }} }}
density = 1000.0
young = 1e10
poisson = 0.3
[solver]
tolerance = 1e-10
pressure_on_patches = \"{pressure}\"
"
        ));
        let mut simulation = Simulation::new(&scene, &lane.backend()).expect("the scene is sound");
        let report = simulation.step().expect("a step");
        for solve in report.solves() {
            assert_eq!(solve.status, SolveStatus::Converged, "{report:?}");
        }
        let (state, solids) = (simulation.state().expect("a state"), simulation.solids());
        let (mut momentum, mut largest) = (DVec3::ZERO, 0.0);
        for (v, mass) in state.node_velocity.iter().zip(&solids.mass) {
            momentum += *mass * DVec3::from(*v);
            largest = larger(largest, DVec3::from(*v).length());
        }
        let mass: f64 = solids.mass.iter().sum();
        let [mean, largest] = [momentum.length() / mass, largest].map(|v| v / (9.81 * DT));
        let what = format!("{n}³, \"{pressure}\": acceleration of the block");
        if pressure == "hydrostatic" {
            sheet.at_most(&format!("{what}, mean, g"), mean, 0.5 * compression);
            sheet.at_most(&format!("{what}, largest of a node, g"), largest, compression);
        } else {
            sheet.info(&what, format!("mean {mean:.1e} g, largest of a node {largest:.1e} g"));
        }
    }
}
