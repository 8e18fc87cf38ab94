//! The skeleton of the benches: values and tables, statistics, recommendations, verdicts, room for grids.

use std::fs;
use std::path::{Path, PathBuf};

use cutwater::Error;
use cutwater::gpu::AdapterReport;
use cutwater::measure::bench::accuracy::{cheapest, ensure_truth, recommended};
use cutwater::measure::bench::effects::pairs::{self, Cost};
use cutwater::measure::bench::effects::{bytes_in_use, costs};
use cutwater::measure::bench::ended::{Ended, is_solved};
use cutwater::measure::bench::solve::{Capacity, PER_CELL};
use cutwater::measure::bench::statistics::{Spread, exponent, exponents};
use cutwater::measure::bench::step::{largest, units};
use cutwater::measure::bench::table::Row;
use cutwater::measure::bench::{Event, Listener, Results, Settings};
use cutwater::scene::{Precision, Solver};
use cutwater::state::{SolveReport, SolveStatus};
use tempfile::TempDir;

/// Settings of a bench in a test.
pub(crate) fn settings(out: &Path, repeats: usize) -> Settings {
    Settings { out: out.to_owned(), repeats, seconds: f64::INFINITY, resume: false }
}

/// Counts the rows that a bench tells.
pub(crate) fn counted(told: &mut usize) -> impl FnMut(Event) {
    |event| *told += usize::from(matches!(event, Event::Row(..)))
}

/// A bench in a folder of its own.
pub(crate) struct Measured {
    folder: TempDir,
    pub(crate) results: Results,
    /// Rows that the bench told.
    pub(crate) told: usize,
}

/// Runs a bench.
pub(crate) fn measured(repeats: usize, bench: impl FnOnce(&Settings, Listener) -> Result<Results, Error>) -> Measured {
    let (folder, mut told) = (tempfile::tempdir().unwrap(), 0);
    let settings = settings(folder.path(), repeats);
    let results = bench(&settings, &mut counted(&mut told)).unwrap();
    Measured { folder, results, told }
}

impl Measured {
    pub(crate) fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(crate) fn text(&self, name: &str) -> String {
        fs::read_to_string(self.file(name)).unwrap()
    }

    pub(crate) fn rows(&self, table: &str) -> &[Row] {
        self.results.rows(table)
    }

    /// Every file has something in it, and no number that is none; JSON has no key twice.
    pub(crate) fn assert_written(&self, files: &[&str]) {
        for file in files {
            let text = self.text(file);
            assert!(!text.is_empty() && !text.contains("NaN"), "{file}");
            if file.ends_with(".json") {
                crate::common::json(text);
            }
        }
    }
}

/// Numbers of a row.
pub(crate) fn numbers<const N: usize>(row: &Row, names: [&str; N]) -> [f64; N] {
    names.map(|name| row.number(name))
}

/// Least, median and largest value of a column are above 0 and in order.
pub(crate) fn assert_spread(row: &Row, name: &str) {
    let [least, median, most] = ["min", "median", "max"].map(|end| format!("{name}_{end}"));
    let ends = numbers(row, [&least, &median, &most]);
    assert!(ends[0] > 0.0 && ends.is_sorted(), "{row:?}");
}

/// A row of numbers and names.
macro_rules! row {
    ($($name:ident: $value:expr),* $(,)?) => { cutwater::measure::bench::table::Row::new([$((stringify!($name), cutwater::measure::bench::table::Value::from($value))),*]) };
}
pub(crate) use row;

#[test]
fn values_are_found_by_column() {
    let spread = Spread::of(vec![3.0, 1.0, 2.0]);
    let row = row! { grid: 20_usize, seconds: spread, name: "a", passed: true, nothing: None::<f64> };
    assert_eq!([row.count("grid"), row.count("other")], [20, 0]);
    let ends = ["seconds_median", "seconds_min", "seconds_max"].map(|name| row.number(name));
    assert_eq!(ends, [2.0, 1.0, 3.0]);
    assert_eq!((row.text("name"), row.flag("passed")), ("a", true));
    assert!(row.has("name") && !row.has("nothing") && row.number("nothing").is_nan());
}

