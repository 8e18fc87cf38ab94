//! `bench solids`: the solve for the velocities of elastic solids against their size, and against a sparse Cholesky factorisation of
//! the same system in f64 (faer), in the same run.
//!
//! A body hangs from its upper end and swings. Its first sub-steps are simulated; the system of the next is then solved again and again,
//! by turns on the device and by factorisation, so that what else the machine does falls on both. The device counts from the
//! recording of the preconditioner's blocks to the verdict on the host, the factorisation from the assembled matrix to the velocities;
//! the order of elimination, which serves all sub-steps, is told apart. The first solve on the device, which compiles, is not counted.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;
use plotters::prelude::*;
use serde::Serialize;

use crate::Error;
use crate::elastic::{Bounds, Solids};
use crate::fields::{SolidBuffers, SolidPlan};
use crate::gpu::{AdapterChoice, Gpu, Recorder};
use crate::grid::Sides;
use crate::linalg::{SymbolicCholesky, norm};
use crate::output::FolderLock;
use crate::reference::{self, BlockPattern};
use crate::scene::{
    Camera, Domain, ElasticModel, Initial, Origins, Output, Pin, Placement, Scene, Shape, Solid,
    SolidMesh, Solver, SurfaceMesh, Time,
};
use crate::sim::{Backend, Simulation};
use crate::solver::{
    Outcome, Polynomial, SolidRows, SolidSolver, SolidSystem, SolidSystemBuffers, variant,
};
use crate::stages::{element_rotations, move_solid, node_forces};
use crate::state::{SolveStatus, State};
use crate::step::Stage;

use super::bench_solve::{Ended, name};
use super::chart::{Failure, Point, chart, series};
use super::solid_bytes::SolidBytes;
use super::statistics::Spread;
use super::table::{Machine, write_csv, write_json, write_svg};

/// Sub-steps before the one whose system is solved.
const FIRST_STEPS: usize = 2;
/// Length of the shortest edge of the bodies, m.
const EDGE: f64 = 0.1;

/// What is solved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Body {
    /// Eight times as high as it is wide.
    Beam,
    /// A cube.
    Block,
}

impl Body {
    /// `beam` or `block`.
    pub fn name(self) -> &'static str {
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

    /// Cubes along the width, so that the number of nodes comes nearest.
    fn cells(self, nodes: usize) -> usize {
        let off = |k: usize| ((k + 1).pow(2) * (self.height() * k + 1)).abs_diff(nodes);
        let mut k = 1;
        while off(k + 1) < off(k) {
            k += 1;
        }
        k
    }
}

/// What to measure.
#[derive(Clone, Debug)]
pub struct Options {
    /// Bodies, each in all sizes.
    pub bodies: Vec<Body>,
    /// Nodes, about.
    pub nodes: Vec<usize>,
    /// Young's modulus, Pa.
    pub young: f64,
    /// kg/m^3
    pub density: f64,
    /// Length of the sub-steps, s.
    pub step: f64,
    /// Timed solves per row.
    pub repeats: usize,
    /// Factors of more bytes are not computed.
    pub largest_factor: f64,
    /// How to solve.
    pub solver: Solver,
    /// Where.
    pub adapter: AdapterChoice,
}

/// A row of solids.csv. What has to do with the factorisation is missing where the factor is too large.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// `beam` or `block`.
    pub body: &'static str,
    /// Nodes.
    pub nodes: usize,
    /// Elements.
    pub elements: usize,
    /// Free components of the velocities.
    pub unknowns: usize,
    /// Young's modulus, Pa.
    pub young: f64,
    /// kg/m^3
    pub density: f64,
    /// Length of the sub-step, s.
    pub step: f64,
    /// `f32`, `mixed` or `f64`.
    pub precision: &'static str,
    /// Relative, of the true residual.
    pub tolerance: f64,
    /// `converged`, or how else the solve ended: `converged_to_rounding` where it passed with a residual above the tolerance, but
    /// below what rounding makes of it.
    pub status: &'static str,
    /// PCG iterations summed over rounds.
    pub iterations: u32,
    /// Rounds of refinement.
    pub rounds: u32,
    /// Degree of the preconditioner's polynomial.
    pub degree: u32,
    /// Products with S: of PCG and of its preconditioner.
    pub products: u32,
    /// True relative residual, f64.
    pub residual: f64,
    /// Seconds of a solve on the device.
    pub seconds_median: f64,
    /// Least.
    pub seconds_min: f64,
    /// Largest.
    pub seconds_max: f64,
    /// Bytes of the factor, found before it is computed.
    pub factor_bytes: f64,
    /// Seconds that the order of elimination takes, once for all sub-steps.
    pub ordering_seconds: f64,
    /// Median seconds of the factorisation, on all cores.
    pub factor_seconds: Option<f64>,
    /// Median seconds of the solve with the factor.
    pub substitution_seconds: Option<f64>,
    /// Seconds of factorisation and solve over those on the device.
    pub ratio: Option<f64>,
    /// Norm of the difference of both answers over that of the factorisation's.
    pub difference: Option<f64>,
    /// Bytes that the solve on the device must move.
    pub bytes: f64,
    /// Bytes per second over the copy bandwidth of the same run.
    pub share_of_copy_bandwidth: f64,
}

