//! `bench accuracy`: what accuracy costs in time.
//!
//! On chosen states of chosen scenes ([`Row`]): a scene runs to a frame; the sub-step that follows is then done again and again from the same
//! state, in every precision, with every preconditioner, in every form of the corrections and to every tolerance, repeats in a shuffled
//! order. The solve is timed on the host with all that is made for it (`sub_step`). Its errors are those against two
//! truths: the direct solution in f64 of the system that the device stores in that precision, which is what the solver could do better, and the
//! same sub-step on the f64 path, which is what the whole path could do better. Systems with liquid of more than 60,000 unknowns have no
//! direct solution: theirs is by conjugate gradients. All are refined to a residual of 1e-13, or as far as rounding lets them; the bench ends
//! where one that did not converge keeps more than 1e-10.
//!
//! On grids ([`GridRow`]): problems whose pressure is known, from which errors are those of the whole simulation, grid and solve together.

mod exact;
mod grids;
mod picture;
mod states;
mod sub_step;

use std::cmp::Ordering;
use std::path::Path;
use std::time::Instant;

use serde::Serialize;

use crate::Error;
use crate::effects::Effects;
use crate::gpu::{AdapterChoice, Gpu};
use crate::output::FolderLock;
use crate::scene::{CouplingScheme, Formulation, Precision, Preconditioner, Scene};
use crate::sim::{Backend, Simulation};
use crate::state::{SolveReport, SolveStatus};

use super::bench_solve::name;
use super::statistics::Spread;
use super::table::{Machine, remove_earlier, write_csv, write_json, write_svg};

pub use exact::{Exact, dam_release};
pub use grids::{Enough, GridBest, GridRow};
pub use states::{Best, Row};
pub(super) use sub_step::{Done, Mask, reference_step, sub_step};

/// Of the truths.
const EXACT: f64 = 1e-13;
const MOST_ITERATIONS: u32 = 20_000;
/// The residual that a truth may keep which did not converge: forces of stiff solids cancel, and in f64 their rounding can be above [`EXACT`]. The
/// least error that is recommended for.
const ROUNDED: f64 = 1e-10;
/// Of the shuffling: the same order in every run.
const SEED: u64 = 20;
/// What is written only where there are rows of it.
const OPTIONAL: [&str; 7] = [
    "accuracy.csv",
    "accuracy_best.csv",
    "accuracy.svg",
    "accuracy_grids.csv",
    "accuracy_grids_best.csv",
    "accuracy_grids_enough.csv",
    "accuracy_grids.svg",
];

/// What to measure.
#[derive(Clone, Debug)]
pub struct Options {
    /// Scenes, scaled.
    pub scenes: Vec<Scene>,
    /// Frames of each from whose states a sub-step is done, ascending.
    pub frames: Vec<u64>,
    /// Cells along 1 m of the problems that are known exactly, ascending multiples of 10; none leaves them out.
    pub grids: Vec<usize>,
    /// What unknowns and residuals are held in; those that the adapter lacks are left out.
    pub precisions: Vec<Precision>,
    /// Preconditioners.
    pub preconditioners: Vec<Preconditioner>,
    /// Forms of the corrections where liquid and solids touch.
    pub formulations: Vec<Formulation>,
    /// Relative, of the true residuals.
    pub tolerances: Vec<f64>,
    /// Iterations in all rounds, at most.
    pub max_iterations: u32,
    /// Timed runs per row, at most.
    pub repeats: usize,
    /// Of a state or a problem: once so long has passed since the first timed run (s), each row keeps the runs that it has, one at least.
    pub seconds: f64,
    /// Where.
    pub adapter: AdapterChoice,
}

/// The tables and where they were measured.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    /// Where.
    #[serde(flatten)]
    pub machine: Machine,
    /// A row per state, way to solve and tolerance.
    pub rows: Vec<Row>,
    /// A row per state and target that any row meets.
    pub best: Vec<Best>,
    /// A row per problem, grid, precision and tolerance.
    pub grids: Vec<GridRow>,
    /// A row per problem and target that any row meets.
    pub grids_best: Vec<GridBest>,
    /// A row per problem, grid and precision.
    pub grids_enough: Vec<Enough>,
}