#[test]
fn median_quartiles_and_exponents() {
    assert_eq!(Spread::of(vec![4.0, 1.0, 2.0, 3.0]).median, 2.5);
    assert_eq!(Spread::quartiles(vec![4.0, 1.0, 2.0, 3.0]), [1.75, 2.5, 3.25]);
    assert_eq!(Spread::quartiles(vec![2.0]), [2.0; 3]);
    // A launch of 1 s beside a second per unit.
    let point = |x: f64| {
        let y = 1.0 + x;
        (x, Spread { median: y, min: 0.9 * y, max: 1.2 * y })
    };
    let found = exponents(&[10.0, 1.0, 100.0].map(point)).unwrap();
    let [fit, last, low, high] = found;
    assert!((last - (101.0_f64 / 11.0).log10()).abs() < 1e-12);
    assert!(low < fit && fit < high && fit < last);
    // Of three points a decade apart the slope is half that between the ends; the middle one has no weight.
    let ends = |low: f64, high: f64| 0.5 * (high * 101.0 / (low * 2.0)).log10();
    assert!((low - ends(1.2, 0.9)).abs() < 1e-12, "{found:?}");
    assert!((high - ends(0.9, 1.2)).abs() < 1e-12, "{found:?}");
    assert_eq!(exponents(&[point(2.0), point(2.0)]), None);
    assert_eq!(exponents(&[]), None);
    let points = [1.0_f64, 3.0, 10.0].map(|x| (x, 5.0 * x.powf(1.5)));
    assert!((exponent(points).unwrap() - 1.5).abs() < 1e-12);
    for x in [0.1, 3.0, 7.0, 4401.0, 281_721.0] {
        for n in 0..8_u32 {
            let points = (0..n).map(|k| (x, 1.0 + f64::from(k)));
            assert_eq!(exponent(points), None, "{n} times {x}");
        }
    }
    for none in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert_eq!(exponent([(1.0, none), (2.0, 4.0)]), None, "{none}");
        assert_eq!(exponent([(none, 1.0), (2.0, 4.0)]), None, "{none}");
    }
}

const CONVERGED: Ended = Ended { status: SolveStatus::Converged, iterations: 12, residuals: [1e-9, 2e-9] };

#[test]
fn repeats_that_end_otherwise_are_refused() {
    let broken = Ended { status: SolveStatus::NonFinite, residuals: [f64::NAN; 2], ..CONVERGED };
    for ended in [CONVERGED, broken] {
        ended.ensure_repeated(ended, "a solve").unwrap();
    }
    let stagnated = Ended { status: SolveStatus::Stagnated, ..CONVERGED };
    let longer = Ended { iterations: 13, ..CONVERGED };
    let off = Ended { residuals: [1e-9, 2e-9_f64.next_up()], ..CONVERGED };
    for other in [broken, stagnated, longer, off] {
        let refused = CONVERGED.ensure_repeated(other, "a solve").unwrap_err();
        let told = refused.to_string();
        assert!(refused.exit_code() == 1 && told.contains("a solve: "), "{told}");
        assert!(told.contains(&other.to_string()), "{told}");
    }
    assert_eq!(CONVERGED.name(2e-9), "converged");
    assert_eq!(CONVERGED.name(1.5e-9), "converged_to_rounding");
    assert_eq!(stagnated.name(1.5e-9), "stagnated");
}

fn solve(residual: f64, status: SolveStatus) -> SolveReport {
    SolveReport { unknowns: 10, iterations: 7, residual, status }
}

