//! The schedule of a sub-step (Zarifi's thesis, algorithm 4) and the driver that runs it.
//!
//! [`SCHEDULE`] alone defines the order. Both backends implement [`Backend`]; [`run`] calls their stages row by row.
//! `plan`, `compare`, `bench step`, the stage columns of `steps.csv` and the lists in the documentation derive from
//! the table.

use crate::Error;
use crate::effects::Effects;

/// A stage of a sub-step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// See [`SCHEDULE`] for every stage.
    TimeStep,
    /// Motion of the nodes.
    MoveSolid,
    /// Cut cells.
    Clip,
    /// Motion of the markers.
    AdvectMarkers,
    /// Sources and sinks.
    Exchange,
    /// Narrow band.
    Band,
    /// Transport of the level set.
    AdvectLevel,
    /// Advection of face velocities.
    AdvectVelocity,
    /// Body forces.
    Forces,
    /// Density of the markers.
    Occupancy,
    /// Bounds of the level by the markers.
    BoundLevel,
    /// Distance to the surface of the level.
    Redistance,
    /// Smoothing along the surface.
    FilterLevel,
    /// Surface of the liquid.
    LiquidDistance,
    /// Connected liquid and its volume.
    LiquidComponents,
    /// Volume of the level.
    VolumeShift,
    /// Source of crowded markers.
    Excess,
    /// Markers below the surface.
    MarkerBand,
    /// Spray that lands.
    Landing,
    /// Unknowns of the pressure.
    ActiveCells,
    /// Components without a free surface.
    ClosedComponents,
    /// Matrices of the solids.
    SolidMatrices,
    /// Right-hand sides.
    RightHandSide,
    /// Solution of the systems.
    Solve,
    /// Projection of the velocity.
    WriteBack,
    /// Velocities beyond the liquid.
    Extrapolate,
    /// Markers that fly.
    Spray,
    /// Sums and extremes.
    Diagnose,
    /// Measurements.
    Probe,
}

/// When a stage runs in a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum When {
    /// Not active in the scene.
    Never,
    /// Once, after a state is written.
    Once,
    /// In every sub-step.
    EverySubStep,
}

/// Who runs a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Runner {
    /// Both backends, within the sub-step.
    Both,
    /// Only the GPU, within the sub-step. These stages build lists that save work; the f64 path computes the same
    /// cells without them.
    Gpu,
    /// The run loop, before or after the sub-step.
    RunLoop,
}

/// A row of the schedule.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// The stage.
    pub stage: Stage,
    /// Its name in labels, tables and messages.
    pub name: &'static str,
    /// One sentence, with the source.
    pub sentence: &'static str,
    /// Who runs it.
    pub runner: Runner,
    /// When it runs.
    pub when: fn(&Effects) -> When,
}

fn every(present: bool) -> When {
    match present {
        true => When::EverySubStep,
        false => When::Never,
    }
}

fn every_or_once(every_sub_step: bool, present: bool) -> When {
    match (present, every_sub_step) {
        (false, _) => When::Never,
        (true, true) => When::EverySubStep,
        (true, false) => When::Once,
    }
}

