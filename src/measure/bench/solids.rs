//! `bench solids`: the solve for the velocities of elastic solids against their size, and a sparse Cholesky factorisation in f64 (faer).
//!
//! A body is fixed at its upper end and swings. Its first sub-steps are simulated. The solve of the next one is repeated from the same state,
//! alternately on the device and by factorisation. The time on the device is from the rotations of the elements to the residual check, that of the
//! factorisation from the assembled matrix to the velocities. The ordering, once per run, has its own column.

use std::time::Instant;

use super::bytes::SolidBytes;
use super::chart::{Chart, Page, at, lines};
use super::ended::Ended;
use super::statistics::Spread;
use super::sub_step::sub_step;
use super::table::{Row, Table, columns, row};
use super::{Bench, Case, Listener, Machine, Results, Run, Settings, rounds};
use crate::Error;
use crate::elastic::Bounds;
use crate::gpu::{AdapterChoice, Gpu};
use crate::linalg::{SymbolicCholesky, norm};
use crate::measure::stored;
use crate::scene::{Precision, Scene, Solver};
use crate::sim::{Backend, GpuPath, Simulation};
use crate::state::{SolveReport, SolveStatus};
use crate::step::Stage;

/// Sub-steps before the one whose system is solved.
const FIRST_STEPS: usize = 2;
/// Length of the shortest edge of the bodies, m.
const EDGE: f64 = 0.1;

/// A body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Body {
    /// Eight times as high as wide.
    Beam,
    /// A cube.
    Block,
}

impl Body {
    fn name(self) -> &'static str {
        match self {
            Body::Beam => "beam",
            Body::Block => "block",
        }
    }

    /// Height over width.
    fn height(self) -> usize {
        match self {
            Body::Beam => 8,
            Body::Block => 1,
        }
    }

    /// Cubes along the width for the nearest number of nodes.
    fn cells(self, nodes: usize) -> usize {
        let off = |k: &usize| ((k + 1).pow(2) * (self.height() * k + 1)).abs_diff(nodes);
        (1..1 << 8).min_by_key(off).unwrap_or(1)
    }
}

/// Bodies to measure.
#[derive(Clone, Debug)]
pub struct Options {
    /// Bodies, each in all sizes.
    pub bodies: Vec<Body>,
    /// Approximate nodes.
    pub nodes: Vec<usize>,
    /// Young's modulus, Pa.
    pub young: f64,
    /// kg/m^3
    pub density: f64,
    /// Length of the sub-steps, s.
    pub step: f64,
    /// Factors of more bytes are not computed.
    pub largest_factor: f64,
    /// Settings of the solver.
    pub solver: Solver,
    /// Adapter.
    pub adapter: AdapterChoice,
}

columns! {
    SOLIDS {
        body + "" "`beam` or `block`";
        nodes + "" "nodes";
        elements - "" "elements";
        unknowns + "" "free components of the velocities";
        young - "Pa" "Young's modulus";
        density - "kg/m3" "density";
        step - "s" "length of the sub-step";
        precision + "" "`f32`, `mixed` or `f64`";
        tolerance - "" "relative, of the true residual";
        status + "" "`converged`, `converged_to_rounding` or why not";
        iterations + "" "over all refinement steps";
        degree + "" "degree of the polynomial preconditioner";
        products - "" "products with S: of PCG and of its preconditioner";
        residual + "" "true relative residual";
        seconds ~ "s" "seconds of a solve on the device";
        factor_bytes - "B" "bytes of the Cholesky factor";
        ordering_seconds - "s" "ordering, once per run";
        factor_seconds + "s" "factorisation, median; empty for a factor that is too large";
        substitution_seconds + "s" "forward and backward substitution, median";
        ratio + "" "factorisation and substitution over the device in the same round, median";
        difference - "" "relative distance of the two answers";
        bytes - "B" "least memory traffic of a solve on the device";
        share_of_copy_bandwidth - "" "`bytes` per second over the copy bandwidth";
    }
}