/// A row per body and size.
pub type Table = super::table::Table<Row>;

/// Measures all rows and writes solids.csv, solids.json and solids.svg into `out`, anew after each; `tell` hears of each row.
///
/// # Errors
/// Before any work [`Error::Output`] where the folder cannot be written and [`Error::Input`] where another process writes into it; then
/// [`Error::Check`] where a solve does not repeat, and what the simulation and the device say.
pub fn bench_solids(
    options: &Options,
    out: &Path,
    tell: &mut dyn FnMut(&Row),
) -> Result<Table, Error> {
    let _held = FolderLock::take(out)?;
    let mut table = Table {
        machine: Machine::new(&Gpu::new(&options.adapter)?, options.repeats)?,
        rows: Vec::new(),
    };
    for &body in &options.bodies {
        for &nodes in &options.nodes {
            let row = measure(&scene(body, nodes, options), body, options, &table.machine)?;
            tell(&row);
            table.rows.push(row);
            write(&table, out)?;
        }
    }
    Ok(table)
}

/// Writes the tables and the picture as they are so far.
fn write(table: &Table, out: &Path) -> Result<(), Error> {
    write_csv(&table.rows, &out.join("solids.csv"))?;
    write_json(table, &out.join("solids.json"))?;
    write_svg(&out.join("solids.svg"), (800, 600), |page| {
        draw(table, page)
    })
}

/// A body that hangs from its upper end and moves sideways.
fn scene(body: Body, nodes: usize, options: &Options) -> Scene {
    let cells = body.cells(nodes);
    let height = EDGE * body.height() as f64;
    let side = height + 4.0 * EDGE;
    let centre = DVec3::splat(0.5 * side);
    let size = DVec3::new(EDGE, height, EDGE);
    let domain = Domain {
        size: DVec3::splat(side),
        cells: [16; 3],
        gravity: DVec3::new(0.0, -9.81, 0.0),
        open: Sides::default(),
    };
    let top = centre.y + (0.5 - 0.5 / (body.height() * cells) as f64) * height;
    let pin = Pin {
        region: Shape::Box {
            min: DVec3::new(0.0, top, 0.0),
            max: domain.size,
        },
        components: [true; 3],
        keyframes: Vec::new(),
    };
    let solid = Solid {
        name: body.name().to_owned(),
        mesh: SolidMesh::Box {
            size,
            cells: [cells, body.height() * cells, cells],
        },
        placement: Placement {
            translate: centre,
            ..Placement::default()
        },
        initial: Initial {
            velocity: DVec3::new(1.0, 0.0, 0.3),
            ..Initial::default()
        },
        density: options.density,
        young: options.young,
        poisson: 0.4,
        model: ElasticModel::Corotational,
        mass_damping: 0.0,
        stiffness_damping: 0.0,
        pins: vec![pin],
        loads: Vec::new(),
    };
    Scene {
        name: body.name().to_owned(),
        file: "bench solids".into(),
        origins: Origins::default(),
        hash: String::new(),
        scale: 1.0,
        overrides: Vec::new(),
        time: Time {
            duration: options.step * FIRST_STEPS as f64,
            frames_per_second: 1.0 / options.step,
            cfl: 3.0,
            fixed_step: Some(options.step),
        },
        liquid: None,
        solids: vec![solid],
        obstacles: Vec::new(),
        sources: Vec::new(),
        sinks: Vec::new(),
        probes: Vec::new(),
        solver: options.solver,
        output: Output {
            particles: false,
            fields: false,
            solids: false,
            surface: false,
            every: 1,
            checkpoint_every: 0,
        },
        surface: SurfaceMesh::default(),
        camera: Camera::looking_at(&domain),
        domain,
    }
}