#[test]
fn reports_of_both_parts_are_one_end() {
    let passed = |residual| solve(residual, SolveStatus::Converged);
    let both = Ended::new(&[passed(1e-9), passed(3e-8)]);
    assert_eq!((both.iterations, both.residuals), (7, [1e-9, 3e-8]));
    // Whichever part is above the tolerance.
    assert_eq!([1e-7, 1e-8].map(|t| both.name(t)), ["converged", "converged_to_rounding"]);
    let other = Ended::new(&[passed(3e-8), passed(1e-9)]);
    assert_eq!(other.name(1e-8), "converged_to_rounding");
    let alone = Ended::new(&[passed(1e-9)]);
    assert_eq!((alone.name(1e-8), alone.residuals[1]), ("converged", 0.0));
    let failed = Ended::new(&[passed(1e-9), solve(1.0, SolveStatus::Breakdown)]);
    assert_eq!(failed.name(1e-8), SolveStatus::Breakdown.name());
    assert!(is_solved(both.name(1e-7)) && is_solved(both.name(1e-12)));
    assert!(!is_solved(failed.name(1e-8)));
}

fn adapter(kind: &'static str, storage_binding: u64) -> AdapterReport {
    AdapterReport {
        name: "made up".to_owned(),
        driver: String::new(),
        backend: "vulkan".to_owned(),
        kind,
        f64: true,
        timestamps: true,
        storage_buffers: 8,
        storage_binding,
        buffer: 1 << 40,
        threads: 256,
        workgroups: 65535,
    }
}

/// The matrix is the largest buffer: 80 bytes a quad in f32, 9852 quads of all levels at 30 cells, 24820 at 40; in f64 160 bytes, 3664 quads at
/// 20 cells.
#[test]
fn the_largest_binding_or_free_memory_decides() {
    let solver = |precision| Solver { precision, ..Solver::default() };
    let (small, memory) = (adapter("discrete", 1 << 20), 1 << 40);
    let capacity = Capacity { adapter: &small, memory };
    let [mixed, f64] = [Precision::Mixed, Precision::F64].map(solver);
    for (solvers, largest) in [(vec![mixed], 30), (vec![f64], 20), (vec![mixed, f64], 20)] {
        assert_eq!(capacity.largest(&solvers), Some(largest));
        capacity.check(largest, &solvers).unwrap();
        let error = capacity.check(largest + 10, &solvers).unwrap_err();
        assert!(matches!(error, Error::Limit { .. }), "{error}");
        let told = format!("at most {largest} cells");
        assert!(error.to_string().contains(&told), "{error}");
    }
    let memory = PER_CELL * 50_u64.pow(3);
    let largest = |kind, memory| {
        let adapter = &adapter(kind, 1 << 32);
        Capacity { adapter, memory }.largest(&[mixed])
    };
    assert_eq!(largest("discrete", memory), Some(50));
    assert_eq!(largest("discrete", memory - 1), Some(40));
    assert!(largest("software", memory) < Some(50), "it shares the memory");
    let adapter = &adapter("discrete", 1 << 32);
    let error = Capacity { adapter, memory: 0 }.check(8, &[mixed]).unwrap_err();
    assert!(matches!(error, Error::Memory { .. }), "{error}");
}

#[test]
fn the_largest_scale_is_found_in_steps_that_keep_cells_cubic() {
    for most in [1, 2, 3, 16, 17, 100, 1023] {
        assert_eq!(largest(&|n| n <= most), most);
    }
    // A cube in tens; twice as long as high: 5 units are 10 cells; long sides by units.
    for (cells, expected) in [([100, 100, 100], (100, 10)), ([64, 32, 32], (32, 5)), ([48, 3, 3], (3, 1))] {
        assert_eq!(units(cells), expected, "{cells:?}");
    }
}

fn way(cells: usize, precision: &str, tolerance: f64, iterations: usize) -> Row {
    taking(
        [12.0, 13.0, 14.0],
        row! { cells: cells, precision: precision, tolerance: tolerance, iterations: iterations },
    )
}

fn taking(seconds: [f64; 3], way: Row) -> Row {
    way.with(row! { seconds: Spread::of(seconds.to_vec()) })
}

