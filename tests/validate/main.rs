//! The long validation: cases with answers known from theory or from other programs, on the f64 path and on the device.
//!
//! ```text
//! make validate                     # all cases
//! make validate CASES="S2 S9/f64"   # those whose id holds one of these
//! make validate CASES=--resume      # goes on after a run that was stopped
//! ```
//!
//! A case is a function that fills a [`Sheet`] with rows: what was expected, what came, what is allowed. Each topic has a file that
//! lists its cases; the list of topics is [`cases`]. The table is printed; a page with charts of what came over what
//! was expected, and the table as CSV, are written to `target/validate`. Exit code 1: a row failed.

// What the suite shares; it uses more of it.
#[allow(dead_code, reason = "the suite uses the rest")]
#[path = "../suite/common.rs"]
mod common;
#[path = "../suite/kills.rs"]
mod kills;
#[allow(dead_code, reason = "the suite uses the rest")]
#[path = "../suite/solid_cases.rs"]
mod solid_cases;
#[allow(dead_code, reason = "the suite uses the rest")]
#[path = "../suite/solid_modes.rs"]
mod solid_modes;
#[allow(dead_code, reason = "the suite uses the rest")]
#[path = "../suite/solid_scene.rs"]
mod solid_scene;

mod benches;
mod coupled;
mod coupled_scenes;
mod coupled_truths;
mod found;
mod lamb;
mod lane;
mod liquid;
mod page;
mod resume;
mod sheet;
mod solid_balances;
mod solid_elements;
mod solid_inversion;
mod solid_motion;
mod solid_scenes;
mod solid_statics;
mod waves;

use std::panic::{self, AssertUnwindSafe};
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use cutwater::gpu::{AdapterChoice, Gpu};
use cutwater::measure::table::Machine;

use found::{Found, Kept};
use sheet::{Row, Sheet};

/// Something to find out.
pub(crate) struct Case {
    /// What it is about: a section of docs/validation.md.
    topic: &'static str,
    /// Names it on the command line and in the table.
    id: String,
    /// Whether it runs while no other does: one that is judged by its seconds.
    alone: bool,
    run: Box<dyn Fn(&mut Sheet) + Send + Sync>,
}

impl Case {
    fn new(id: impl Into<String>, run: impl Fn(&mut Sheet) + Send + Sync + 'static) -> Case {
        Case {
            topic: "",
            id: id.into(),
            alone: false,
            run: Box::new(run),
        }
    }

    /// One that runs while no other does.
    fn alone(id: impl Into<String>, run: impl Fn(&mut Sheet) + Send + Sync + 'static) -> Case {
        Case {
            alone: true,
            ..Case::new(id, run)
        }
    }

    /// Its rows and charts. What panics fails.
    fn find(&self) -> Found {
        let mut sheet = Sheet::default();
        let start = Instant::now();
        let outcome = panic::catch_unwind(AssertUnwindSafe(|| (self.run)(&mut sheet)));
        let seconds = start.elapsed().as_secs_f64();
        if let Err(panic) = outcome {
            let text = panic.downcast_ref::<String>().cloned();
            let text = text.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).into()));
            sheet.failed(&text.unwrap_or_else(|| "a panic".into()));
        }
        let (rows, charts) = sheet.finish(self.topic, &self.id, seconds);
        Found { rows, charts }
    }
}

/// All cases, in the order of the table.
fn cases() -> Vec<Case> {
    [
        ("liquid", liquid::cases()),
        ("liquid", waves::cases()),
        ("coupled solve", coupled::cases()),
        ("liquid and solids", coupled_truths::cases()),
        ("liquid and solids", lamb::cases()),
        ("liquid and solids", benches::cases()),
        ("thesis", coupled_scenes::cases()),
        ("thesis, two frames", coupled_scenes::frames()),
        ("solids", solid_elements::cases()),
        ("solids", solid_statics::cases()),
        ("solids", solid_motion::cases()),
        ("solids", solid_balances::cases()),
        ("solids", solid_inversion::cases()),
        ("hard materials", solid_scenes::cases()),
        ("kills", resume::cases()),
    ]
    .into_iter()
    .flat_map(|(topic, cases)| cases.into_iter().map(move |case| Case { topic, ..case }))
    .collect()
}

