//! Table 6.1: grids and meshes of the thesis's scenes and those of `scenes/`, and the seconds of their first sub-steps.
//!
//! The thesis prints the seconds of a step and of its pressure projection, and steps per frame, for all scenes together and whole runs (section 6.1).
//! Here the liquid does not touch the solid yet in some scenes.

use super::Options;
use crate::Error;
use crate::measure::bench::Case;
use crate::measure::bench::ended::{Ended, is_solved};
use crate::measure::bench::statistics::Spread;
use crate::measure::bench::sub_step::stage_seconds;
use crate::measure::bench::table::{Row, columns, row};
use crate::scene::{Precision, Scene};
use crate::sim::{Backend, Simulation};
use crate::state::{SolveReport, SolveStatus, StepReport};

/// Thesis, table 6.1: name, scene here, cells along an edge, nodes, elements. Only the light one of its three balls, and the sphere of figure 6.6.
const PRINTED: [(&str, &str, usize, usize, usize); 7] = [
    ("Dam Break", "dam_break", 100, 725, 2688),
    ("Buoyancy", "buoyancy_light", 100, 481, 2000),
    ("Compressibility", "compressibility", 100, 343, 1296),
    ("Thin Solid 1", "sloped_panel", 100, 882, 2400),
    ("Thin Solid 2", "platform", 64, 2450, 6936),
    ("Fluid in Sphere", "fluid_in_sphere", 100, 992, 2948),
    ("Light Dino", "light_dino", 100, 1424, 5920),
];

/// Stages of the pressure projection: set-up of its system, solve, and update of the velocities.
const PROJECTION: [&str; 6] =
    ["active_cells", "closed_components", "solid_matrices", "right_hand_side", "solve", "write_back"];

columns! {
    SCENES {
        + table "" "number of the table";
        + name "" "name in the thesis";
        + scene "" "name of the scene";
        - scale "" "factor of its cells along each axis";
        - precision "" "`f32`, `mixed` or `f64`";
        + cells "" "cells of the domain";
        + thesis_cells "" "printed";
        + nodes "" "of the solid";
        + thesis_nodes "" "printed";
        + elements "" "of the solid";
        + thesis_elements "" "printed";
        - sub_steps "" "timed sub-steps";
        - touching "" "those in which the liquid touches the solid";
        + status "" "of the first solve that did not converge";
        ~ seconds "s" "wall clock of a sub-step; printed: means of 18 to 59 s";
        ~ projection "s" "pressure projection on the device; printed: 3.5 to 39 s";
        - solve_median "s" "the solve alone";
        + sub_steps_per_frame "" "printed: 4.42, the mean of all scenes";
    }
}

/// A case per scene of table 6.1 and precision, if the table is selected; `f64`: whether the device has it.
pub(super) fn cases(options: &Options, f64: bool) -> Result<Vec<Case<'_>>, Error> {
    let mut cases = Vec::new();
    if !options.has("6.1") {
        return Ok(cases);
    }
    for (number, (_, scene, ..)) in PRINTED.iter().enumerate() {
        let file = options.scenes.join(format!("{scene}.toml"));
        if !file.is_file() {
            let problem = format!("{scene}.toml of table 6.1 is not there");
            let cure = "give the folder scenes of cutwater's source, or --tables without 6.1";
            return Err(Error::input(format!("--scenes {}", options.scenes.display()), problem, cure));
        }
        for &precision in options.precisions.iter().filter(|&&precision| f64 || precision != Precision::F64) {
            let precision = format!("solver.precision={}", precision.name());
            let scene = Scene::load(&file, &[precision], options.scale)?;
            let key = row! { scene: scene.name.as_str(), precision: scene.solver.precision.name() };
            cases.push(Case::new("thesis_scenes", key, move |_| {
                Ok(vec![("thesis_scenes", measure(number, &scene, options)?)])
            }));
        }
    }
    Ok(cases)
}

fn measure(number: usize, scene: &Scene, options: &Options) -> Result<Row, Error> {
    let mut simulation = Simulation::new(scene, &Backend::Gpu(options.adapter.clone()))?;
    // The first compiles.
    simulation.step()?;
    let reports = (0..options.steps.max(1)).map(|_| simulation.step()).collect::<Result<Vec<StepReport>, _>>()?;
    let (name, _, grid, nodes, elements) = PRINTED[number];
    let ended = reports.iter().map(|report| {
        let solves: Vec<SolveReport> = report.solves().collect();
        Ended::new(&solves).name(scene.solver.tolerance)
    });
    let converged = SolveStatus::Converged.name();
    let ended = ended.min_by_key(|&word| (is_solved(word), word == converged));
    let spread = |seconds: &dyn Fn(&StepReport) -> f64| Spread::of(reports.iter().map(seconds).collect());
    let timestamps = simulation.adapter().is_some_and(|adapter| adapter.timestamps);
    let stages_spread = |stages: &[&str]| timestamps.then(|| spread(&|report| stage_seconds(report, stages)));
    let time: f64 = reports.iter().map(|report| report.dt).sum();
    let solids = simulation.solids();
    Ok(row! {
        table: "6.1", name, scene: scene.name.as_str(), scale: scene.scale, precision: scene.solver.precision.name(),
        cells: scene.grid().n_cells(), thesis_cells: grid.pow(3), nodes: solids.rest.len(), thesis_nodes: nodes,
        elements: solids.elements.len(), thesis_elements: elements, sub_steps: reports.len(),
        touching: reports.iter().filter(|report| report.touching()).count(), status: ended.unwrap_or(converged),
        seconds: spread(&|report| report.seconds_total), projection: stages_spread(&PROJECTION),
        solve_median: stages_spread(&["solve"]).map(|solve| solve.median),
        sub_steps_per_frame: reports.len() as f64 / (time * scene.time.frames_per_second),
    })
}
