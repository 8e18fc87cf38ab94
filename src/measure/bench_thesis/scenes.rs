//! Table 6.1: grids and meshes of the thesis's scenes beside those of `scenes/`, and what a sub-step of them takes. The thesis tells the
//! seconds of a step and of its pressure projection, and steps per frame, of all its scenes together and over whole runs (section 6.1);
//! here the device's first sub-steps are timed, when the liquid does not touch the solid yet in some scenes.

use serde::Serialize;

use super::{Options, ThesisTable};
use crate::Error;
use crate::measure::bench_solve::{Ended, is_solved, name};
use crate::measure::statistics::Spread;
use crate::scene::{Precision, Scene};
use crate::sim::{Backend, Simulation};
use crate::state::{SolveReport, SolveStatus, StepReport};

/// A line of the thesis's table.
pub(super) struct Printed {
    name: &'static str,
    /// What the scene is called here.
    scene: &'static str,
    /// Cells along an edge.
    grid: usize,
    nodes: usize,
    elements: usize,
}

/// Thesis, table 6.1. Of its three balls the light one, of its two spheres that of figure 6.6.
static PRINTED: [Printed; 7] = [
    printed("Dam Break", "dam_break", 100, [725, 2688]),
    printed("Buoyancy", "buoyancy_light", 100, [481, 2000]),
    printed("Compressibility", "compressibility", 100, [343, 1296]),
    printed("Thin Solid 1", "sloped_panel", 100, [882, 2400]),
    printed("Thin Solid 2", "platform", 64, [2450, 6936]),
    printed("Fluid in Sphere", "fluid_in_sphere", 100, [992, 2948]),
    printed("Light Dino", "light_dino", 100, [1424, 5920]),
];

const fn printed(
    name: &'static str,
    scene: &'static str,
    grid: usize,
    [nodes, elements]: [usize; 2],
) -> Printed {
    Printed {
        name,
        scene,
        grid,
        nodes,
        elements,
    }
}

/// Seconds of a step, the least and the largest mean of a scene; of its pressure projection; steps per frame, the mean of all scenes.
const PRINTED_SECONDS: [f64; 2] = [18.0, 59.0];
const PRINTED_PROJECTION: [f64; 2] = [3.5, 39.0];
const PRINTED_SUB_STEPS: f64 = 4.42;

/// Stages that are the pressure projection: what makes its system, the solve, and what takes the pressure to the velocities.
const PROJECTION: [&str; 6] = [
    "active_cells",
    "closed_components",
    "solid_matrices",
    "right_hand_side",
    "solve",
    "write_back",
];

/// A row of thesis_scenes.csv. Seconds of stages are empty where the adapter cannot tell them.
#[derive(Clone, Debug, Serialize)]
pub struct SceneRow {
    /// Number of the table.
    pub table: &'static str,
    /// Name in the thesis.
    pub name: &'static str,
    /// Name of the scene.
    pub scene: String,
    /// What its cells are multiplied by along each axis.
    pub scale: f64,
    /// `f32`, `mixed` or `f64`.
    pub precision: &'static str,
    /// Cells of the domain.
    pub cells: usize,
    /// Printed.
    pub thesis_cells: usize,
    /// Over the printed ones.
    pub ratio_cells: f64,
    /// Of the solid.
    pub nodes: usize,
    /// Printed.
    pub thesis_nodes: usize,
    /// Over the printed ones.
    pub ratio_nodes: f64,
    /// Of the solid.
    pub elements: usize,
    /// Printed.
    pub thesis_elements: usize,
    /// Over the printed ones.
    pub ratio_elements: f64,
    /// Sub-steps timed.
    pub sub_steps: usize,
    /// Those in which the liquid touches the solid.
    pub touching: usize,
    /// How the first solve ended that did not converge.
    pub status: &'static str,
    /// Wall-clock seconds of a sub-step.
    pub seconds_median: f64,
    /// Least.
    pub seconds_min: f64,
    /// Largest.
    pub seconds_max: f64,
    /// Printed: of the fastest scene.
    pub thesis_seconds_least: f64,
    /// Of the slowest.
    pub thesis_seconds_largest: f64,
    /// Of the pressure projection on the device: its system, the solve, and the velocities that follow; without what the CPU does of it in between.
    pub projection_median: Option<f64>,
    /// Least.
    pub projection_min: Option<f64>,
    /// Largest.
    pub projection_max: Option<f64>,
    /// Of the solve alone, median.
    pub solve_median: Option<f64>,
    /// Printed: of the projection of the fastest scene.
    pub thesis_projection_least: f64,
    /// Of the slowest.
    pub thesis_projection_largest: f64,
    /// Sub-steps timed over the frames that they fill.
    pub sub_steps_per_frame: f64,
    /// Printed: the mean of all scenes.
    pub thesis_sub_steps_per_frame: f64,
}