/// Work on a state or a problem, and how much of it is done.
#[derive(Clone, Debug)]
pub struct Progress {
    /// The scene with its frame, or the problem with its grid.
    pub on: String,
    /// What is done, in the plural.
    pub work: &'static str,
    /// How much of it.
    pub done: usize,
    /// Of how much.
    pub of: usize,
    /// Seconds that it took.
    pub seconds: f64,
}

impl Progress {
    /// Seconds that the rest of it takes at the same pace.
    pub fn seconds_left(&self) -> f64 {
        self.seconds * (self.of - self.done) as f64 / self.done.max(1) as f64
    }
}

/// Counts work and tells of it.
struct Counter<'a> {
    clock: Instant,
    progress: Progress,
    tell: &'a mut dyn FnMut(Heard),
}

impl<'a> Counter<'a> {
    fn new(
        on: String,
        work: &'static str,
        of: usize,
        tell: &'a mut dyn FnMut(Heard),
    ) -> Counter<'a> {
        let progress = Progress {
            on,
            work,
            done: 0,
            of,
            seconds: 0.0,
        };
        Counter {
            clock: Instant::now(),
            progress,
            tell,
        }
    }

    /// One more.
    fn count(&mut self) {
        self.progress.done += 1;
        self.progress.seconds = self.clock.elapsed().as_secs_f64();
        (self.tell)(Heard::Progress(self.progress.clone()));
    }
}

