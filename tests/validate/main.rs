//! The long validation: cases with answers known from theory or from other programs, on the f64 path and on the device.
//!
//! ```text
//! make validate                     # all cases of the classes quick and default
//! make validate ARGS=--quick        # those of the class quick
//! make validate ARGS=--full         # all cases
//! make validate CASES="S2 S9/f64"   # cases of any class whose id contains one of these
//! make validate ARGS=--resume       # resumes a stopped run
//! make validate ARGS="--set liquid.surface=level" CASES=F    # with another value of a key
//! ```
//!
//! A case is a function that fills a [`Sheet`] with rows: quantity, expected and computed value, bound. Each topic has a file that
//! lists its cases; [`cases`] lists the topics and cost.rs the cost class of each case. The run prints the rows and writes a page with charts to
//! `target/validate`. With `--publish` it also merges rows and charts into docs/measured/validation. Exit code 1: a row failed.

// Shared with the suite.
#[allow(dead_code, reason = "the suite uses the rest")]
#[path = "../suite/added_mass.rs"]
mod added_mass;
#[allow(dead_code, reason = "the suite uses the rest")]
#[path = "../suite/common.rs"]
mod common;
#[allow(dead_code, reason = "the suite uses the rest")]
#[path = "../suite/drops.rs"]
mod drops;
#[path = "../suite/kills.rs"]
mod kills;
#[allow(dead_code, reason = "the suite uses the rest")]
#[path = "../suite/plane_strain.rs"]
mod plane_strain;
#[allow(dead_code, reason = "the suite uses the rest")]
#[path = "../suite/solid_cases.rs"]
mod solid_cases;
#[allow(dead_code, reason = "the suite uses the rest")]
#[path = "../suite/solid_modes.rs"]
mod solid_modes;
#[allow(dead_code, reason = "the suite uses the rest")]
#[path = "../suite/solid_scene.rs"]
mod solid_scene;

mod cost;
mod coupled;
mod coupled_scenes;
mod coupled_truths;
mod lamb;
mod lane;
mod level;
mod liquid;
mod page;
mod published;
mod results;
mod resume;
mod sheet;
mod solid_balances;
mod solid_drops;
mod solid_elements;
mod solid_inversion;
mod solid_motion;
mod solid_scenes;
mod solid_statics;
mod thesis_tables;
mod waves;
mod weak_coupling;

use std::collections::BTreeMap;
use std::error::Error;
use std::panic::{self, AssertUnwindSafe};
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use cutwater::gpu::{AdapterChoice, Gpu};
use cutwater::measure::bench::Machine;

use cost::{Class, Sum};
use published::Published;
use results::{ResultStore, Results};
use sheet::{Row, Sheet};

/// A comparison with a reference.
pub(crate) struct Case {
    /// A section of docs/validation.md.
    topic: &'static str,
    /// Names it on the command line and in the table.
    id: String,
    /// Whether it runs while no other does: one that is judged by its seconds.
    alone: bool,
    run: Box<dyn Fn(&mut Sheet) + Send + Sync>,
}

impl Case {
    fn new(id: impl Into<String>, run: impl Fn(&mut Sheet) + Send + Sync + 'static) -> Case {
        Case { topic: "", id: id.into(), alone: false, run: Box::new(run) }
    }

    /// One that runs while no other does.
    fn alone(id: impl Into<String>, run: impl Fn(&mut Sheet) + Send + Sync + 'static) -> Case {
        Case { alone: true, ..Case::new(id, run) }
    }

    /// Rows and charts. A panic is a failed row.
    fn evaluate(&self) -> Results {
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
        Results { rows, charts }
    }
}

/// All cases, in the order of the table.
fn cases() -> Vec<Case> {
    [
        ("liquid", liquid::cases()),
        ("liquid", waves::cases()),
        ("liquid", level::cases()),
        ("coupled solve", coupled::cases()),
        ("liquid and solids", coupled_truths::cases()),
        ("liquid and solids", lamb::cases()),
        ("liquid and solids", weak_coupling::cases()),
        ("liquid and solids", thesis_tables::cases()),
        ("thesis", coupled_scenes::cases()),
        ("thesis, two frames", coupled_scenes::frames()),
        ("solids", solid_elements::cases()),
        ("solids", solid_statics::cases()),
        ("solids", solid_motion::cases()),
        ("solids", solid_balances::cases()),
        ("solids", solid_inversion::cases()),
        ("solids", solid_drops::cases()),
        ("hard materials", solid_scenes::cases()),
        ("kills", resume::cases()),
    ]
    .into_iter()
    .flat_map(|(topic, cases)| cases.into_iter().map(move |case| Case { topic, ..case }))
    .collect()
}