/// Runs the cases, `jobs` at a time, and at last those that run alone; rows and charts in the order of the cases. What is kept of a case is
/// not found again.
fn run(cases: &[Case], jobs: usize, kept: &Kept) -> Found {
    let done: Vec<Mutex<Found>> = cases.iter().map(|_| Mutex::default()).collect();
    let find = |number: usize| {
        let case = &cases[number];
        let found = kept.of(case.topic, &case.id).unwrap_or_else(|| {
            let found = case.find();
            kept.keep(&case.id, &found);
            found
        });
        print!("{}", sheet::lines(&found.rows));
        *done[number].lock().expect("no other thread has this case") = found;
    };
    let (alone, beside): (Vec<usize>, Vec<usize>) =
        (0..cases.len()).partition(|&number| cases[number].alone);
    let next = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for _ in 0..jobs {
            scope.spawn(|| {
                while let Some(&number) = beside.get(next.fetch_add(1, Ordering::Relaxed)) {
                    find(number);
                }
            });
        }
    });
    alone.into_iter().for_each(find);
    let found = done.into_iter().map(|found| found.into_inner());
    let mut all = Found::default();
    for found in found {
        let Found { rows, charts } = found.expect("no thread is left");
        all.rows.extend(rows);
        all.charts.extend(charts);
    }
    all
}

fn main() -> ExitCode {
    let mut filters = Vec::new();
    let (mut list, mut resume, mut jobs) = (
        false,
        false,
        std::thread::available_parallelism().map_or(1, usize::from),
    );
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--list" => list = true,
            "--resume" => resume = true,
            "--jobs" => match arguments.next().map(|jobs| jobs.parse()) {
                Some(Ok(number)) if number > 0 => jobs = number,
                _ => {
                    eprintln!("--jobs takes a number of cases to run at once");
                    return ExitCode::from(2);
                }
            },
            option if option.starts_with('-') => {
                eprintln!(
                    "no option {option}: there are --list, --resume and --jobs N, then parts of ids"
                );
                return ExitCode::from(2);
            }
            _ => filters.push(argument),
        }
    }
    let mut cases = cases();
    cases.retain(|case| filters.is_empty() || filters.iter().any(|part| case.id.contains(part)));
    if cases.is_empty() {
        eprintln!("no case has an id with {}", filters.join(" or "));
        return ExitCode::from(2);
    }
    if list {
        cases.iter().for_each(|case| println!("{}", case.id));
        return ExitCode::SUCCESS;
    }
    let machine = match Gpu::new(&AdapterChoice::Best).and_then(|gpu| Machine::new(&gpu, 3)) {
        Ok(machine) => machine,
        Err(error) => {
            eprintln!("{error}");
            return ExitCode::from(3);
        }
    };
    // The table tells the rest.
    panic::set_hook(Box::new(|panic| eprintln!("{panic}")));
    println!(
        "{} cases on {}, {jobs} at a time\n",
        cases.len(),
        machine.adapter
    );
    let start = Instant::now();
    // A run of some cases leaves what is kept of the others.
    let kept = Kept::new(&sheet::folder(), &machine).and_then(|kept| {
        match (resume, filters.is_empty()) {
            (true, _) => {}
            (false, true) => kept.forget_all()?,
            (false, false) => cases.iter().try_for_each(|case| kept.forget(&case.id))?,
        }
        Ok(kept)
    });
    let kept = match kept {
        Ok(kept) => kept,
        Err(error) => {
            eprintln!("target/validate: {error}");
            return ExitCode::FAILURE;
        }
    };
    let Found { rows, charts } = run(&cases, jobs, &kept);
    let failed: Vec<&Row> = rows
        .iter()
        .filter(|row| row.passed == Some(false))
        .collect();
    let summary = format!(
        "{} rows of {} cases in {:.0} s on {}: {} failed",
        rows.len(),
        cases.len(),
        start.elapsed().as_secs_f64(),
        machine.adapter,
        failed.len()
    );
    if let Err(error) = sheet::write(&rows, &charts, &summary, machine) {
        eprintln!("target/validate: {error}");
        return ExitCode::FAILURE;
    }
    println!("\n{summary}");
    for row in &failed {
        print!("{}", sheet::lines(std::slice::from_ref(row)));
    }
    match failed.is_empty() {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    }
}
