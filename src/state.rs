//! Host copy of the simulation state, for comparison, output and checkpoints.

use glam::DVec3;

use crate::grid::{Axis, Grid};

/// Input of the next sub-step in f64. A GPU run resumes from it to rounding, and with [`Carried`] bitwise identically.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    /// Simulated time, s.
    pub time: f64,
    /// Sub-steps done.
    pub step: u64,
    /// Frames done.
    pub frame: u64,
    /// Length of the last sub-step, s; 0 before the first.
    pub dt_last: f64,
    /// Longest next sub-step in which no solid passes through another, a wall or an obstacle, s; 0 without a limit.
    pub contact_step: f64,
    /// Face velocities per axis (host face layout), m/s; 0 beyond the extrapolated layers.
    pub velocity: [Vec<f64>; 3],
    /// Marker positions in order, m. Empty with `surface = "fixed"`.
    pub markers: Vec<[f64; 3]>,
    /// Velocities of the markers, m/s; with `surface = "level"` only.
    pub marker_velocity: Vec<[f64; 3]>,
    /// Whether each marker is spray, a free body; with `surface = "level"` only.
    pub spray: Vec<bool>,
    /// Liquid component of each cell, from 1, 0 for none; with `surface = "level"` only.
    pub component: Vec<u32>,
    /// Target volume of each component, m^3.
    pub component_volume: Vec<f64>,
    /// Total number of markers dropped because they could not be moved out of a solid.
    pub markers_dropped: u64,
    /// Total number of markers that left through open sides.
    pub markers_left: u64,
    /// Total number of markers removed by sinks.
    pub markers_sunk: u64,
    /// Total number of markers emitted by sources.
    pub markers_emitted: u64,
    /// Bit set of the sources that ran in the last sub-step.
    pub sources_running: u64,
    /// Pressure of the last projection at cell centres, Pa; 0 in inactive cells.
    pub pressure: Vec<f64>,
    /// Liquid distance at cell centres, m; negative inside.
    pub liquid_distance: Vec<f64>,
    /// Whether each cell was an unknown of the last projection.
    pub active: Vec<bool>,
    /// Whether each cell was in liquid that touched nothing then.
    pub ballistic: Vec<bool>,
    /// Whether each cell separated from the walls and bodies beside it then; empty without separation.
    pub separated: Vec<bool>,
    /// Target liquid volume, m^3, including inflow and outflow. With `surface = "level"` it includes the spray.
    pub volume_0: f64,
    /// Volume of each cavity of a solid when liquid filled it for the first time, m^3; 0 before. Empty before the first sub-step.
    pub cavity_volume: Vec<f64>,
    /// Displacement of the nodes of all solids from rest, m; on the device a sum of two f32.
    pub displacement: Vec<[f64; 3]>,
    /// Velocity of the nodes of all solids, m/s.
    pub node_velocity: Vec<[f64; 3]>,
}

/// State of the GPU backend beyond [`State`] for bitwise identical resuming. All lists are empty on the f64 backend.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Carried {
    /// Largest speeds of the liquid and of the solids, m/s, which limit the next sub-step.
    pub max_speed: [f64; 2],
    /// Potential of the last projection at cell centres, m/s, proportional to the pressure; 0 in inactive cells. Only with
    /// `pressure_on_patches = "gradient"`.
    pub potential: Vec<f64>,
    /// High parts of the displacements of all nodes, m, f32.
    pub displacement_high: Vec<[f64; 3]>,
    /// Low parts. Their sum with the high parts may exceed the precision of f64.
    pub displacement_low: Vec<[f64; 3]>,
    /// Host copy of the displacements of all nodes, m; only with scripts.
    pub scripted_displacement: Vec<[f64; 3]>,
    /// Host copy of the velocities of all nodes, m/s; only with scripts.
    pub scripted_velocity: Vec<[f64; 3]>,
}

impl State {
    /// Which cells held liquid in the last solve: its unknowns, or before the first those with liquid.
    pub fn filled(&self) -> Vec<bool> {
        match self.step {
            0 => self.liquid_distance.iter().map(|&phi| phi < 0.0).collect(),
            _ => self.active.clone(),
        }
    }