/// Hears of each row when it is there.
pub enum Heard<'a> {
    /// Of work that goes on.
    Progress(Progress),
    /// Of the first solve of a state, by itself: one repeat to the first tolerance, not among the rows.
    First(&'a Row),
    /// Of a state.
    State(&'a Row),
    /// Of a problem on a grid.
    Grid(&'a GridRow),
}

/// Measures all rows and writes their tables and pictures into `out`, anew after each state and each problem on a grid; those of an earlier run are
/// removed first. `tell` hears of each row.
///
/// # Errors
/// [`Error::Input`] for scenes of weak or damping-only coupling and grids that the problems do not fit, [`Error::Output`], [`Error::Stage`] where
/// a truth is not solved for, and what the simulations say.
pub fn bench_accuracy(
    options: &Options,
    out: &Path,
    tell: &mut dyn FnMut(Heard),
) -> Result<Table, Error> {
    for scene in &options.scenes {
        if Effects::of(scene).coupling && scene.solver.coupling != CouplingScheme::Strong {
            return Err(Error::input(
                scene.file.display().to_string(),
                "the errors are those of strong coupling",
                "add --set solver.coupling=strong",
            ));
        }
    }
    for &grid in &options.grids {
        if !(10..=320).contains(&grid) || !grid.is_multiple_of(10) {
            return Err(Error::input(
                format!("--grids {grid}"),
                "walls and surfaces of the problems do not lie on faces of such cells",
                "give multiples of 10 up to 320",
            ));
        }
    }
    if options.scenes.is_empty() && options.grids.is_empty() {
        return Err(Error::input(
            "bench accuracy",
            "nothing to measure",
            "give a scene file or more, or grids: --grids 10,20,40",
        ));
    }
    let _held = FolderLock::take(out)?;
    let mut table = Table {
        machine: Machine::new(&Gpu::new(&options.adapter)?, options.repeats)?,
        rows: Vec::new(),
        best: Vec::new(),
        grids: Vec::new(),
        grids_best: Vec::new(),
        grids_enough: Vec::new(),
    };
    // Shows before any work that the folder can be written.
    table.write(out)?;
    remove_earlier(out, &OPTIONAL)?;
    for scene in &options.scenes {
        let mut simulation = Simulation::new(scene, &Backend::Gpu(options.adapter.clone()))?;
        for &frame in &options.frames {
            let on = format!("{}, frame {frame}", scene.name);
            let before = simulation.clock().frame;
            let frames = frame.saturating_sub(before) as usize;
            let mut counter = Counter::new(on, "frames simulated", frames, tell);
            for next in before + 1..=frame {
                while simulation.clock().frame < next {
                    simulation.step()?;
                }
                counter.count();
            }
            let state = simulation.state()?;
            let rows = states::measure(scene, &state, options, tell)?;
            rows.iter().for_each(|row| tell(Heard::State(row)));
            table.rows.extend(rows);
            table.write(out)?;
        }
    }
    for problem in Exact::ALL {
        for &grid in &options.grids {
            let rows = grids::measure(problem, grid, options, tell)?;
            rows.iter().for_each(|row| tell(Heard::Grid(row)));
            table.grids.extend(rows);
            table.write(out)?;
        }
    }
    Ok(table)
}

impl Table {
    /// Makes again what follows from the rows, and writes what there is.
    fn write(&mut self, out: &Path) -> Result<(), Error> {
        self.best = states::recommend(&self.rows);
        self.grids_best = grids::recommend(&self.grids);
        self.grids_enough = grids::enough(&self.grids);
        write_json(self, &out.join("accuracy.json"))?;
        if !self.rows.is_empty() {
            write_csv(&self.rows, &out.join("accuracy.csv"))?;
            write_csv(&self.best, &out.join("accuracy_best.csv"))?;
            let size = picture::size_of_states(&self.rows);
            write_svg(&out.join("accuracy.svg"), size, |page| {
                picture::draw_states(&self.rows, page)
            })?;
        }
        if !self.grids.is_empty() {
            write_csv(&self.grids, &out.join("accuracy_grids.csv"))?;
            write_csv(&self.grids_best, &out.join("accuracy_grids_best.csv"))?;
            write_csv(&self.grids_enough, &out.join("accuracy_grids_enough.csv"))?;
            let lines = grids::problems(&self.grids).len() as u32;
            let file = out.join("accuracy_grids.svg");
            write_svg(&file, (1200, 480 * lines), |page| {
                picture::draw_grids(&self.grids, page)
            })?;
        }
        Ok(())
    }
}

/// Refuses as a truth what was not solved for. `step`: sub-steps before it.
fn ensure_truth(
    what: &str,
    step: u64,
    solves: impl IntoIterator<Item = SolveReport>,
) -> Result<(), Error> {
    for SolveReport {
        residual, status, ..
    } in solves
    {
        let passed = matches!(status, SolveStatus::Converged | SolveStatus::Incompatible);
        // Not where the residual is no number.
        if passed || residual <= ROUNDED {
            continue;
        }
        let status = status.name();
        return Err(Error::Stage {
            stage: "solve",
            step,
            problem: format!(
                "{what}: the solution in f64 that errors are to be measured against ended with {status} at a relative residual of {residual:.1e}, above {ROUNDED:e}\n  cure: shorter sub-steps (time.fixed_step), or loads and stiffnesses nearer to each other"
            ),
        });
    }
    Ok(())
}

/// What a recommendation weighs of a row.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Choice {
    /// Of the solve.
    seconds: Spread,
    /// Of the domain, or along 1 m of it.
    cells: usize,
    /// `f32`, `mixed` or `f64`.
    precision: &'static str,
    tolerance: f64,
    iterations: u32,
}

impl Choice {
    /// The better first: fewer cells, since all stages and the memory go with them; then the precision of fewer bytes, which more adapters
    /// have; the looser tolerance; fewer iterations; and only then the time.
    fn compare(&self, other: &Choice) -> Ordering {
        self.cells
            .cmp(&other.cells)
            .then(self.width().cmp(&other.width()))
            .then(other.tolerance.total_cmp(&self.tolerance))
            .then(self.iterations.cmp(&other.iterations))
            .then(self.seconds.median.total_cmp(&other.seconds.median))
    }

    /// Where its precision stands among the ascending ones.
    fn width(&self) -> Option<usize> {
        let ascending = [Precision::F32, Precision::Mixed, Precision::F64].map(name);
        ascending.iter().position(|name| *name == self.precision)
    }

    /// Whether it takes no more time, cells and bytes a number.
    fn asks_no_more(&self, other: &Choice) -> bool {
        self.seconds.median <= other.seconds.median
            && self.cells <= other.cells
            && self.width() <= other.width()
    }
}

/// What else the machine did in one repeat of the fastest row should not make all others as fast.
const AS_FAST: f64 = 1.25;

/// Of rows that are accurate enough, the best ([`Choice::compare`]) of those that time does not tell from the fastest: whose least is not
/// above the largest of the row with the least median, nor above a quarter more than that.
fn cheapest<'a, T>(
    rows: impl Iterator<Item = &'a T> + Clone,
    choice: impl Fn(&T) -> Choice,
) -> Option<&'a T> {
    let seconds = rows.clone().map(|row| choice(row).seconds);
    let fastest = seconds.min_by(|a, b| a.median.total_cmp(&b.median))?;
    let most = fastest.max.min(AS_FAST * fastest.median);
    let equal = rows.filter(|row| choice(row).seconds.min <= most);
    equal.min_by(|a, b| choice(a).compare(&choice(b)))
}

