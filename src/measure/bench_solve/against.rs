//! What else solves the same system in the same run: on the CPU, in double precision.

use std::time::Instant;

use serde::Serialize;

use crate::Error;
use crate::linalg::SymbolicCholesky;
use crate::scene::Solver;
use crate::state::SolveStatus;

use super::super::statistics::Spread;
use super::Row;
use super::ended::Ended;
use super::rival::{Assembled, Rival};

/// No more runs of a solver are begun once they have taken so long, s,
pub(super) const LONG_ENOUGH: f64 = 20.0;
/// but so many are, or none of them would tell a spread.
pub(super) const FEWEST: usize = 3;

/// Bytes.
pub const GIB: f64 = (1_u64 << 30) as f64;

/// A row of solve_against.csv. The system is that of the row of solve.csv, and judged alike: on its true residuals, with solids those of the
/// indefinite system, thesis (5.17). What was left out for its size is empty.
#[derive(Clone, Debug, Serialize)]
pub struct Against {
    /// As in [`Row`].
    pub scene: &'static str,
    /// As in [`Row`].
    pub grid: usize,
    /// As in [`Row`].
    pub active_cells: u32,
    /// As in [`Row`].
    pub solid_nodes: u32,
    /// As in [`Row`].
    pub bricks: Option<usize>,
    /// As in [`Row`].
    pub formulation: &'static str,
    /// As in [`Row`].
    pub preconditioner: &'static str,
    /// As in [`Row`].
    pub precision: &'static str,
    /// As in [`Row`], on the device.
    pub device_seconds_median: f64,
    /// Least.
    pub device_seconds_min: f64,
    /// Largest.
    pub device_seconds_max: f64,
    /// `ic0_cg`, `cholesky` or `multigrid_cg`.
    pub rival: &'static str,
    /// Threads that it may use.
    pub threads: usize,
    /// What of its work is spread over them; the rest is done by one.
    pub parallel: &'static str,
    /// Unknowns: of its matrix, thesis (5.25) with solids; of multigrid the pressures.
    pub rows: usize,
    /// Of the matrix; empty for multigrid, which assembles none.
    pub entries: Option<usize>,
    /// Of its factor, bytes; empty for multigrid.
    pub factor_bytes: Option<f64>,
    /// As in [`Row`]; empty where it was left out.
    pub status: Option<&'static str>,
    /// Of conjugate gradients, in all rounds; empty for a factor.
    pub iterations: Option<u32>,
    /// How often it was solved, after the device and before it by turns.
    pub turns: usize,
    /// From the assembled B and, with solids, S and J to the verdict: its own matrix, order, factor or hierarchy included.
    pub seconds_median: Option<f64>,
    /// Least.
    pub seconds_min: Option<f64>,
    /// Largest.
    pub seconds_max: Option<f64>,
    /// True relative residual of the pressures' rows, as in [`Row`].
    pub residual_p: Option<f64>,
    /// Of the velocities' rows; 0 without solids.
    pub residual_v: Option<f64>,
    /// Seconds over those on the device in the same turn, median of the turns; empty where one of the two did not converge.
    pub ratio_median: Option<f64>,
    /// Least.
    pub ratio_min: Option<f64>,
    /// Largest.
    pub ratio_max: Option<f64>,
    /// Why there is no ratio; else empty.
    pub note: String,
}

impl Against {
    /// Whether the residuals are within the tolerance. Others are no part of ratios and exponents.
    pub(super) fn converged(&self) -> bool {
        self.status == Some(SolveStatus::Converged.name())
    }
}

/// A rival at work on a system.
pub(super) struct Contest<'a> {
    rival: Rival,
    system: Assembled<'a>,
    settings: Solver,
    rows: usize,
    entries: Option<usize>,
    factor_bytes: Option<f64>,
    /// Why it has no turns.
    left_out: Option<String>,
    /// Seconds of the device and of the rival.
    pub(super) turns: Vec<[f64; 2]>,
    ended: Option<Ended>,
}