/// The stages in order.
pub const SCHEDULE: [Row; 29] = [
    Row {
        stage: Stage::TimeStep,
        name: "time_step",
        sentence: "The largest sub-step that velocities, accelerations and frame times allow.",
        runner: Runner::RunLoop,
        when: |_| When::EverySubStep,
    },
    Row {
        stage: Stage::MoveSolid,
        name: "move_solid",
        sentence: "Moves the nodes of the solids: on circles for bodies that are free or hinged, by g dt^2 / 2 more for those that touch \
                   nothing, then out of walls.",
        runner: Runner::Both,
        when: |effects| every(effects.solids),
    },
    Row {
        stage: Stage::Clip,
        name: "clip",
        sentence: "Clips obstacles and solids against the grid: face apertures, distances, coupling matrix J (thesis, chapter 5).",
        runner: Runner::Both,
        when: |effects| every(effects.clips()),
    },
    Row {
        stage: Stage::AdvectMarkers,
        name: "advect_markers",
        sentence: "Moves the markers by the midpoint rule, near the surface of the spheres with its velocity, in liquid that touches nothing by \
                   g dt^2 / 2 more; spray flies.",
        runner: Runner::Both,
        when: |effects| every(effects.markers),
    },
    Row {
        stage: Stage::Exchange,
        name: "exchange",
        sentence: "Deletes markers in sinks and emits those of sources.",
        runner: Runner::Both,
        when: |effects| every(effects.sources || effects.sinks),
    },
    Row {
        stage: Stage::Band,
        name: "band",
        sentence: "Lists the quads of the narrow band around the liquid.",
        runner: Runner::Gpu,
        when: |effects| every_or_once(effects.markers, effects.liquid),
    },
    Row {
        stage: Stage::AdvectLevel,
        name: "advect_level",
        sentence: "Advects the level set by MacCormack's method (Selle et al. 2008).",
        runner: Runner::Both,
        when: |effects| every(effects.level),
    },
    Row {
        stage: Stage::AdvectVelocity,
        name: "advect_velocity",
        sentence: "Advects the face velocities, semi-Lagrangian with the midpoint rule (Stam 1999), with a level by MacCormack's method.",
        runner: Runner::Both,
        when: |effects| every(effects.liquid),
    },
    Row {
        stage: Stage::Forces,
        name: "forces",
        sentence: "Adds gravity to faces and nodes and sets the velocities of prescribed nodes and source faces.",
        runner: Runner::Both,
        when: |_| When::EverySubStep,
    },
    Row {
        stage: Stage::Occupancy,
        name: "occupancy",
        sentence: "Computes the fraction of each cell's surroundings that markers fill.",
        runner: Runner::Both,
        when: |effects| every(effects.level),
    },
    Row {
        stage: Stage::BoundLevel,
        name: "bound_level",
        sentence: "Bounds the level by the occupancy, thin liquid more tightly.",
        runner: Runner::Both,
        when: |effects| every(effects.level),
    },
    Row {
        stage: Stage::Redistance,
        name: "redistance",
        sentence: "Makes the level a distance again; interface cells stay unless too steep or flat (after Russo and Smereka 2000).",
        runner: Runner::Both,
        when: |effects| every(effects.level),
    },
    Row {
        stage: Stage::FilterLevel,
        name: "filter_level",
        sentence: "Damps ripples of two to four cells along the surface.",
        runner: Runner::Both,
        when: |effects| every(effects.level),
    },
    Row {
        stage: Stage::LiquidDistance,
        name: "liquid_distance",
        sentence: "Computes the liquid distance, the level or a union of spheres around the markers (Zhu and Bridson 2005), extends it \
                   into solids and measures the volume.",
        runner: Runner::Both,
        when: |effects| every_or_once(effects.markers || effects.clips(), effects.liquid),
    },
    Row {
        stage: Stage::LiquidComponents,
        name: "liquid_components",
        sentence: "Labels the connected components of the liquid and shares the target volume among them.",
        runner: Runner::Both,
        when: |effects| every(effects.level),
    },
    Row {
        stage: Stage::VolumeShift,
        name: "volume_shift",
        sentence: "Shifts the level of each component towards its target volume.",
        runner: Runner::Both,
        when: |effects| every(effects.volume_shift),
    },
    Row {
        stage: Stage::Excess,
        name: "excess",
        sentence: "Computes where markers crowd below the surface, a source of volume.",
        runner: Runner::Both,
        when: |effects| every(effects.volume_shift),
    },
    Row {
        stage: Stage::MarkerBand,
        name: "marker_band",
        sentence: "Deletes markers below the band and seeds them where liquid enters it.",
        runner: Runner::Both,
        when: |effects| every(effects.level),
    },
    Row {
        stage: Stage::Landing,
        name: "landing",
        sentence: "Adds the momentum of markers that land to the faces around them.",
        runner: Runner::Both,
        when: |effects| every(effects.level),
    },
    Row {
        stage: Stage::ActiveCells,
        name: "active_cells",
        sentence: "Compacts the unknowns of the pressure and coarsens them for the multigrid hierarchy (thesis 4.38).",
        runner: Runner::Both,
        when: |effects| every(effects.liquid),
    },
    Row {
        stage: Stage::ClosedComponents,
        name: "closed_components",
        sentence: "Labels enclosed liquid components, which have no free surface, and those that touch nothing.",
        runner: Runner::Gpu,
        when: |effects| every(effects.liquid),
    },
    Row {
        stage: Stage::SolidMatrices,
        name: "solid_matrices",
        sentence: "Computes rotations and elastic forces of the elements and assembles the stiffness.",
        runner: Runner::Both,
        when: |effects| every(effects.solids),
    },
    Row {
        stage: Stage::RightHandSide,
        name: "right_hand_side",
        sentence: "Computes the negative divergence with volume control, the momentum of the solids, and their contacts.",
        runner: Runner::Both,
        when: |_| When::EverySubStep,
    },
    Row {
        stage: Stage::Solve,
        name: "solve",
        sentence: "Solves for the pressure and the velocities of the nodes, together where liquid and solids touch (thesis 5.25).",
        runner: Runner::Both,
        when: |_| When::EverySubStep,
    },
    Row {
        stage: Stage::WriteBack,
        name: "write_back",
        sentence: "Subtracts the pressure gradient from the face velocities (thesis 4.36).",
        runner: Runner::Both,
        when: |effects| every(effects.liquid),
    },
    Row {
        stage: Stage::Extrapolate,
        name: "extrapolate",
        sentence: "Extrapolates velocities beyond the liquid, with free slip along obstacles and solids.",
        runner: Runner::Both,
        when: |effects| every(effects.liquid),
    },
    Row {
        stage: Stage::Spray,
        name: "spray",
        sentence: "Turns markers with no liquid around them into free bodies.",
        runner: Runner::Both,
        when: |effects| every(effects.level),
    },
    Row {
        stage: Stage::Diagnose,
        name: "diagnose",
        sentence: "Measures momentum, energies, largest speed, divergence, the worst element and the forces on solids.",
        runner: Runner::Both,
        when: |_| When::EverySubStep,
    },
    Row {
        stage: Stage::Probe,
        name: "probe",
        sentence: "Evaluates the scene's probes.",
        runner: Runner::RunLoop,
        when: |effects| every(effects.probes),
    },
];