/// The system of a sub-step on the device, and what solves it.
struct Device<'a> {
    gpu: &'a Gpu,
    fields: SolidBuffers,
    buffers: SolidSystemBuffers,
    system: SolidSystem,
    solver: SolidSolver,
    polynomial: Polynomial,
    /// Displacements, and v* before the solve.
    state: State,
}

impl<'a> Device<'a> {
    /// Does a sub-step up to its solve.
    fn new(
        gpu: &'a Gpu,
        scene: &Scene,
        solids: &Solids,
        mut state: State,
    ) -> Result<Device<'a>, Error> {
        let dt = state.dt_last;
        let plan = SolidPlan {
            grid: scene.grid(),
            n_nodes: solids.rest.len(),
            n_elements: solids.elements.len(),
            n_turning: solids.rotating_bodies().count(),
            scripts: false,
            obstacles: false,
            real: variant(gpu.has_f64(), scene.solver.precision).real,
        };
        let fields = SolidBuffers::new(gpu, plan, solids)?;
        let buffers = SolidSystemBuffers::new(gpu, &SolidRows::new(solids)?, &scene.solver)?;
        let system = SolidSystem::new(gpu, &buffers, &fields, None)?;
        let rotations = element_rotations(gpu, &fields)?;
        fields.write_state(gpu, &state);
        gpu.upload(&fields.step, &[fields.step_of(scene.domain.gravity, dt)]);
        let mut recorder = Recorder::new(gpu);
        move_solid(gpu, &fields)?.record(&mut recorder);
        node_forces(gpu, &fields)?.record(&mut recorder);
        recorder.stage(Stage::SolidMatrices.name(), |pass| {
            rotations.record_in(pass);
            system.record_matrices(pass);
            system.record_right_hand_side(pass);
            system.record_contacts(pass);
        });
        recorder.submit();
        fields.read_state(gpu, &mut state)?;
        let bounds = Bounds::new(solids);
        let degree = bounds.chebyshev_degree(solids, dt);
        Ok(Device {
            gpu,
            solver: SolidSolver::new(gpu, &buffers, &fields, &scene.solver)?,
            polynomial: Polynomial::new(degree, bounds.block_jacobi),
            system,
            fields,
            buffers,
            state,
        })
    }

    /// Solves the system: seconds and verdict.
    fn solve(&self) -> Result<(f64, Outcome), Error> {
        self.fields.write_state(self.gpu, &self.state);
        self.gpu.wait("bench")?;
        let clock = Instant::now();
        let mut recorder = Recorder::new(self.gpu);
        recorder.stage(Stage::SolidMatrices.name(), |pass| {
            self.system.record_matrices(pass);
            self.system.record_hold(pass);
        });
        let (outcome, _) = self.solver.solve(
            self.gpu,
            recorder,
            &self.buffers,
            &self.fields,
            &self.polynomial,
        )?;
        Ok((clock.elapsed().as_secs_f64(), outcome))
    }

    /// Velocities of all nodes, m/s.
    fn velocity(&self) -> Result<Vec<[f64; 3]>, Error> {
        let mut state = State::default();
        self.fields.read_state(self.gpu, &mut state)?;
        Ok(state.node_velocity)
    }
}

/// Seconds of a factorisation, and how far its answer is from another.
struct Direct {
    factor: f64,
    substitution: f64,
    difference: f64,
}