/// Measures all bodies: solids.csv, solids.json, solids.svg.
///
/// # Errors
/// [`Error::Output`]; [`Error::Check`] if a solve is not reproducible; errors of simulation and device.
pub fn measure(
    options: &Options,
    settings: &Settings,
    listener: Listener,
) -> Result<Results, Error> {
    let key: &[&str] = &["body", "nodes"];
    let bench = Bench {
        name: "solids",
        tables: vec![Table::new("solids", &[SOLIDS], key)],
        derive: |_| {},
        pictures: &[("solids", draw)],
    };
    let machine = Machine::new(&Gpu::new(&options.adapter)?, settings.repeats)?;
    let request = (
        options.young,
        options.density,
        options.step,
        options.solver,
        options.largest_factor,
    );
    let mut run = Run::start(bench, machine, &request, settings, listener)?;
    let mut cases = Vec::new();
    for &body in &options.bodies {
        for &nodes in &options.nodes {
            let k = body.cells(nodes);
            let nodes = (k + 1).pow(2) * (body.height() * k + 1);
            cases.push(Case::new(
                "solids",
                row! { body: body.name(), nodes: nodes },
                move |run| Ok(vec![("solids", solve(run, body, k, options)?)]),
            ));
        }
    }
    run.cases(cases)?;
    Ok(run.results)
}

/// A body of `k` cubes across that is fixed at its upper end and moves sideways.
fn scene(body: Body, k: usize, options: &Options) -> Result<Scene, Error> {
    let Options {
        young,
        density,
        step,
        ..
    } = options;
    let height = EDGE * body.height() as f64;
    let side = height + 4.0 * EDGE;
    let (middle, along) = (0.5 * side, body.height() * k);
    let top = middle + (0.5 - 0.5 / along as f64) * height;
    let text = format!(
        "[domain]\nsize = [{side:?}, {side:?}, {side:?}]\ncells = [16, 16, 16]\n\
         [time]\nduration = {:?}\nframes_per_second = {:?}\nfixed_step = {step:?}\n\
         [[solid]]\nname = \"{}\"\nmesh = {{ box = {{ size = [{EDGE:?}, {height:?}, {EDGE:?}], cells = [{k}, {along}, {k}] }} }}\n\
         placement = {{ translate = [{middle:?}, {middle:?}, {middle:?}] }}\ninitial = {{ velocity = [1.0, 0.0, 0.3] }}\n\
         density = {density:?}\nyoung = {young:?}\npoisson = 0.4\n\
         [[solid.pin]]\nregion = {{ box = {{ min = [0, {top:?}, 0], max = [{side:?}, {side:?}, {side:?}] }} }}\n",
        10.0 * step,
        1.0 / step,
        body.name(),
    );
    let mut scene = Scene::parse("bench solids".as_ref(), &text, &[], 1.0)?;
    scene.solver = options.solver;
    Ok(scene)
}

