//! Host copy of one moment of a simulation: what the two paths exchange, what is written, and what a run resumes from.

use crate::grid::{Axis, Grid};

/// Everything the next step reads, in f64 on the host; of the GPU path to rounding, and with [`Carried`] to the bit.
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
    /// Face velocities per axis, host layout of the faces, m/s; 0 beyond the extrapolated layers.
    pub velocity: [Vec<f64>; 3],
    /// Marker positions in order, m. Empty with `surface = "fixed"`.
    pub markers: Vec<[f64; 3]>,
    /// Markers dropped so far because they could not be moved out of a solid.
    pub markers_dropped: u64,
    /// Markers that have left so far through open sides of the domain.
    pub markers_left: u64,
    /// Markers that sinks have removed so far.
    pub markers_sunk: u64,
    /// Markers that sources have made so far.
    pub markers_emitted: u64,
    /// The set of sources that ran in the last sub-step, a bit for each.
    pub sources_running: u64,
    /// Pressure of the last projection at cell centres, Pa; 0 in inactive cells.
    pub pressure: Vec<f64>,
    /// Liquid distance at cell centres, m; negative inside.
    pub liquid_distance: Vec<f64>,
    /// Whether each cell was an unknown of the last projection.
    pub active: Vec<bool>,
    /// Liquid volume to hold, m^3: with what came in and without what went out.
    pub volume_0: f64,
    /// Displacement of the nodes of all solids from rest, m; held on the device as the sum of two f32.
    pub displacement: Vec<[f64; 3]>,
    /// Velocity of the nodes of all solids, m/s.
    pub node_velocity: Vec<[f64; 3]>,
}

/// What the GPU path has beyond a [`State`] from one sub-step to the next: with both it goes on to the bit. A state alone goes on to
/// rounding. The f64 path has nothing beyond: there all lists are empty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Carried {
    /// Largest speeds of the liquid and of the solids, m/s, from which the length of the next sub-step follows.
    pub max_speed: [f64; 2],
    /// The potential of the last projection at cell centres, m/s, of which the pressure of the state is a multiple; 0 in inactive
    /// cells. Only where patches ask for its gradient.
    pub potential: Vec<f64>,
    /// The larger parts of the displacements of all nodes, m, f32.
    pub displacement_high: Vec<[f64; 3]>,
    /// The smaller parts. Their sum with the larger may have more digits than an f64.
    pub displacement_low: Vec<[f64; 3]>,
    /// Displacements of all nodes, m, as the host follows those of scripted ones; only with scripts.
    pub scripted_displacement: Vec<[f64; 3]>,
    /// And their velocities, m/s.
    pub scripted_velocity: Vec<[f64; 3]>,
}

impl State {
    /// An empty state at rest.
    pub fn at_rest(grid: &Grid) -> State {
        State {
            time: 0.0,
            step: 0,
            frame: 0,
            dt_last: 0.0,
            velocity: Axis::ALL.map(|axis| vec![0.0; grid.n_faces(axis)]),
            markers: Vec::new(),
            markers_dropped: 0,
            markers_left: 0,
            markers_sunk: 0,
            markers_emitted: 0,
            sources_running: 0,
            pressure: vec![0.0; grid.n_cells()],
            liquid_distance: vec![grid.dx; grid.n_cells()],
            active: vec![false; grid.n_cells()],
            volume_0: 0.0,
            displacement: Vec::new(),
            node_velocity: Vec::new(),
        }
    }

    /// Time left to the next frame, s.
    pub fn time_left(&self, frames_per_second: f64) -> f64 {
        (self.frame + 1) as f64 / frames_per_second - self.time
    }

    /// Moves the clock on by a sub-step of dt (s). One that ends within a billionth of a frame of the next frame's time ends
    /// on it, so that times do not drift.
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

/// How a solve ended, of several in search of contacts the last. Anything but [`SolveStatus::Converged`] is told to the user.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SolveStatus {
    /// The true residual passed: ||r|| <= tolerance ||b||, or below what rounding of the right-hand side leaves. Of liquid and solids together a
    /// hundredth of what the other part puts on the rows stands for b where that is more.
    Converged,
    /// All iterations were used; the iterate with the least true residual was kept.
    IterationLimit,
    /// Further rounds no longer reduce the true residual.
    Stagnated,
    /// A direction without positive energy appeared.
    Breakdown,
    /// The right-hand side or the iterate is not finite.
    NonFinite,
    /// Prescribed motion or a source asks a liquid without a free surface to change its volume: the nearest that keeps it was solved for.
    Incompatible,
}

impl SolveStatus {
    /// Word for tables and messages.
    pub fn name(self) -> &'static str {
        match self {
            SolveStatus::Converged => "converged",
            SolveStatus::IterationLimit => "iteration_limit",
            SolveStatus::Stagnated => "stagnated",
            SolveStatus::Breakdown => "breakdown",
            SolveStatus::NonFinite => "non_finite",
            SolveStatus::Incompatible => "incompatible",
        }
    }

    /// Whether more iterations would not have helped: a search for contacts goes on from such a solve, and ends with any other.
    pub fn found_all_it_can(self) -> bool {
        matches!(self, SolveStatus::Converged | SolveStatus::Stagnated)
    }
}

