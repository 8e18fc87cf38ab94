//! The plan of a scene: effects, stages with their kernels, buffers and limits. Nothing is seeded or allocated.

use crate::Error;
use crate::effects::{Effect, Effects};
use crate::elastic::{Bounds, Cavities, Solids};
use crate::fields::SolidRows;
use crate::geometry::{self, ObstacleCut, SolidClip, SourceFlow, SourcesAndSinks};
use crate::gpu::{AdapterReport, BufferPlan, Gpu, Variant};
use crate::grid::Grid;
use crate::reference::{StepLimits, TimeStep};
use crate::scene::{CouplingScheme, Formulation, Precision, Preconditioner, Scene, Solver};
use crate::solver::{self};
use crate::step::{Runner, SCHEDULE, Stage, When};

use super::GpuPath;
use super::memory::HostMemory;

/// Labels of buffers that scale with the markers instead of the grid.
const PER_MARKER: [&str; 2] = ["liquid.markers", "level.marker_velocity"];

/// A stage of a sub-step.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StagePlan {
    /// Name in the schedule.
    pub name: &'static str,
    /// Whether the stage runs in every sub-step; otherwise once, before the first.
    pub every_step: bool,
    /// Backends that run it.
    pub runner: Runner,
    /// Kernels, in the order in which they are compiled.
    pub kernels: Vec<&'static str>,
}

/// The plan of a scene on an adapter with or without f64.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The grid.
    pub grid: Grid,
    /// Cells of the device's padded layout.
    pub padded_cells: usize,
    /// Number of markers, estimated to about 1 %.
    pub n_markers: usize,
    /// Nodes of all solids.
    pub n_nodes: usize,
    /// Elements of all solids.
    pub n_elements: usize,
    /// Flow rates of the sources, in the order of the scene.
    pub sources: Vec<SourceFlow>,
    /// The first sub-step.
    pub first_step: TimeStep,
    /// All effects, active or not.
    pub effects: Vec<Effect>,
    /// Stages of a sub-step, in order.
    pub stages: Vec<StagePlan>,
    /// All device buffers of the simulation. Buffers with the same label are one entry with the sum of their
    /// elements.
    pub buffers: Vec<BufferPlan>,
    /// Solver of each system of a sub-step.
    pub solves: Vec<String>,
    /// Whether the host computes the residuals of the outer loop, with one exchange per refinement step.
    pub host_turns: bool,
    /// Bytes that such a refinement step copies to and from the device.
    pub bytes_per_turn: u64,
    /// Solver settings of the scene.
    solver: Solver,
    /// Scalar types of the solves.
    variant: Variant,
    /// Whether liquid and solids are solved together.
    together: bool,
}

impl Plan {
    /// Plans a scene for an adapter, or without one for an adapter with f64.
    ///
    /// # Errors
    /// [`Error::Input`] when a mesh file is unusable, [`Error::Memory`] when clipping of the solids exceeds the free
    /// memory.
    pub fn new(scene: &Scene, adapter: Option<&AdapterReport>) -> Result<Plan, Error> {
        let solids = super::solids_of(scene)?;
        let effects = Effects::of(scene);
        let (mut clip, mut taps) = (None, SourcesAndSinks::default());
        let mut obstacles = None;
        let grid = scene.grid();
        let mut distance = Vec::new();
        let bodies_meet = effects.solids && !scene.obstacles.is_empty();
        if effects.clips() || effects.sources || effects.sinks || bodies_meet {
            HostMemory::new(scene, &solids, false)?.check()?;
            let cut = obstacles.insert(geometry::obstacle_cut(scene, &grid)?);
            clip = super::first_clip(scene, &solids, cut);
            taps = SourcesAndSinks::new(scene, &grid, cut.static_cut())?;
            distance.clone_from(&cut.cut.solid_distance);
        }
        solids.ensure_clearance(scene, &distance, &solids.initial_state(scene).0)?;
        let parts = (&mut clip, &mut taps);
        let plan = Plan::with(scene, &solids, obstacles.as_ref(), parts, adapter)?;
        let regions = scene.liquid.iter().flat_map(|liquid| &liquid.regions);
        if regions.count() > 0 && plan.n_markers == 0 {
            // With a fixed surface there are no markers, and an estimate of zero may be wrong: a run checks all
            // cells.
            HostMemory::new(scene, &solids, false)?.check()?;
            let obstacles = geometry::obstacle_cut(scene, &grid)?;
            super::first_state(scene, &solids, &obstacles, clip.as_ref())?;
        }
        Ok(plan)
    }