/// For each of the descending targets that any row meets, the cheapest row whose error is not above it, or that of the next lower target where that
/// one asks no more: to be less accurate should never take longer.
fn recommended<'a, T>(
    rows: impl Iterator<Item = &'a T> + Clone,
    targets: &[f64],
    error: impl Fn(&T) -> f64,
    choice: impl Fn(&T) -> Choice,
) -> Vec<(f64, &'a T)> {
    let mut found: Vec<(f64, &T)> = Vec::new();
    for &target in targets.iter().rev() {
        let meeting = rows.clone().filter(|row| error(row) <= target);
        let Some(mut best) = cheapest(meeting, &choice) else {
            continue;
        };
        if let Some((_, lower)) = found.last()
            && choice(lower).asks_no_more(&choice(best))
        {
            best = lower;
        }
        found.push((target, best));
    }
    found.reverse();
    found
}

#[cfg(test)]
mod tests {
    use super::super::statistics::Spread;
    use super::{Choice, cheapest, ensure_truth, recommended};
    use crate::state::{SolveReport, SolveStatus};

    fn way(cells: usize, precision: &'static str, tolerance: f64, iterations: u32) -> Choice {
        Choice {
            seconds: Spread::of(vec![12.0, 13.0, 14.0]),
            cells,
            precision,
            tolerance,
            iterations,
        }
    }

    fn taking(seconds: [f64; 3], way: Choice) -> Choice {
        Choice {
            seconds: Spread::of(seconds.to_vec()),
            ..way
        }
    }

    /// Of the rows, in this order and the other.
    fn chosen(rows: &[Choice]) -> Choice {
        let first = *cheapest(rows.iter(), |row| *row).unwrap();
        let second = *cheapest(rows.iter().rev(), |row| *row).unwrap();
        assert_eq!(first, second, "the order of rows counts");
        first
    }

    #[test]
    fn what_time_does_not_tell_apart_is_chosen_by_what_it_takes() {
        let fastest = taking([9.0, 10.0, 12.0], way(20, "f64", 1e-6, 9));
        // Each is better than those before it in one thing that counts for more, and worse in what counts for less.
        let mut rows = vec![fastest];
        for better in [
            way(20, "f64", 1e-6, 8),
            way(20, "f64", 1e-4, 30),
            way(20, "mixed", 1e-8, 40),
            way(20, "f32", 1e-10, 50),
            way(10, "f64", 1e-12, 60),
        ] {
            rows.push(better);
            assert_eq!(chosen(&rows), better);
        }
    }