    /// Velocity of a marker, m/s: of spray its own, else trilinear from the faces.
    pub fn velocity_of_marker(&self, grid: &Grid, marker: usize) -> DVec3 {
        match self.spray.get(marker) {
            Some(true) => self.marker_velocity[marker].into(),
            _ => grid.velocity_at(&self.velocity, self.markers[marker].into()),
        }
    }

    /// Positions (m) and velocities (m/s) of the markers that fly.
    pub fn flying(&self) -> impl Iterator<Item = ([f64; 3], [f64; 3])> {
        let markers = self.markers.iter().zip(&self.marker_velocity);
        let flying = markers.zip(&self.spray).filter(|(_, spray)| **spray);
        flying.map(|((&x, &v), _)| (x, v))
    }

    /// Whether the state has what a level needs: a velocity for each marker, and the components of the cells.
    pub fn fits_level(&self, grid: &Grid) -> bool {
        let markers = [self.marker_velocity.len(), self.spray.len()];
        let labels = self.component.iter().copied().max().unwrap_or_default() as usize;
        markers == [self.markers.len(); 2]
            && self.component.len() == grid.n_cells()
            && labels <= self.component_volume.len()
    }

    /// A state at rest without liquid.
    pub fn at_rest(grid: &Grid) -> State {
        State {
            time: 0.0,
            step: 0,
            frame: 0,
            dt_last: 0.0,
            contact_step: 0.0,
            velocity: Axis::ALL.map(|axis| vec![0.0; grid.n_faces(axis)]),
            markers: Vec::new(),
            marker_velocity: Vec::new(),
            spray: Vec::new(),
            component: Vec::new(),
            component_volume: Vec::new(),
            markers_dropped: 0,
            markers_left: 0,
            markers_sunk: 0,
            markers_emitted: 0,
            sources_running: 0,
            pressure: vec![0.0; grid.n_cells()],
            liquid_distance: vec![grid.dx; grid.n_cells()],
            active: vec![false; grid.n_cells()],
            ballistic: vec![false; grid.n_cells()],
            separated: Vec::new(),
            volume_0: 0.0,
            cavity_volume: Vec::new(),
            displacement: Vec::new(),
            node_velocity: Vec::new(),
        }
    }

    /// Time to the next frame, s.
    pub fn time_left(&self, frames_per_second: f64) -> f64 {
        (self.frame + 1) as f64 / frames_per_second - self.time
    }

    /// Limits of the next sub-step by the last, s: its length and that of contact; 0 without.
    pub fn last_limits(&self) -> [f64; 2] {
        [self.dt_last, self.contact_step]
    }

    /// Advances the clock by a sub-step of dt (s). A sub-step that ends within a billionth of a frame of the next frame
    /// time ends exactly there, so that times do not drift.
    pub fn advance_clock(&mut self, dt: f64, frames_per_second: f64) {
        self.step += 1;
        self.dt_last = dt;
        if (self.time_left(frames_per_second) - dt).abs() <= 1e-9 / frames_per_second {
            self.frame += 1;
            self.time = self.frame as f64 / frames_per_second;
        } else {
            self.time += dt;
        }
    }
}

/// Status of a solve; with active-set iterations, of the last one. All but [`SolveStatus::Converged`] are reported to the user.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SolveStatus {
    /// The true residual passed: ||r|| <= tolerance ||b||, or below the rounding of the right-hand side. In a coupled solve
    /// b is at least 1 % of the coupling terms of the same rows.
    Converged,
    /// Iteration limit; the iterate with the least true residual is returned.
    IterationLimit,
    /// Further refinement steps no longer reduce the true residual.
    Stagnated,
    /// A search direction without positive energy.
    Breakdown,
    /// A nonfinite right-hand side or iterate.
    NonFinite,
    /// Prescribed motion or a source would change the volume of an enclosed liquid component. The nearest compatible
    /// problem was solved.
    Incompatible,
    /// The set of separated cells still changed after the last round. The pressure solves its last one.
    Unsettled,
}