/// The scenes of table 6.1, where it is asked for, in each precision; `f64`: whether the device has it.
///
/// # Errors
/// [`Error::Input`] where the folder lacks one, and what its file says.
pub(super) fn load(options: &Options, f64: bool) -> Result<Vec<(&'static Printed, Scene)>, Error> {
    let mut scenes = Vec::new();
    if !options.tables.contains(&ThesisTable::T6_1) {
        return Ok(scenes);
    }
    for printed in &PRINTED {
        let file = options.scenes.join(format!("{}.toml", printed.scene));
        if !file.is_file() {
            return Err(Error::input(
                format!("--scenes {}", options.scenes.display()),
                format!("{}.toml of table 6.1 is not there", printed.scene),
                "give the folder scenes of cutwater's source, or --tables without 6.1",
            ));
        }
        let precisions = options.precisions.iter();
        for &precision in precisions.filter(|&&precision| f64 || precision != Precision::F64) {
            let precision = format!("solver.precision={}", name(precision));
            scenes.push((printed, Scene::load(&file, &[precision], options.scale)?));
        }
    }
    Ok(scenes)
}

/// Gives `take` a row per scene.
pub(super) fn measure(
    scenes: &[(&'static Printed, Scene)],
    options: &Options,
    take: &mut dyn FnMut(SceneRow) -> Result<(), Error>,
) -> Result<(), Error> {
    let backend = Backend::Gpu(options.adapter.clone());
    for (printed, scene) in scenes {
        let mut simulation = Simulation::new(scene, &backend)?;
        // The first compiles.
        simulation.step()?;
        let steps = (0..options.steps.max(1)).map(|_| simulation.step());
        let reports = steps.collect::<Result<Vec<StepReport>, _>>()?;
        take(SceneRow::of(printed, scene, &simulation, &reports))?;
    }
    Ok(())
}

impl SceneRow {
    fn of(
        printed: &Printed,
        scene: &Scene,
        simulation: &Simulation,
        reports: &[StepReport],
    ) -> SceneRow {
        let cells = [scene.grid().n_cells(), printed.grid.pow(3)];
        let nodes = [simulation.solids().rest.len(), printed.nodes];
        let elements = [simulation.solids().elements.len(), printed.elements];
        let ratio = |[here, printed]: [usize; 2]| here as f64 / printed as f64;
        let ended = reports.iter().map(|report| {
            let solves: Vec<SolveReport> = report.solves().collect();
            Ended::of_reports(&solves).name(scene.solver.tolerance)
        });
        // The first that failed, or passed above the tolerance.
        let converged = SolveStatus::Converged.name();
        let ended = ended.min_by_key(|&word| (is_solved(word), word == converged));
        let touching = |report: &&StepReport| report.coupling.is_some_and(|both| both.touching);
        let spread = |seconds: &dyn Fn(&StepReport) -> f64| {
            Spread::of(reports.iter().map(seconds).collect())
        };
        let of_stages = |stages: &[&str]| {
            let told = simulation
                .adapter()
                .is_some_and(|adapter| adapter.timestamps);
            told.then(|| {
                spread(&|report| {
                    let seconds = report.seconds.iter();
                    let of_stages = seconds.filter(|(stage, _)| stages.contains(stage));
                    of_stages.map(|(_, seconds)| seconds).sum()
                })
            })
        };
        let seconds = spread(&|report| report.seconds_total);
        let projection = of_stages(&PROJECTION);
        let time: f64 = reports.iter().map(|report| report.dt).sum();
        SceneRow {
            table: ThesisTable::T6_1.number(),
            name: printed.name,
            scene: scene.name.clone(),
            scale: scene.scale,
            precision: name(scene.solver.precision),
            cells: cells[0],
            thesis_cells: cells[1],
            ratio_cells: ratio(cells),
            nodes: nodes[0],
            thesis_nodes: nodes[1],
            ratio_nodes: ratio(nodes),
            elements: elements[0],
            thesis_elements: elements[1],
            ratio_elements: ratio(elements),
            sub_steps: reports.len(),
            touching: reports.iter().filter(touching).count(),
            status: ended.unwrap_or(converged),
            seconds_median: seconds.median,
            seconds_min: seconds.min,
            seconds_max: seconds.max,
            thesis_seconds_least: PRINTED_SECONDS[0],
            thesis_seconds_largest: PRINTED_SECONDS[1],
            projection_median: projection.map(|projection| projection.median),
            projection_min: projection.map(|projection| projection.min),
            projection_max: projection.map(|projection| projection.max),
            solve_median: of_stages(&["solve"]).map(|solve| solve.median),
            thesis_projection_least: PRINTED_PROJECTION[0],
            thesis_projection_largest: PRINTED_PROJECTION[1],
            sub_steps_per_frame: reports.len() as f64 / (time * scene.time.frames_per_second),
            thesis_sub_steps_per_frame: PRINTED_SUB_STEPS,
        }
    }
}