    #[test]
    fn what_is_slower_in_every_repeat_is_not_chosen() {
        let fastest = taking([9.0, 10.0, 11.9], way(20, "f64", 1e-6, 9));
        assert_eq!(chosen(&[fastest, way(10, "f32", 1e-2, 1)]), fastest);
        let disturbed = taking([9.0, 10.0, 90.0], way(20, "f64", 1e-6, 9));
        let slower = taking([12.6, 13.0, 14.0], way(10, "f32", 1e-2, 1));
        assert_eq!(chosen(&[disturbed, slower]), disturbed);
        assert!(cheapest([].iter(), |row: &Choice| *row).is_none());
    }

    #[test]
    fn what_was_not_solved_for_is_no_truth() {
        let ensure = |status: SolveStatus, residual: f64| {
            let solved = SolveReport {
                unknowns: 1,
                iterations: 0,
                residual: 0.0,
                status: SolveStatus::Converged,
            };
            let last = SolveReport {
                residual,
                status,
                ..solved
            };
            ensure_truth("dam_break, frame 10, stored in mixed", 87, [solved, last])
        };
        for (status, residual) in [
            // Below the rounding of a right-hand side that is nearly nothing.
            (SolveStatus::Converged, 1e-3),
            (SolveStatus::Incompatible, 1e-14),
            (SolveStatus::Stagnated, 4e-12),
        ] {
            assert!(ensure(status, residual).is_ok(), "{status:?}");
        }
        for (status, residual, shown) in [
            (SolveStatus::Stagnated, 3e-7, "3.0e-7"),
            (SolveStatus::IterationLimit, 2e-10, "2.0e-10"),
            (SolveStatus::Breakdown, 1.0, "1.0e0"),
            (SolveStatus::NonFinite, f64::NAN, "NaN"),
        ] {
            let error = ensure(status, residual).unwrap_err();
            assert_eq!(error.exit_code(), 4, "{status:?}");
            let text = error.to_string();
            for part in ["dam_break, frame 10", "step 87", status.name(), shown] {
                assert!(text.contains(part), "{part}: {text}");
            }
        }
    }

    #[test]
    fn to_be_less_accurate_takes_no_longer() {
        // Rows of descending errors, the tolerances; as fast as the spreads tell, but for the last.
        let loose = taking([10.0, 14.0, 16.0], way(20, "mixed", 1e-2, 5));
        let tight = taking([9.0, 12.0, 15.0], way(20, "mixed", 1e-4, 9));
        let wide = taking([9.0, 11.0, 15.0], way(20, "f64", 1e-6, 9));
        let slow = taking([90.0, 91.0, 92.0], way(20, "f64", 1e-8, 9));
        let rows = [loose, tight, wide, slow];
        let of = |rows: &[Choice], targets: &[f64]| -> Vec<(f64, f64)> {
            let found = recommended(rows.iter(), targets, |row| row.tolerance, |row| *row);
            found
                .iter()
                .map(|(target, row)| (*target, row.tolerance))
                .collect()
        };
        let targets = [1e-2, 1e-4, 1e-6, 1e-8, 1e-10];
        assert_eq!(
            of(&rows, &targets),
            [(1e-2, 1e-4), (1e-4, 1e-4), (1e-6, 1e-6), (1e-8, 1e-8)],
            "what asks for more bytes stands for no other, and what no row meets has none"
        );
        assert_eq!(of(&[loose], &targets), [(1e-2, 1e-2)]);
        assert_eq!(of(&[], &targets), []);
    }

    #[test]
    fn noise_does_not_change_the_choice() {
        let (mixed, double) = (way(20, "mixed", 1e-6, 9), way(20, "f64", 1e-4, 7));
        for [a, b] in [[0, 1], [1, 0]] {
            let seconds = [[9.0, 10.0, 12.0], [9.5, 11.0, 13.0]];
            let rows = [taking(seconds[a], mixed), taking(seconds[b], double)];
            assert_eq!(chosen(&rows).precision, "mixed");
        }
    }
}