/// Runs the cases, `jobs` at a time and those that took longest first, then those that run alone. Rows and charts are in the order of the cases.
/// Cases with stored results do not run again.
fn run(cases: &[&Case], jobs: usize, store: &ResultStore, published: &Published) -> Results {
    let done: Vec<Mutex<Results>> = cases.iter().map(|_| Mutex::default()).collect();
    let evaluate = |number: usize| {
        let case = &cases[number];
        let results = store.load(case.topic, &case.id).unwrap_or_else(|| {
            let results = case.evaluate();
            store.store(&case.id, &results);
            results
        });
        print!("{}", sheet::lines(&results.rows));
        *done[number].lock().expect("no other thread has this case") = results;
    };
    let (alone, mut beside): (Vec<usize>, Vec<usize>) = (0..cases.len()).partition(|&number| cases[number].alone);
    let seconds = |number: usize| published.seconds(&cases[number].id).unwrap_or(f64::INFINITY);
    beside.sort_by(|&a, &b| seconds(b).total_cmp(&seconds(a)));
    let next = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for _ in 0..jobs {
            scope.spawn(|| {
                while let Some(&number) = beside.get(next.fetch_add(1, Ordering::Relaxed)) {
                    evaluate(number);
                }
            });
        }
    });
    alone.into_iter().for_each(evaluate);
    let mut all = Results::default();
    for results in done {
        let Results { rows, charts } = results.into_inner().expect("no thread is left");
        all.rows.extend(rows);
        all.charts.extend(charts);
    }
    all
}

/// The command line.
struct Options {
    list: bool,
    resume: bool,
    publish: bool,
    jobs: usize,
    /// `KEY=VALUE`, for scenes that do not name the key.
    settings: Vec<String>,
    /// The most expensive class that runs.
    class: Class,
    /// Parts of ids.
    filters: Vec<String>,
}

impl Options {
    fn parse(mut arguments: impl Iterator<Item = String>) -> Result<Options, String> {
        let mut options = Options {
            list: false,
            resume: false,
            publish: false,
            jobs: std::thread::available_parallelism().map_or(1, usize::from),
            settings: Vec::new(),
            class: Class::Default,
            filters: Vec::new(),
        };
        let mut class = None;
        while let Some(argument) = arguments.next() {
            match argument.as_str() {
                "--list" => options.list = true,
                "--resume" => options.resume = true,
                "--publish" => options.publish = true,
                "--quick" => class = Some(Class::Quick),
                "--full" => class = Some(Class::Full),
                "--jobs" => match arguments.next().map(|jobs| jobs.parse()) {
                    Some(Ok(number)) if number > 0 => options.jobs = number,
                    _ => return Err("--jobs needs a number of cases to run at once".into()),
                },
                "--set" => match arguments.next() {
                    Some(setting) if setting.contains('=') => options.settings.push(setting),
                    _ => return Err("--set needs KEY=VALUE, such as liquid.surface=level".into()),
                },
                option if option.starts_with('-') => {
                    return Err(format!(
                        "no option {option}: use --quick, --full, --list, --resume, --publish, --jobs N, --set KEY=VALUE, then parts of ids"
                    ));
                }
                _ => options.filters.push(argument),
            }
        }
        if !options.settings.is_empty() && (options.publish || options.resume) {
            return Err(
                "--set is about other rows than those published and stored: leave --publish and --resume away".into()
            );
        }
        // A case that is named runs whatever it costs.
        let of_names = match options.filters.is_empty() {
            true => Class::Default,
            false => Class::Full,
        };
        options.class = class.unwrap_or(of_names);
        Ok(options)
    }

