//! The corpus of the fuzz targets, replayed: no reader panics, hangs, or asks for more memory than its file is worth. And a plain driver of
//! the same targets, for where libFuzzer is not at hand.

#[path = "../../fuzz/src/lib.rs"]
#[allow(unreachable_pub, reason = "for fuzzers it is a crate of its own")]
mod targets;

use std::collections::BTreeSet;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use cutwater::geometry::{parse_mesh, parse_tets};
use cutwater::scene::Scene;
use targets::{TARGETS, read};

use crate::common::Random;

/// For one file of some kilobytes.
const LONGEST: Duration = Duration::from_secs(2);
/// Address space of the process that replays, KiB; threads and the binary itself take most of it.
const MEMORY: u64 = 3 << 20;
/// Says to a process of this binary that it has little memory.
const LITTLE_MEMORY: &str = "CUTWATER_LITTLE_MEMORY";

fn corpus(target: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(target);
    let entries = fs::read_dir(folder).unwrap();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

/// Whether a file is read in time; on a busy machine at the third try.
fn is_soon(target: &str, bytes: &[u8]) -> bool {
    (0..3).any(|_| {
        let clock = Instant::now();
        read(target, bytes);
        clock.elapsed() < LONGEST
    })
}

/// In a process with little memory, where the system can limit it.
#[test]
fn the_corpus_is_read() {
    if cfg!(unix) && std::env::var_os(LITTLE_MEMORY).is_none() {
        let limited = format!("ulimit -v {MEMORY} && exec \"$0\" --exact fuzz::the_corpus_is_read --nocapture");
        let output = Command::new("sh")
            .args(["-c", &limited])
            .arg(std::env::current_exe().unwrap())
            .env(LITTLE_MEMORY, "1")
            .env("RAYON_NUM_THREADS", "2")
            .output()
            .unwrap();
        let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
        assert!(output.status.success(), "{}", text.join("\n"));
        assert!(text[0].contains("1 passed"), "{}", text.join("\n"));
        return;
    }
    for target in TARGETS {
        for file in corpus(target) {
            println!("{}", file.display());
            let bytes = fs::read(&file).unwrap();
            read(target, &bytes);
            assert!(is_soon(target, &bytes), "{} takes long", file.display());
        }
    }
}

/// Every reader gets as far as a file can bring it: some of its corpus is sound.
#[test]
fn the_corpus_has_sound_files_of_every_kind() {
    let mut bytes = 0;
    for target in TARGETS {
        let sound = corpus(target).into_iter().filter(|file| {
            let text = fs::read(file).unwrap();
            bytes += text.len();
            let name = format!("corpus.{target}");
            match target {
                "scene" => {
                    let text = String::from_utf8_lossy(&text);
                    Scene::parse(Path::new(&name), &text, &[], 1.0).is_ok()
                }
                "msh" | "vtu" => parse_tets(&text, Path::new(&name)).is_ok(),
                _ => parse_mesh(text, Path::new(&name)).is_ok(),
            }
        });
        let n = sound.count();
        assert!(n >= 2, "{n} sound files of {target}");
    }
    assert!(bytes < 500_000, "{bytes} bytes are too many to keep");
}

/// Numbers at the ends of what numbers can be, and other words that a reader may trip over.
const WORDS: [&str; 24] = [
    "0",
    "-1",
    "1",
    "255",
    "256",
    "65536",
    "2147483647",
    "-2147483648",
    "4294967295",
    "4294967296",
    "9223372036854775807",
    "18446744073709551615",
    "1e308",
    "-1e308",
    "1e999",
    "1e-320",
    "nan",
    "inf",
    "",
    " ",
    "\n",
    "\"",
    "[",
    "}",
];

/// Most bytes of a file that is made.
const LARGEST: usize = 20_000;

/// One change of a file; words and parts of others go into it.
fn mutate(random: &mut Random, bytes: &mut Vec<u8>, other: &[u8]) {
    let pick = |random: &mut Random, n: usize| random.bits() as usize % n.max(1);
    let (at, len) = (pick(random, bytes.len() + 1), pick(random, 16));
    let end = (at + len).min(bytes.len());
    match random.bits() % 9 {
        0 => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte ^= 1 << (len % 8)),
        1 => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte = random.bits() as u8),
        2 => drop(bytes.drain(at..end)),
        3 => {
            let part = bytes[at..end].to_vec();
            bytes.splice(at..at, part);
        }
        4 => bytes.truncate(at),
        5 => {
            let word = WORDS[pick(random, WORDS.len())].bytes();
            bytes.splice(at..at, word);
        }
        6 => {
            // A number in its text.
            let numbers: Vec<usize> = (0..bytes.len()).filter(|&at| bytes[at].is_ascii_digit()).collect();
            if !numbers.is_empty() {
                let start = numbers[pick(random, numbers.len())];
                let rest = bytes[start..].iter();
                let n = rest.take_while(|byte| byte.is_ascii_digit() || b".e-".contains(byte)).count();
                bytes.splice(start..start + n, WORDS[pick(random, 18)].bytes());
            }
        }
        7 => {
            // Four bytes of a count.
            let count = [0, 1, 0xff, 0x7f, 0x80][pick(random, 5)];
            bytes.iter_mut().skip(at).take(4).for_each(|byte| *byte = count);
        }
        _ => {
            let from = pick(random, other.len() + 1);
            let part = &other[from..(from + 4 * len).min(other.len())];
            bytes.splice(at..end, part.iter().copied());
        }
    }
}