/// Of the rows, in this order and the other.
fn chosen(rows: &[Row]) -> Row {
    let mut rows: Vec<&Row> = rows.iter().collect();
    let first = cheapest(&rows).unwrap().clone();
    rows.reverse();
    assert_eq!(&first, cheapest(&rows).unwrap(), "the order of rows counts");
    first
}

#[test]
fn rows_of_equal_time_are_chosen_by_their_needs() {
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
        rows.push(better.clone());
        assert_eq!(chosen(&rows), better);
    }
    let fastest = taking([9.0, 10.0, 11.9], way(20, "f64", 1e-6, 9));
    assert_eq!(chosen(&[fastest.clone(), way(10, "f32", 1e-2, 1)]), fastest);
    let disturbed = taking([9.0, 10.0, 90.0], way(20, "f64", 1e-6, 9));
    let slower = taking([12.6, 13.0, 14.0], way(10, "f32", 1e-2, 1));
    assert_eq!(chosen(&[disturbed.clone(), slower]), disturbed);
    assert!(cheapest(&[]).is_none());
    // Noise does not change the choice.
    let (mixed, double) = (way(20, "mixed", 1e-6, 9), way(20, "f64", 1e-4, 7));
    for [a, b] in [[0, 1], [1, 0]] {
        let seconds = [[9.0, 10.0, 12.0], [9.5, 11.0, 13.0]];
        let rows = [taking(seconds[a], mixed.clone()), taking(seconds[b], double.clone())];
        assert_eq!(chosen(&rows).text("precision"), "mixed");
    }
}

#[test]
fn less_accuracy_takes_no_longer() {
    // Rows of descending errors, the tolerances; as fast as the spreads tell, but for the last.
    let loose = taking([10.0, 14.0, 16.0], way(20, "mixed", 1e-2, 5));
    let tight = taking([9.0, 12.0, 15.0], way(20, "mixed", 1e-4, 9));
    let wide = taking([9.0, 11.0, 15.0], way(20, "f64", 1e-6, 9));
    let slow = taking([90.0, 91.0, 92.0], way(20, "f64", 1e-8, 9));
    let of = |rows: &[&Row]| -> Vec<(f64, f64)> {
        let targets = [1e-2, 1e-4, 1e-6, 1e-8, 1e-10];
        let found = recommended(rows, &targets, |row| row.number("tolerance"));
        found.iter().map(|(target, row)| (*target, row.number("tolerance"))).collect()
    };
    assert_eq!(
        of(&[&loose, &tight, &wide, &slow]),
        [(1e-2, 1e-4), (1e-4, 1e-4), (1e-6, 1e-6), (1e-8, 1e-8)],
        "a row of more bytes stands for no other, and a target that no row meets has none"
    );
    assert_eq!(of(&[&loose]), [(1e-2, 1e-2)]);
    assert_eq!(of(&[]), []);
    let broken = loose.with(row! { tolerance: f64::NAN });
    assert_eq!(of(&[&broken]), [], "an error that is not a number");
}