impl SolveStatus {
    /// Name in tables and messages.
    pub fn name(self) -> &'static str {
        match self {
            SolveStatus::Converged => "converged",
            SolveStatus::IterationLimit => "iteration_limit",
            SolveStatus::Stagnated => "stagnated",
            SolveStatus::Breakdown => "breakdown",
            SolveStatus::NonFinite => "non_finite",
            SolveStatus::Incompatible => "incompatible",
            SolveStatus::Unsettled => "unsettled",
        }
    }

    /// Whether more iterations would not help. The active-set iteration continues after such a solve and ends after any
    /// other.
    pub fn is_best_attainable(self) -> bool {
        matches!(self, SolveStatus::Converged | SolveStatus::Stagnated)
    }
}

/// Result of a solve. A zero right-hand side has solution and residual 0 and converges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolveReport {
    /// Active cells of the pressure solve, or unconstrained velocity components of the solids.
    pub unknowns: usize,
    /// PCG iterations of all refinement steps; 0 for a direct solve.
    pub iterations: u32,
    /// True relative residual in f64: ||b - B p|| / ||b|| or ||b - S v|| / ||b||, with b as in [`SolveStatus::Converged`].
    pub residual: f64,
    /// Status.
    pub status: SolveStatus,
}

/// Diagnostics of the solids at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SolidDiagnosis {
    /// kg m/s
    pub momentum: [f64; 3],
    /// Angular momentum about the origin of the domain, kg m^2/s.
    pub angular_momentum: [f64; 3],
    /// J
    pub kinetic_energy: f64,
    /// J
    pub elastic_energy: f64,
    /// Potential energy relative to g . x = 0, with x from the origin of the domain, J.
    pub potential_energy: f64,
    /// Largest magnitude of a velocity component of a node, m/s.
    pub max_speed: f64,
    /// Least determinant of a deformation gradient; 1 at rest, negative for inverted elements.
    pub min_det: f64,
    /// Elements with det F <= 0.
    pub inverted: usize,
}

/// Diagnostics of one sub-step: a row of steps.csv.
#[derive(Clone, Debug, PartialEq)]
pub struct StepReport {
    /// Length of the sub-step, s.
    pub dt: f64,
    /// Whether the sub-step exceeds the CFL condition, because of the least step length or a fixed step.
    pub dt_floored: bool,
    /// dt sqrt(a / dx), a the largest of gravity and prescribed accelerations.
    pub wave_cfl: f64,
    /// Diagnostics of the liquid.
    pub liquid: Option<LiquidReport>,
    /// Diagnostics of the solids.
    pub solid: Option<SolidReport>,
    /// Diagnostics of the coupling of liquid and solids.
    pub coupling: Option<CouplingReport>,
    /// Seconds of each stage, by its canonical noun, in order: device time with timestamps, or wall-clock time on the f64
    /// backend.
    pub seconds: Vec<(&'static str, f64)>,
    /// Wall-clock seconds of the whole sub-step, including waits.
    pub seconds_total: f64,
}

impl StepReport {
    /// Whether liquid and solids touch.
    pub fn touching(&self) -> bool {
        self.coupling.is_some_and(|both| both.touching)
    }

    /// The pressure solve and the velocity solve of the solids.
    pub fn solves(&self) -> impl Iterator<Item = SolveReport> {
        let liquid = self.liquid.map(|liquid| liquid.solve);
        let solid = self.solid.map(|solid| solid.solve);
        liquid.into_iter().chain(solid)
    }
}

/// Diagnostics of the liquid in one sub-step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LiquidReport {
    /// The pressure solve.
    pub solve: SolveReport,
    /// Liquid components without a free surface.
    pub closed_components: usize,
    /// Volume, momentum and energies after the sub-step.
    pub diagnosis: Diagnosis,
    /// Number of markers.
    pub markers: usize,
    /// Markers dropped in this sub-step because they could not be moved out of a solid.
    pub dropped: u64,
    /// Inflow and outflow, in scenes with open sides, sources or sinks.
    pub exchange: Option<Exchange>,
    /// Liquid that left walls and bodies, in scenes with separation.
    pub separation: Option<SeparationReport>,
}