    /// Plans a scene with its solids, sources and sinks. `obstacles`: required if any moves. `clip`: initial clipping in liquid. Both are lent to the planning device.
    pub(super) fn with(
        scene: &Scene,
        solids: &Solids,
        obstacles: Option<&ObstacleCut>,
        (clip, taps): (&mut Option<SolidClip>, &mut SourcesAndSinks),
        adapter: Option<&AdapterReport>,
    ) -> Result<Plan, Error> {
        let grid = scene.grid();
        let effects = Effects::of(scene);
        let f64 = adapter.is_none_or(|adapter| adapter.f64);
        let (displacement, _) = solids.initial_state(scene);
        let n_markers = geometry::estimate_markers(scene, &grid, &solids.moved(&displacement))?;
        let mixed = scene.solver.precision == Precision::Mixed;
        let host_turns = mixed && !f64;
        let padded_cells = grid.padded().len();
        let rows = SolidRows::new(solids)?;
        let n_turning = solids.rotating_bodies().count();
        let gpu = Gpu::planning(adapter.cloned().unwrap_or_default());
        let parts = (solids, clip.take(), std::mem::take(taps));
        let path = GpuPath::allocate(gpu.clone(), scene, parts, n_markers)?;
        (*clip, *taps) = path.into_geometry();
        let taps = &*taps;
        let first_step = first_step(scene, (solids, obstacles, taps));
        Ok(Plan {
            padded_cells,
            n_markers,
            sources: taps.flows().collect(),
            first_step,
            effects: explained(scene, &effects, (n_turning, Cavities::in_liquid(scene, solids).len())),
            stages: stages(&effects, scene, &gpu),
            buffers: buffers(&gpu),
            n_nodes: solids.rest.len(),
            n_elements: solids.elements.len(),
            solves: solves(scene, (solids, first_step.dt), &rows, f64),
            host_turns,
            bytes_per_turn: bytes_per_turn(&effects, padded_cells, solids.rest.len()),
            solver: scene.solver,
            variant: crate::fields::variant(f64, scene.solver.precision),
            together: effects.coupling && scene.solver.coupling != CouplingScheme::Weak,
            grid,
        })
    }

    /// Total bytes of all buffers.
    pub fn bytes(&self) -> u64 {
        self.buffers.iter().map(BufferPlan::bytes).sum()
    }

    /// Bytes of the buffers that scale with the grid, per cell of the padded layout.
    pub fn bytes_per_cell(&self) -> f64 {
        let markers = self.marker_bytes();
        (self.bytes() - markers) as f64 / self.padded_cells as f64
    }

    /// Bytes of the buffers that scale with the markers, per marker; 0 without markers.
    pub fn bytes_per_marker(&self) -> f64 {
        self.marker_bytes() as f64 / self.n_markers.max(1) as f64
    }

    fn marker_bytes(&self) -> u64 {
        let marker_buffers = self.buffers.iter().filter(|plan| PER_MARKER.contains(&&*plan.label));
        marker_buffers.map(BufferPlan::bytes).sum()
    }

    /// Checks that the scene's formulation suits the coupled solve. This part of [`Plan::check`] needs no adapter.
    pub fn check_formulation(&self) -> Result<(), Error> {
        match self.together {
            true => solver::check_formulation(self.n_nodes, &self.solver, self.variant),
            false => Ok(()),
        }
    }