#[test]
fn a_solve_that_did_not_converge_is_no_truth() {
    let ensure = |status: SolveStatus, residual: f64| {
        let all = [solve(0.0, SolveStatus::Converged), solve(residual, status)];
        ensure_truth("dam_break, frame 10, stored in mixed", 87, all)
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
fn tosses_of_a_coin() {
    for (k, n, ways) in [(0, 12, 1.0), (2, 12, 79.0), (3, 12, 299.0), (12, 12, 4096.0)] {
        let chance = ways / 4096.0;
        assert!((pairs::at_most(k, n) - chance).abs() <= 1e-14, "{k} of {n}");
    }
    // Of very many half are at most half, but for the one in the middle: 0.5 + 0.5 sqrt(2 / (pi n)).
    let half = pairs::at_most(2000, 4000);
    assert!((half - 0.506_307).abs() < 1e-5, "{half}");
    let of = |n: usize| pairs::interval((1..=n).rev().map(|x| x as f64).collect());
    // Ranks at 95 % from tables of the sign test.
    for (n, low) in [(6, 1.0), (8, 1.0), (9, 2.0), (12, 3.0), (20, 6.0), (25, 8.0)] {
        assert_eq!(of(n), Some([low, (n + 1) as f64 - low]), "{n} values");
    }
    assert_eq!((of(5), of(0)), (None, None));
}

#[test]
fn differences_within_the_noise_are_nothing() {
    let around = |low, high| pairs::verdict(Some([low, high]), 0.5 * (low + high), Some(1.0));
    assert_eq!(around(-0.1, 9.0), pairs::NOTHING);
    assert_eq!(around(0.2, 1.4), pairs::NOTHING, "its median is within the noise");
    assert_eq!(around(0.9, 1.5), pairs::ADDS);
    assert_eq!(around(-1.5, -0.9), "saves");
    assert_eq!(pairs::verdict(None, 5.0, None), "too few pairs");
    let taken = |dispatches, solve_dispatches| Cost { seconds: 1.0, dispatches, solve_dispatches };
    let pairs = [(5, 90), (4, 7), (3, 11), (9, 10)].map(|(n, solve)| [taken(n, solve), taken(3, 10)]);
    assert_eq!(pairs::middle(&pairs, |taken| taken.dispatches), 1);
    assert_eq!(pairs::middle(&pairs, |taken| taken.solve_dispatches), 0);
    assert_eq!(pairs::differing(&pairs), 3);
    let [with, without] = pairs::against_both(pairs[0], pairs[1]);
    assert_eq!((with.seconds, without.seconds), (1.0, 2.0));
    assert_eq!((with.dispatches, without.dispatches), (5, 6));
}

#[test]
fn absent_effects_cost_what_chance_does_not() {
    let control = |pairs: usize, slower: usize| {
        row! {
            seconds_told: pairs::ADDS, bytes_added: 0_usize, dispatches_added: 0_usize, dispatches_differ: 0_usize,
            solve_dispatches_added: 0_usize, kernels: "", pairs: pairs, slower: slower,
        }
    };
    // Chances of 1 to 4096, 13 to 4096, 1 to 1024 and 1 to 512.
    for (pairs, slower, expected) in [(12, 12, true), (12, 11, false), (10, 10, true), (9, 9, false)] {
        assert_eq!(costs(&control(pairs, slower)), expected, "{slower} of {pairs}");
    }
    assert!(!costs(&control(12, 12).with(row! { seconds_told: pairs::NOTHING })));
    for other in [
        row! { bytes_added: -4_i64 },
        row! { dispatches_differ: 1_usize },
        row! { solve_dispatches_added: 2_usize },
        row! { kernels: "slip" },
    ] {
        assert!(costs(&control(2, 1).with(other.clone())), "{other:?}");
    }
}

#[test]
fn a_buffer_that_grew_counts_once() {
    let made = |list: &[(&str, u64)]| -> Vec<(String, u64)> {
        list.iter().map(|(label, bytes)| ((*label).to_owned(), *bytes)).collect()
    };
    let start = [("a", 1), ("b", 10), ("b", 20), ("c (read-back)", 100)];
    assert_eq!(bytes_in_use(&made(&start), 4), 131);
    let grown = [&start[..], &[("b", 30), ("b", 40), ("c (read-back)", 100)]].concat();
    assert_eq!(bytes_in_use(&made(&grown), 4), 171, "b anew");
    let twice = [&grown[..], &[("b", 50), ("b", 60), ("d", 1000)]].concat();
    assert_eq!(bytes_in_use(&made(&twice), 4), 1211, "b again, and d");
    let download = [&start[..], &[("a (read-back)", 1)]].concat();
    assert_eq!(bytes_in_use(&made(&download), 4), 131, "a download");
}