/// Separation of liquid from walls and bodies in one sub-step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SeparationReport {
    /// Separated cells.
    pub cells: usize,
    /// Cells that were let back, counted in each round.
    pub returned: usize,
    /// Rounds of the active set, of all solves.
    pub rounds: u32,
    /// Least pressure in liquid with a free surface, Pa; 0 in the cells that opened, and without any.
    pub least_pressure: f64,
    /// Volume by which the separated cells opened, m^3.
    pub opened: f64,
}

/// Inflow and outflow of one sub-step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Exchange {
    /// Markers that left through open sides.
    pub left: u64,
    /// Markers that sinks removed.
    pub sunk: u64,
    /// Markers emitted by sources.
    pub emitted: u64,
    /// Volume of markers that left, m^3.
    pub volume_left: f64,
    /// Volume of markers removed by sinks, m^3.
    pub volume_sunk: f64,
    /// Volume emitted by sources, m^3, including their initial filling.
    pub volume_emitted: f64,
}

impl Exchange {
    /// Volume that left, less that which entered, m^3.
    pub fn outflow(self) -> f64 {
        self.volume_left + self.volume_sunk - self.volume_emitted
    }
}

/// Result of the active-set iteration for contacts of solids with walls and obstacles.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactReport {
    /// Active-set iterations.
    pub solves: u32,
    /// Misclassified contacts of the last solve: penetrating or adhering nodes; 0 if the active set is unchanged.
    pub unsettled: u32,
    /// Halvings of the next sub-step, since solids would pass through each other in one of this length; `None` where even a longer one is safe.
    pub next_halvings: Option<u32>,
    /// Inverse of the longest next sub-step that takes no node through a wall or an obstacle, 1/s; 0 without a limit.
    pub closing_rate: f64,
}

impl ContactReport {
    /// Longest next sub-step after one of dt (s) with a limit `before` (s), s; 0 without a limit. After a limit sub-steps at most double, since
    /// contact was checked up to that. The solve keeps nodes in front of walls and obstacles for dt.
    pub fn next_step(&self, dt: f64, before: f64) -> f64 {
        let bodies = match self.next_halvings {
            Some(times) => dt * 0.5_f64.powi(times as i32),
            None if before > 0.0 => 2.0 * dt,
            None => f64::INFINITY,
        };
        let surfaces = match 2.0 * dt * self.closing_rate > 1.0 {
            true => dt.max(1.0 / self.closing_rate),
            false => f64::INFINITY,
        };
        match bodies.min(surfaces) {
            f64::INFINITY => 0.0,
            longest => longest,
        }
    }
}

/// Diagnostics of the solids in one sub-step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolidReport {
    /// The last velocity solve, with the PCG iterations of all active-set iterations.
    pub solve: SolveReport,
    /// Contacts.
    pub contact: ContactReport,
    /// Momentum, energies and the worst element after the sub-step.
    pub diagnosis: SolidDiagnosis,
}

/// Diagnostics of the coupling in one sub-step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CouplingReport {
    /// Whether liquid and solids touch; otherwise their solves are separate.
    pub touching: bool,
    /// Whether the coupled solve used the Schur-complement (pressure-only) form.
    pub condensed: bool,
    /// Total force of the liquid on the solids by cell-centred pressures, J^T p, N.
    pub force: [f64; 3],
    /// Total force of the pressure's variation within cells, N. It acts on the solids alone.
    pub correction: [f64; 3],
    /// Cells with a centre in two solids, or in a solid and an obstacle.
    pub overlap_cells: usize,
    /// Thickness of that overlap, m.
    pub overlap_depth: f64,
}

/// Diagnostics of the liquid at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Diagnosis {
    /// Liquid volume, m^3.
    pub volume: f64,
    /// kg m/s
    pub momentum: [f64; 3],
    /// J
    pub kinetic_energy: f64,
    /// Potential energy relative to g . x = 0, with x from the origin of the domain, J.
    pub potential_energy: f64,
    /// Largest magnitude of a face velocity component, m/s.
    pub max_speed: f64,
    /// Largest divergence of an active cell after the projection, 1/s.
    pub divergence: f64,
}