/// What a solve did. A zero right-hand side gives a zero answer, residual 0, status converged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolveReport {
    /// Active cells of the pressure solve, free components of node velocities of the solids'.
    pub unknowns: usize,
    /// PCG iterations, summed over all rounds; 0 for a direct solve.
    pub iterations: u32,
    /// True residual over the right-hand side, evaluated in f64: ||b - B p|| / ||b||, or ||b - S v|| / ||b||, with b as in
    /// [`SolveStatus::Converged`].
    pub residual: f64,
    /// How it ended.
    pub status: SolveStatus,
}

/// What the solids amount to at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolidDiagnosis {
    /// kg m/s
    pub momentum: [f64; 3],
    /// About the origin of the domain, kg m^2/s.
    pub angular_momentum: [f64; 3],
    /// J
    pub kinetic_energy: f64,
    /// J
    pub elastic_energy: f64,
    /// J, from the origin of the domain: zero where g . x is.
    pub potential_energy: f64,
    /// Largest magnitude of a component of a node's velocity, m/s.
    pub max_speed: f64,
    /// Least determinant of an element's deformation gradient; 1 at rest, negative where inverted.
    pub min_det: f64,
    /// Elements with a determinant of 0 or less.
    pub inverted: usize,
}

/// What one sub-step did: a row of steps.csv.
#[derive(Clone, Debug, PartialEq)]
pub struct StepReport {
    /// Length of the sub-step, s.
    pub dt: f64,
    /// Whether it was longer than the CFL condition allows: held at the floor of the step length, or fixed.
    pub dt_floored: bool,
    /// The liquid's part, where the scene has liquid.
    pub liquid: Option<LiquidReport>,
    /// The solids' part, where the scene has solids.
    pub solid: Option<SolidReport>,
    /// What they do to each other, where the scene has both.
    pub coupling: Option<CouplingReport>,
    /// Seconds of each stage, by its canonical noun, in order: on the device, where it can tell them, or of wall clock on the f64
    /// path.
    pub seconds: Vec<(&'static str, f64)>,
    /// Wall-clock seconds of the whole sub-step, waits included.
    pub seconds_total: f64,
}

impl StepReport {
    /// The solves of the sub-step: the pressure's, then the solids'.
    pub fn solves(&self) -> impl Iterator<Item = SolveReport> {
        let liquid = self.liquid.map(|liquid| liquid.solve);
        let solid = self.solid.map(|solid| solid.solve);
        liquid.into_iter().chain(solid)
    }
}

/// What one sub-step did to the liquid.
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
    /// What came in and what went out, where the scene has ways in or out.
    pub exchange: Option<Exchange>,
}

/// What came into the domain and what went out in one sub-step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Exchange {
    /// Markers that left through open sides.
    pub left: u64,
    /// Markers that sinks removed.
    pub sunk: u64,
    /// Markers that sources made.
    pub emitted: u64,
    /// The volume of those that left, m^3.
    pub volume_left: f64,
    /// Of those that sank.
    pub volume_sunk: f64,
    /// What sources emitted, with what they filled themselves with at their start, m^3.
    pub volume_emitted: f64,
}

/// How the search for what walls and obstacles hold of the solids ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ContactReport {
    /// Solves that it took.
    pub solves: u32,
    /// Contacts that the last of them had wrong: nodes that are beyond a surface or pulled to it; 0 where the search came to its end.
    pub unsettled: u32,
}

/// What one sub-step did to the solids.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolidReport {
    /// The solve for the velocities of the nodes; the last one, with the iterations of all.
    pub solve: SolveReport,
    /// What became of contact.
    pub contact: ContactReport,
    /// Momentum, energies and the worst element after the sub-step.
    pub diagnosis: SolidDiagnosis,
}

/// What liquid and solids did to each other in one sub-step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CouplingReport {
    /// Whether they touch: otherwise each was solved for itself.
    pub touching: bool,
    /// Whether they were solved for in the condensed form, pressures alone.
    pub condensed: bool,
    /// Sum of the liquid's forces on the solids by the pressure at the centres of cells, J^T p, N.
    pub force: [f64; 3],
    /// Sum of what pressure adds that varies within cells, N. It acts on the solids alone.
    pub correction: [f64; 3],
    /// Cells whose centre lies in two solids, or in a solid and an obstacle.
    pub overlap_cells: usize,
    /// Thickness of that overlap, m.
    pub overlap_depth: f64,
}

/// What the liquid amounts to at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Diagnosis {
    /// Liquid volume, m^3.
    pub volume: f64,
    /// kg m/s
    pub momentum: [f64; 3],
    /// J
    pub kinetic_energy: f64,
    /// J, from the origin of the domain: zero where g . x is.
    pub potential_energy: f64,
    /// Largest magnitude of a face velocity component, m/s.
    pub max_speed: f64,
    /// Largest divergence of an active cell after the projection, 1/s.
    pub divergence: f64,
}