/// Row of a body.
fn solve(run: &mut Run, body: Body, k: usize, options: &Options) -> Result<Row, Error> {
    let scene = scene(body, k, options)?;
    let mut simulation = Simulation::new(&scene, &Backend::Gpu(options.adapter.clone()))?;
    for _ in 0..FIRST_STEPS {
        simulation.step()?;
    }
    let state = simulation.state()?;
    drop(simulation);
    let mut path = GpuPath::open(&scene, &options.adapter)?;
    path.write_state(&state)?;
    let (dt, mut stored) = (path.next_time_step().dt, None);
    // Compiles.
    let report = path.step_observed(&mut |stage, path| {
        if let (Stage::Solve, Some(solids)) = (stage, path.snapshot()?.solids) {
            stored = Some(stored::solid_system(path, &solids, dt));
        }
        Ok(())
    })?;
    let (system, solids) = stored.expect("every sub-step has a solve");
    let solve = report.solid.expect("the scene has a solid").solve;
    let ended = Ended::new(&[solve]);
    let (matrix, unknowns) = (system.free_to_csr(), system.components());
    let free = |x: &[f64]| -> Vec<f64> { unknowns.iter().map(|&at| x[at]).collect() };
    let clock = Instant::now();
    let symbolic = SymbolicCholesky::new(&matrix)?;
    let ordering = clock.elapsed().as_secs_f64();
    let factor_bytes = 8.0 * symbolic.n_factor_entries() as f64;
    let what = format!("{} of {} nodes", body.name(), solids.rest.len());
    let (mut found, mut direct, mut parts) = (Vec::new(), Vec::new(), [Vec::new(), Vec::new()]);
    let jobs = 1 + usize::from(factor_bytes <= options.largest_factor);
    let timed = rounds(run, &format!("solves of a {what}"), jobs, |job| {
        if job == 0 {
            let done = sub_step(&mut path, &state, 0.0)?;
            let reports: Vec<SolveReport> = done.report.solves().collect();
            ended.ensure_repeated(Ended::new(&reports), &what)?;
            found = free(done.solution.velocity.as_flattened());
            return Ok((done.seconds, ()));
        }
        let clock = Instant::now();
        let factor = symbolic.factorise_in_parallel(&matrix)?;
        let factorised = clock.elapsed().as_secs_f64();
        direct = free(&system.rhs);
        factor.solve(&mut direct);
        let seconds = clock.elapsed().as_secs_f64();
        parts[0].push(factorised);
        parts[1].push(seconds - factorised);
        Ok((seconds, ()))
    })?;
    let [factor, substitution] =
        parts.map(|seconds| (!seconds.is_empty()).then(|| Spread::of(seconds).median));
    let off = found.iter().zip(&direct).map(|(found, x)| found - x);
    let off: Vec<f64> = off.collect();
    let seconds = timed[0].spread();
    let degree = Bounds::new(&solids).chebyshev_degree(&solids, dt);
    let refined = match options.solver.precision {
        Precision::F64 => 1.0,
        _ => 2.0,
    };
    let model = SolidBytes::new(&solids, path.scalar_bytes());
    let bytes =
        model.stiffness_rows() + model.solve(degree as f64, f64::from(solve.iterations), refined);
    let status = ended.name(options.solver.tolerance);
    let converged = status == SolveStatus::Converged.name();
    Ok(row! {
        body: body.name(), nodes: solids.rest.len(), elements: solids.elements.len(), unknowns: unknowns.len(), young: options.young,
        density: options.density, step: dt, precision: options.solver.precision, tolerance: options.solver.tolerance,
        status: status, iterations: solve.iterations, degree: degree, products: solve.iterations as usize * (degree + 1),
        residual: solve.residual, seconds: seconds, factor_bytes: factor_bytes, ordering_seconds: ordering, factor_seconds: factor,
        substitution_seconds: substitution, ratio: timed.get(1).filter(|_| converged).map(|direct| direct.ratio(&timed[0]).median),
        difference: factor.map(|_| norm(&off) / norm(&direct)), bytes: bytes,
        share_of_copy_bandwidth: run.results.machine.share(bytes, seconds.median),
    })
}

/// Seconds against nodes, on the device and by factorisation.
fn draw(results: &Results) -> Page {
    let rows = results.rows("solids");
    let own = |row: &Row| format!("{}, this solve", row.text("body"));
    let direct = |row: &Row| format!("{}, sparse Cholesky", row.text("body"));
    let mut all = lines(rows, own, at(["nodes", "seconds"]));
    all.extend(lines(rows, direct, |row| {
        let seconds = row.number("factor_seconds") + row.number("substitution_seconds");
        Some([row.number("nodes"), seconds].map(Spread::exact))
    }));
    let chart = Chart {
        title: format!("Solve of solids, {}", results.machine.name()),
        axes: ["nodes", "seconds"],
        lines: all,
        falling: false,
    };
    Page::Charts(1, vec![chart])
}