    /// Checks limits, precision, formulation and every buffer against an adapter.
    pub fn check(&self, adapter: &AdapterReport) -> Result<(), Error> {
        adapter.check_limits()?;
        adapter.check_precision(self.solver.precision == Precision::F64)?;
        self.check_formulation()?;
        let mut largest_first: Vec<&BufferPlan> = self.buffers.iter().collect();
        largest_first.sort_by_key(|plan| std::cmp::Reverse(plan.bytes()));
        largest_first.into_iter().try_for_each(|plan| {
            let mut checked = adapter.check_buffer(&plan.label, plan.bytes());
            if let Err(Error::Limit { cure, .. }) = &mut checked {
                // The group in a label names the owner of the buffer.
                let smaller = match &*plan.label {
                    label if label.starts_with("solid") => "coarser meshes of the solids",
                    label if label.starts_with("condensed") => "solver.formulation = \"two_field\"",
                    _ => "fewer cells (--scale)",
                };
                *cure = format!("use {smaller}, another adapter (--adapter), or --backend cpu");
            }
            checked
        })
    }
}

/// Scaled residual to the device, and correction back, both f32: one word per cell of the pressure, the solver's
/// words, and one quad per node.
fn bytes_per_turn(effects: &Effects, padded_cells: usize, n_nodes: usize) -> u64 {
    let cells = if effects.liquid { 4 * 3 * padded_cells } else { 0 };
    (cells + 4 * 2 * 4 * n_nodes) as u64
}

fn first_step(scene: &Scene, (solids, obstacles, taps): (&Solids, Option<&ObstacleCut>, &SourcesAndSinks)) -> TimeStep {
    let liquid_speed = scene.liquid.as_ref().map_or(0.0, geometry::initial_speed);
    let (_, velocity) = solids.initial_state(scene);
    let nodes = velocity.as_flattened().iter();
    let solid_speed = nodes.fold(0.0, |speed, v| f64::max(speed, v.abs()));
    let frame = 1.0 / scene.time.frames_per_second;
    let source_speed = taps.speed(0.0, [0.0, frame], scene.time.cfl);
    let obstacle_speed = obstacles.map_or(0.0, |cut| cut.max_speed(0.0, frame));
    let speed = liquid_speed.max(solid_speed);
    let speed = speed.max(obstacle_speed).max(source_speed);
    let speed = speed.max(solids.max_script_speed(0.0, frame));
    let accelerations = obstacles.map_or(Vec::new(), ObstacleCut::accelerations);
    let limits = StepLimits::new(scene, accelerations, Some(solids));
    limits.time_step(speed, [0.0, frame], [0.0; 2])
}

/// Effects of the scene and of its meshes, such as bodies that turn.
fn explained(scene: &Scene, effects: &Effects, (n_turning, n_cavities): (usize, usize)) -> Vec<Effect> {
    let mut lines = effects.explained(scene);
    let after = lines.iter().position(|line| line.name == "corotation");
    let turning = Effect {
        name: "turning",
        active: n_turning > 0,
        reason: match n_turning {
            _ if !effects.solids => "there are no solids".to_owned(),
            0 => "no corotational body that is free, on rollers along one axis, or constrained at a point or along a line"
                .to_owned(),
            n => format!("{n} corotational bodies, free, on rollers along one axis, or constrained at a point or along a line"),
        },
    };
    lines.insert(after.map_or(lines.len(), |index| index + 1), turning);
    let after = lines.iter().position(|line| line.name == "coupling");
    let cavities = Effect {
        name: "cavities",
        active: n_cavities > 0,
        reason: match n_cavities {
            _ if !effects.coupling => "there is no liquid with solids".to_owned(),
            0 => "no solid has a cavity of 8 cells, there are sources or sinks, or solver.coupling is not \"strong\""
                .to_owned(),
            n => format!("{n} in solids: liquid that fills one keeps its volume"),
        },
    };
    lines.insert(after.map_or(lines.len(), |index| index + 1), cavities);
    lines
}

/// Active stages with the kernels recorded by a planning device.
fn stages(effects: &Effects, scene: &Scene, gpu: &Gpu) -> Vec<StagePlan> {
    let kernels_by_stage = gpu.stage_kernels();
    let kernels_of = |stage: Stage| {
        let own = kernels_by_stage.iter().filter(move |(name, _)| *name == stage.name());
        own.map(|(_, kernel)| *kernel)
    };
    let mut plans = Vec::new();
    for row in &SCHEDULE {
        let when = (row.when)(effects);
        let mut kernels: Vec<_> = kernels_of(row.stage).collect();
        if row.stage == Stage::Solve && scene.solver.coupling == CouplingScheme::DampingOnly {
            // The systems with elasticity only and with damping only.
            kernels.extend(kernels_of(Stage::SolidMatrices));
            kernels.extend(["solid_right_hand_side", "hold_nodes", "solid_diagonals"]);
        }
        if when != When::Never && !kernels.is_empty() {
            plans.push(StagePlan {
                name: row.name,
                every_step: when == When::EverySubStep,
                runner: row.runner,
                kernels,
            });
        }
    }
    plans
}