impl<'a> Contest<'a> {
    /// To the tolerance of `solver`; `largest`: bytes of a factor.
    pub(super) fn new(
        rival: Rival,
        system: Assembled<'a>,
        solver: &Solver,
        largest: f64,
    ) -> Result<Contest<'a>, Error> {
        let mut contest = Contest {
            rival,
            system,
            settings: *solver,
            rows: system.n_pressures(),
            entries: None,
            factor_bytes: None,
            left_out: None,
            turns: Vec::new(),
            ended: None,
        };
        if rival != Rival::Multigrid {
            let matrix = system.definite().matrix()?;
            let of_factor = match rival {
                Rival::Cholesky => SymbolicCholesky::new(&matrix)?.n_factor_entries(),
                _ => matrix.n_entries(),
            };
            let bytes = 8.0 * of_factor as f64;
            contest.rows = matrix.n_rows();
            contest.entries = Some(matrix.n_entries());
            contest.factor_bytes = Some(bytes);
            contest.left_out =
                (bytes > largest).then(|| format!("factor of {:.1} GiB left out", bytes / GIB));
        }
        // The device's limit is its own.
        contest.settings.max_iterations = (10 * contest.rows) as u32;
        Ok(contest)
    }

    /// Solves once, unless it has taken long enough: seconds.
    pub(super) fn solve(&mut self) -> Result<Option<f64>, Error> {
        let taken: f64 = self.turns.iter().map(|[_, rival]| rival).sum();
        let enough = self.turns.len() >= FEWEST && taken > LONG_ENOUGH;
        if self.left_out.is_some() || enough {
            return Ok(None);
        }
        let clock = Instant::now();
        let Some(reports) = self.system.solve(self.rival, &self.settings)? else {
            self.left_out = Some("no incomplete factor without fill".to_owned());
            return Ok(None);
        };
        self.ended = Some(Ended::of_reports(&reports));
        Ok(Some(clock.elapsed().as_secs_f64()))
    }

    /// Beside the row of the device.
    pub(super) fn row(self, device: &Row) -> Against {
        let seconds = spread(&self.turns, |[_, rival]| rival);
        let mut row = Against {
            scene: device.scene,
            grid: device.grid,
            active_cells: device.active_cells,
            solid_nodes: device.solid_nodes,
            bricks: device.bricks,
            formulation: device.formulation,
            preconditioner: device.preconditioner,
            precision: device.precision,
            device_seconds_median: device.seconds_median,
            device_seconds_min: device.seconds_min,
            device_seconds_max: device.seconds_max,
            rival: self.rival.name(),
            threads: rayon::current_num_threads(),
            parallel: self.rival.parallel(),
            rows: self.rows,
            entries: self.entries,
            factor_bytes: self.factor_bytes,
            status: self.ended.map(|end| end.name(self.settings.tolerance)),
            iterations: self
                .ended
                .filter(|_| self.rival != Rival::Cholesky)
                .map(Ended::iterations),
            turns: self.turns.len(),
            seconds_median: seconds.map(|seconds| seconds.median),
            seconds_min: seconds.map(|seconds| seconds.min),
            seconds_max: seconds.map(|seconds| seconds.max),
            residual_p: self.ended.map(|end| end.residuals()[0]),
            residual_v: self.ended.map(|end| end.residuals()[1]),
            ratio_median: None,
            ratio_min: None,
            ratio_max: None,
            note: String::new(),
        };
        row.note = match (self.left_out, row.status) {
            (Some(note), _) => note,
            (None, Some(status)) if !row.converged() => format!("no ratio: the rival {status}"),
            _ if !device.converged() => format!("no ratio: on the device {}", device.status),
            _ => String::new(),
        };
        if let Some(ratio) = spread(&self.turns, ratio).filter(|_| row.note.is_empty()) {
            row.ratio_median = Some(ratio.median);
            row.ratio_min = Some(ratio.min);
            row.ratio_max = Some(ratio.max);
        }
        row
    }
}

/// Of a value of each turn, seconds of device and rival; none without turns.
fn spread(turns: &[[f64; 2]], value: fn([f64; 2]) -> f64) -> Option<Spread> {
    let values: Vec<f64> = turns.iter().copied().map(value).collect();
    (!values.is_empty()).then(|| Spread::of(values))
}