impl Stage {
    /// Row of the stage.
    pub const fn row(self) -> &'static Row {
        &SCHEDULE[self as usize]
    }

    /// Its name in labels, tables and messages.
    pub const fn name(self) -> &'static str {
        self.row().name
    }
}

/// Stages of a sub-step of a backend.
pub trait Backend {
    /// Runs a stage.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails; [`Error::Stage`] where the stage fails.
    fn run(&mut self, stage: Stage) -> Result<(), Error>;

    /// Called after every stage.
    fn after(&mut self, stage: Stage) -> Result<(), Error>;
}

/// Runs the stages of the active effects in order. `gpu` includes the stages that only the GPU has. Stops at the
/// first error.
pub fn run(backend: &mut impl Backend, effects: &Effects, gpu: bool) -> Result<(), Error> {
    let within = |row: &&Row| match row.runner {
        Runner::Both => true,
        Runner::Gpu => gpu,
        Runner::RunLoop => false,
    };
    for row in SCHEDULE.iter().filter(within) {
        if (row.when)(effects) == When::EverySubStep {
            backend.run(row.stage)?;
            backend.after(row.stage)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::{SCHEDULE, Stage};

    /// ARCHITECTURE.md lists the schedule.
    #[test]
    fn the_page_lists_the_schedule() {
        let page = include_str!("../ARCHITECTURE.md");
        let lines = SCHEDULE.iter().zip(1..).map(|(row, number)| {
            let super::Row { name, sentence, .. } = row;
            format!("{number}. `{name}`: {sentence}\n")
        });
        let list: String = lines.collect();
        assert!(page.contains(&list), "ARCHITECTURE.md should contain\n{list}");
    }

    #[test]
    fn rows_are_in_the_order_of_the_stages() {
        for (index, row) in SCHEDULE.iter().enumerate() {
            assert_eq!(row.stage as usize, index);
            assert_eq!(row.stage.name(), row.name);
        }
        assert_eq!(SCHEDULE.len(), Stage::Probe as usize + 1);
    }
}