/// Changes of the corpus, led by what the reader says: a file that is refused in new words is changed further. For half a second a target,
/// of ever the same files; fuzz/README.md says how to have it go on. What breaks the reader goes to `FUZZ_OUT`.
#[test]
fn changed_files_are_read() {
    let variable = |name: &str| std::env::var(name).ok();
    let out = PathBuf::from(variable("FUZZ_OUT").unwrap_or_else(|| "fuzz/artifacts".to_owned()));
    let number = |name: &str, usual: u64| variable(name).map_or(usual, |text| text.parse().unwrap());
    let limit = Duration::from_millis(number("FUZZ_MILLISECONDS", 500));
    let only = variable("FUZZ_TARGET");
    for target in TARGETS {
        if only.as_ref().is_none_or(|only| only == target) {
            change_and_read(target, limit, Random(number("FUZZ_SEED", 1)), &out);
        }
    }
}

fn change_and_read(target: &str, limit: Duration, mut random: Random, out: &Path) {
    let mut pool: Vec<Vec<u8>> = corpus(target).iter().map(|file| fs::read(file).unwrap()).collect();
    let words = |message: Option<String>| {
        let message = message.unwrap_or_default();
        message.chars().filter(|c| !c.is_ascii_digit()).take(200).collect::<String>()
    };
    let mut said: BTreeSet<String> = pool.iter().map(|bytes| words(read(target, bytes))).collect();
    let (clock, mut runs, mut slowest, mut broken) = (Instant::now(), 0u64, Duration::ZERO, 0);
    while clock.elapsed() < limit {
        let mut bytes = pool[random.bits() as usize % pool.len()].clone();
        let other = pool[random.bits() as usize % pool.len()].clone();
        for _ in 0..1 + random.bits() % 6 {
            mutate(&mut random, &mut bytes, &other);
        }
        bytes.truncate(LARGEST);
        let start = Instant::now();
        let outcome = catch_unwind(AssertUnwindSafe(|| read(target, &bytes)));
        let took = start.elapsed();
        runs += 1;
        slowest = slowest.max(took);
        match outcome {
            Ok(message) if took < LONGEST || is_soon(target, &bytes) => {
                if pool.len() < 4000 && said.insert(words(message)) {
                    pool.push(bytes);
                }
            }
            _ => {
                broken += 1;
                fs::create_dir_all(out).unwrap();
                fs::write(out.join(format!("{target}_{broken}")), &bytes).unwrap();
                assert!(broken < 20, "enough to mend");
            }
        }
    }
    println!(
        "{target}: {runs} files in {:?}, {} answers, slowest {slowest:?}, {broken} broke it",
        clock.elapsed(),
        said.len()
    );
    assert_eq!(broken, 0, "{target}: see {}", out.display());
}