fn measure(scene: &Scene, body: Body, options: &Options, machine: &Machine) -> Result<Row, Error> {
    let mut simulation = Simulation::new(scene, &Backend::Gpu(options.adapter.clone()))?;
    for _ in 0..FIRST_STEPS {
        simulation.step()?;
    }
    let state = simulation.state()?;
    let path = simulation.gpu_path().expect("benches run on the GPU path");
    let solids = simulation.solids();
    let device = Device::new(path.gpu(), scene, solids, state)?;
    let (_, outcome) = device.solve()?;
    let ended = Ended::alone(&outcome);

    let dt = device.state.dt_last;
    let pattern = Arc::new(BlockPattern::new(solids));
    let matrices = reference::solid_matrices(solids, &pattern, &device.state.displacement);
    let v_star = &device.state.node_velocity;
    let rhs = reference::solid_right_hand_side(solids, &matrices, v_star, dt);
    let freedom = reference::Freedom::all(solids);
    let twin = reference::SolidSystem::new(solids, matrices.stiffness, &rhs, v_star, freedom, dt);
    let matrix = twin.free_to_csr();
    let unknowns = twin.components();
    let clock = Instant::now();
    let symbolic = SymbolicCholesky::new(&matrix)?;
    let ordering_seconds = clock.elapsed().as_secs_f64();
    let factor_bytes = 8.0 * symbolic.n_factor_entries() as f64;

    let free = |x: &[f64]| -> Vec<f64> { unknowns.iter().map(|&at| x[at]).collect() };
    let what = format!("{} of {} nodes", body.name(), solids.rest.len());
    let mut seconds = Vec::new();
    let mut direct = Vec::new();
    for _ in 0..options.repeats.max(1) {
        let (elapsed, again) = device.solve()?;
        ended.ensure_repeated(Ended::alone(&again), &what)?;
        seconds.push(elapsed);
        if factor_bytes > options.largest_factor {
            continue;
        }
        let clock = Instant::now();
        let factor = symbolic.factorise_in_parallel(&matrix)?;
        let factorised = clock.elapsed().as_secs_f64();
        let mut x = free(&twin.rhs);
        factor.solve(&mut x);
        let solved = clock.elapsed().as_secs_f64();
        let found = free(device.velocity()?.as_flattened());
        let off: Vec<f64> = found.iter().zip(&x).map(|(found, x)| found - x).collect();
        direct.push(Direct {
            factor: factorised,
            substitution: solved - factorised,
            difference: norm(&off) / norm(&x),
        });
    }
    let seconds = Spread::of(seconds);
    let median = |value: fn(&Direct) -> f64| {
        (!direct.is_empty()).then(|| Spread::of(direct.iter().map(value).collect()).median)
    };
    let model = SolidBytes::new(solids, path.scalar_bytes());
    let degree = device.polynomial.degree;
    let [of_degree, iterations, rounds] =
        [degree, outcome.iterations, outcome.refinements].map(f64::from);
    let bytes = model.of_rows() + model.of_solve(of_degree, iterations, rounds);
    let status = ended.name(scene.solver.tolerance);
    let whole = median(|direct| direct.factor + direct.substitution)
        .filter(|_| status == SolveStatus::Converged.name());
    Ok(Row {
        body: body.name(),
        nodes: solids.rest.len(),
        elements: solids.elements.len(),
        unknowns: unknowns.len(),
        young: options.young,
        density: options.density,
        step: dt,
        precision: name(scene.solver.precision),
        tolerance: scene.solver.tolerance,
        status,
        iterations: outcome.iterations,
        rounds: outcome.refinements,
        degree,
        products: outcome.iterations * (degree + 1),
        residual: outcome.residual,
        seconds_median: seconds.median,
        seconds_min: seconds.min,
        seconds_max: seconds.max,
        factor_bytes,
        ordering_seconds,
        factor_seconds: median(|direct| direct.factor),
        substitution_seconds: median(|direct| direct.substitution),
        ratio: whole.map(|direct| direct / seconds.median),
        difference: median(|direct| direct.difference),
        bytes,
        share_of_copy_bandwidth: machine.share_of_copy_bandwidth(bytes, seconds.median),
    })
}

/// Seconds against nodes, log-log: on the device with bars from least to largest, and of factorisation and solve.
fn draw(table: &Table, page: SVGBackend) -> Result<(), Failure> {
    let root = page.into_drawing_area();
    root.fill(&WHITE)?;
    let nodes = |row: &Row| Spread::exact(row.nodes as f64);
    let on_device = |row: &Row| Spread {
        median: row.seconds_median,
        min: row.seconds_min,
        max: row.seconds_max,
    };
    let direct = |row: &Row| Some(row.factor_seconds? + row.substitution_seconds?);
    let mut all = series(
        &table.rows,
        |row| format!("{}, this solve", row.body),
        |row| Point {
            x: nodes(row),
            y: on_device(row),
        },
    );
    all.extend(series(
        table.rows.iter().filter(|row| direct(row).is_some()),
        |row| format!("{}, sparse Cholesky", row.body),
        |row| Point {
            x: nodes(row),
            y: Spread::exact(direct(row).unwrap_or_default()),
        },
    ));
    let caption = format!("Solve of solids, {}", table.machine.adapter);
    let key = SeriesLabelPosition::UpperLeft;
    chart(&root, &caption, ["nodes", "seconds"], key, &all)?;
    root.present()?;
    Ok(())
}