fn ratio([device, rival]: [f64; 2]) -> f64 {
    rival / device
}

#[cfg(test)]
mod tests {
    use super::super::tests::row;
    use super::{Against, Assembled, Contest, Ended, Rival, Solver, Spread, ratio, spread};
    use crate::reference::base_block::BaseBlock;
    use crate::reference::base_scene::{BaseBeam, BaseScene};
    use crate::state::{SolveReport, SolveStatus};

    #[test]
    fn ratios_are_of_the_same_turn() {
        // The medians are 2 s and 4 s.
        let turns = [[1.0, 4.0], [2.0, 2.0], [4.0, 12.0]];
        let expected = Spread {
            median: 3.0,
            min: 1.0,
            max: 4.0,
        };
        assert_eq!(spread(&turns, ratio), Some(expected));
        let one = spread(&[[4.0, 1.0]], ratio);
        assert_eq!(one, Some(Spread::exact(0.25)));
        assert_eq!(spread(&[], ratio), None);
    }

    #[test]
    fn what_did_not_converge_has_a_note_and_no_ratio() {
        let system = BaseBlock::new(4).pressure_system();
        let against = |device, left_out: Option<String>, status| -> Against {
            let solver = Solver::default();
            let rival = Rival::IncompleteCholesky;
            let mut contest =
                Contest::new(rival, Assembled::Pressure(&system), &solver, 1e9).unwrap();
            if left_out.is_none() {
                contest.turns = vec![[2.0, 1.0]];
                contest.ended = Some(Ended::of_reports(&[SolveReport {
                    unknowns: 1,
                    iterations: 70,
                    residual: 1e-9,
                    status,
                }]));
            }
            contest.left_out = left_out;
            contest.row(&row(20, device))
        };
        let passed = SolveStatus::Converged;
        let fair = against("converged", None, passed);
        assert_eq!((fair.ratio_median, fair.note.as_str()), (Some(0.5), ""));
        for status in ["stagnated", "converged_to_rounding"] {
            let unfair = against(status, None, passed);
            let found = (unfair.seconds_median, unfair.ratio_median);
            assert_eq!(found, (Some(1.0), None));
            assert!(unfair.note.ends_with(status), "{}", unfair.note);
        }
        let limited = against("converged", None, SolveStatus::IterationLimit);
        assert_eq!((limited.ratio_median, limited.converged()), (None, false));
        assert_eq!(limited.note, "no ratio: the rival iteration_limit");
        let left_out = against("converged", Some("too large".to_owned()), passed);
        let found = (left_out.seconds_median, left_out.ratio_median);
        assert_eq!((found, left_out.status), ((None, None), None));
        assert_eq!(left_out.note, "too large");
    }

    /// The systems are as the bench has them, on a small grid.
    #[test]
    fn all_rivals_pass_the_residuals_that_the_device_is_judged_on() {
        let pressure = BaseBlock::new(8).pressure_system();
        let scene = BaseScene::new(8, &BaseBeam::default()).unwrap();
        let both = scene.coupled_system();
        let systems = [
            Assembled::Pressure(&pressure),
            Assembled::Both(&both, &scene.solids),
        ];
        // A loose one, that of the tables, and one that takes rounds of refinement.
        for tolerance in [1e-4, 1e-8, 1e-10] {
            let settings = Solver {
                tolerance,
                max_iterations: 10_000,
                ..Solver::default()
            };
            for (system, parts) in systems.into_iter().zip([1, 2]) {
                for rival in [Rival::IncompleteCholesky, Rival::Cholesky, Rival::Multigrid] {
                    let reports = system.solve(rival, &settings).unwrap().unwrap();
                    assert_eq!(reports.len(), parts);
                    let ended = Ended::of_reports(&reports);
                    let what = format!("{} to {tolerance}: {ended}", rival.name());
                    assert_eq!(ended.name(tolerance), "converged", "{what}");
                    assert_eq!(ended.iterations() == 0, rival == Rival::Cholesky, "{what}");
                }
            }
        }
    }
}