    fn selects(&self, id: &str) -> bool {
        let named = || self.filters.iter().any(|part| id.contains(part));
        cost::class_of(id) <= self.class && (self.filters.is_empty() || named())
    }
}

/// A line per class that has cases: how many, and their seconds, one after the other.
fn classes(sums: [Sum; 3]) -> String {
    let mut text = String::new();
    for (class, Sum { cases, seconds }) in Class::ALL.into_iter().zip(sums) {
        if cases > 0 {
            text += &format!("{:<8} {cases:>4} cases {seconds:>7.0} s\n", class.name());
        }
    }
    text
}

fn main() -> ExitCode {
    let options = match Options::parse(std::env::args().skip(1)) {
        Ok(options) => options,
        Err(problem) => {
            eprintln!("{problem}");
            return ExitCode::from(2);
        }
    };
    match validate(&options) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn validate(options: &Options) -> Result<ExitCode, Box<dyn Error>> {
    let all = cases();
    cost::check(all.iter().map(|case| case.id.as_str()));
    let cases: Vec<&Case> = all.iter().filter(|case| options.selects(&case.id)).collect();
    if cases.is_empty() {
        eprintln!("no case has an id with {}", options.filters.join(" or "));
        return Ok(ExitCode::from(2));
    }
    let published = Published::read()?;
    if options.list {
        for case in &cases {
            let seconds = published.seconds(&case.id);
            let seconds = seconds.map_or("-".to_owned(), |seconds| format!("{seconds:.0} s"));
            println!("{:<40} {:<8} {seconds:>6}", case.id, cost::class_of(&case.id).name());
        }
        return Ok(ExitCode::SUCCESS);
    }
    let machine = match Gpu::new(&AdapterChoice::Best).and_then(|gpu| Machine::new(&gpu, 3)) {
        Ok(machine) => machine,
        Err(error) => {
            eprintln!("{error}");
            return Ok(ExitCode::from(3));
        }
    };
    // The table has the messages.
    panic::set_hook(Box::new(|panic| eprintln!("{panic}")));
    let before = |case: &Case| published.seconds(&case.id).unwrap_or(0.0);
    println!(
        "{} cases on {}, {} at a time. As published:\n{}",
        cases.len(),
        machine.name(),
        options.jobs,
        classes(cost::sums(cases.iter().map(|case| (case.id.as_str(), before(case)))))
    );
    let start = Instant::now();
    let settings = options.settings.iter().map(|setting| (setting.clone(), AtomicUsize::new(0))).collect();
    let settings: &Vec<(String, AtomicUsize)> = liquid::SETTINGS.get_or_init(|| settings);
    let store = ResultStore::new(&sheet::folder(), &machine, &options.settings)?;
    if !options.resume {
        if settings.is_empty() {
            store.remove_others()?;
        }
        cases.iter().try_for_each(|case| store.remove(&case.id))?;
    }
    let Results { rows, charts } = run(&cases, options.jobs, &store, &published);
    let failed: Vec<&Row> = rows.iter().filter(|row| row.passed == Some(false)).collect();
    let summary = format!(
        "{} rows of {} cases in {:.0} s on {}: {} failed",
        rows.len(),
        cases.len(),
        start.elapsed().as_secs_f64(),
        machine.name(),
        failed.len()
    );
    sheet::write(&rows, &charts, &summary)?;
    if options.publish {
        published.merge(&all, &rows, &charts, &machine)?;
    }
    let mut seconds: BTreeMap<&str, f64> = BTreeMap::new();
    seconds.extend(rows.iter().map(|row| (row.id.as_str(), row.seconds)));
    println!("\n{}\n{summary}", classes(cost::sums(seconds.into_iter())));
    for row in &failed {
        print!("{}", sheet::lines(std::slice::from_ref(row)));
    }
    for (setting, scenes) in settings {
        println!("--set {setting} changed {} scenes", scenes.load(Ordering::Relaxed));
    }
    if settings.iter().any(|(_, scenes)| scenes.load(Ordering::Relaxed) == 0) {
        eprintln!("a setting that changes no scene says nothing: correct its key, or select other cases");
        return Ok(ExitCode::from(2));
    }
    Ok(match failed.is_empty() {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    })
}