/// Buffers recorded by a planning device, one entry per label.
fn buffers(gpu: &Gpu) -> Vec<BufferPlan> {
    let mut merged: Vec<BufferPlan> = Vec::new();
    for plan in gpu.buffer_plans() {
        match merged.iter_mut().find(|other| other.label == plan.label) {
            Some(other) => other.len += plan.len,
            None => merged.push(plan),
        }
    }
    merged
}

/// Solver of the pressure, then of the solids.
fn solves(scene: &Scene, (solids, first_dt): (&Solids, f64), rows: &SolidRows, f64: bool) -> Vec<String> {
    let solver = &scene.solver;
    let numbers = match (solver.precision, f64) {
        (Precision::F32, _) => "all in f32",
        (Precision::Mixed, true) => "unknowns and residual in f64, corrections in f32",
        (Precision::Mixed, false) => "unknowns and residual in f64 on the host, corrections in f32",
        (Precision::F64, _) => "all in f64",
    };
    let preconditioner = match solver.preconditioner {
        Preconditioner::Multigrid => "aggregation multigrid",
        Preconditioner::Jacobi | Preconditioner::BlockJacobi => "Jacobi",
    };
    let tolerance = solver.tolerance;
    let mut solves = Vec::new();
    if Effects::of(scene).coupling {
        let form = "two-field (thesis 5.25, factored), conjugate gradients with";
        let two_field = match solver.preconditioner {
            Preconditioner::Multigrid => {
                format!("{form} {preconditioner} on B and a Chebyshev polynomial on S")
            }
            Preconditioner::Jacobi => format!("{form} its diagonal"),
            Preconditioner::BlockJacobi => {
                format!("{form} its diagonal, of nodes with their 3x3 blocks")
            }
        };
        let together = match solver::can_condense(rows, solver, f64) {
            true => {
                let (worth, most) = (solver::WORTH_WETTED / 3, solver::MOST_WETTED / 3);
                let touching = match solver.solid_contact && solver.formulation == Formulation::Auto {
                    true => format!(", {most} while contact pushes a solid"),
                    false => String::new(),
                };
                let most = match solver.formulation {
                    Formulation::Condensed => most.to_string(),
                    Formulation::Auto | Formulation::TwoField => {
                        format!("{worth} (of stiff solids {most})")
                    }
                };
                format!(
                    "condensed, conjugate gradients with {preconditioner} on B, where at most {most} nodes are wet{touching}, else {two_field}"
                )
            }
            false => two_field,
        };
        let together = format!("{together}; {numbers}, both residuals of the indefinite system {tolerance:.0e}");
        solves.push(match solver.coupling {
            CouplingScheme::Strong => {
                format!("where they touch, liquid and solids together: {together}")
            }
            CouplingScheme::DampingOnly => format!(
                "where they touch, solids by themselves without damping, then liquid and solids together without elasticity: {together}"
            ),
            CouplingScheme::Weak => "the pressure against the velocities of the nodes before the sub-step, then the nodes under that pressure"
                .to_owned(),
        });
    }
    if scene.liquid.is_some() {
        solves.push(format!(
            "pressure alone (cut-cell, ghost-fluid Laplacian), conjugate gradients with {preconditioner}, {numbers}, true \
             residual {tolerance:.0e}"
        ));
    }
    if !solids.bodies.is_empty() {
        let degree = Bounds::new(solids).chebyshev_degree(solids, first_dt);
        solves.push(format!(
            "velocity of the nodes (S v = M v*/dt - K x* + b + loads), conjugate gradients with a Chebyshev polynomial in \
             block-Jacobi (degree {degree} at first), {numbers}, true residual {tolerance:.0e}; {} nodes, {} blocks off the \
             diagonal",
            solids.rest.len(),
            rows.n_blocks()
        ));
    }
    solves
}
