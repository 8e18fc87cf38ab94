//! Runs of the program that are killed and go on, and what they leave against a run that nobody disturbs.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use cutwater::output::checkpoint::Checkpoint;
use cutwater::output::is_partial;

use crate::common::{Random, json, program};

/// A scene in a folder, and how it is run.
pub(crate) struct Run<'a> {
    pub(crate) folder: &'a Path,
    /// Separated by spaces.
    pub(crate) arguments: &'a str,
}

/// What came of runs that were killed.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Killed {
    /// How often.
    pub(crate) kills: usize,
    /// Kills that left a checkpoint to go on from.
    pub(crate) from_checkpoint: usize,
    /// Runs that were killed at least once, and came to their end.
    pub(crate) runs: usize,
}

impl Run<'_> {
    /// The program with these arguments, and the run's folder among its scene's.
    pub(crate) fn command(&self, out: &str, more: &str) -> Command {
        let mut command = program();
        command
            .args(self.arguments.split_whitespace())
            .args(["--out", out])
            .args(more.split_whitespace())
            .current_dir(self.folder)
            .stdin(Stdio::null());
        command
    }

    /// Runs it to its end, which must be a good one.
    pub(crate) fn whole(&self, out: &str, more: &str) -> PathBuf {
        let output = self.command(out, more).output().unwrap();
        let told = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{more}: {told}");
        self.folder.join(out)
    }

    /// Kills runs at random moments, so many times in all, and lets each come to its end; every one must leave what an undisturbed one
    /// leaves, and at no time a file that is not whole.
    pub(crate) fn killed(&self, kills: usize, random: &mut Random) -> Killed {
        let clock = Instant::now();
        let whole = self.whole("whole", "");
        let seconds = clock.elapsed().as_secs_f64();
        let wanted = contents(&whole);
        let mut done = Killed::default();
        while done.kills < kills {
            let out = format!("killed_{}", done.runs);
            let run = self.folder.join(&out);
            let mut disturbed = false;
            loop {
                let patience = if done.kills < kills {
                    Duration::from_secs_f64(random.uniform(0.0, 1.1 * seconds))
                } else {
                    Duration::MAX
                };
                let mut child =
                    self.command(&out, "--resume").stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
                let start = Instant::now();
                let status = loop {
                    if let Some(status) = child.try_wait().unwrap() {
                        break Some(status);
                    }
                    if start.elapsed() >= patience {
                        child.kill().unwrap();
                        child.wait().unwrap();
                        break None;
                    }
                    std::thread::sleep(Duration::from_millis(2));
                };
                if let Some(status) = status {
                    assert!(status.success(), "{out} after {} kills: {status}", done.kills);
                    break;
                }
                disturbed = true;
                done.kills += 1;
                done.from_checkpoint += usize::from(Checkpoint::path(&run).exists());
                ensure_whole(&run, &wanted);
            }
            assert_same(&contents(&run), &wanted);
            fs::remove_dir_all(&run).unwrap();
            done.runs += usize::from(disturbed);
        }
        done
    }
}

/// Every file below a folder by its name, as far as it does not depend on the clock on the wall: of steps.csv all columns but those of
/// seconds, of manifest.json and checkpoint.npz all but the seconds, and the length that steps.csv has by their digits.
pub(crate) fn contents(run: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![run.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let name = path.strip_prefix(run).unwrap().to_str().unwrap().to_owned();
            let content = match &*name {
                "steps.csv" => without_seconds(&path),
                "manifest.json" => {
                    let mut manifest = json(fs::read(&path).unwrap());
                    manifest["progress"]["seconds"].take();
                    manifest.to_string().into_bytes()
                }
                "checkpoint.npz" => {
                    let mut checkpoint = Checkpoint::read(run).unwrap().unwrap();
                    checkpoint.steps_bytes = 0;
                    checkpoint.manifest.progress.seconds = 0.0;
                    format!("{checkpoint:?}").into_bytes()
                }
                _ => fs::read(&path).unwrap(),
            };
            found.insert(name, content);
        }
    }
    found
}

fn without_seconds(table: &Path) -> Vec<u8> {
    let mut reader = csv::ReaderBuilder::new().has_headers(false).from_path(table).unwrap();
    let mut kept = Vec::new();
    let mut timed = BTreeSet::new();
    for row in reader.records() {
        let row = row.unwrap();
        if kept.is_empty() {
            let names = row.iter().enumerate();
            timed = names.filter(|(_, name)| name.starts_with("seconds_")).map(|(column, _)| column).collect();
        }
        for (column, field) in row.iter().enumerate() {
            if !timed.contains(&column) {
                kept.extend_from_slice(field.as_bytes());
                kept.push(b',');
            }
        }
        kept.push(b'\n');
    }
    kept
}

/// Names what differs.
pub(crate) fn assert_same(found: &BTreeMap<String, Vec<u8>>, wanted: &BTreeMap<String, Vec<u8>>) {
    let names = |of: &BTreeMap<String, Vec<u8>>| of.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(found), names(wanted));
    let differ = wanted.iter().filter(|(name, content)| found[*name] != **content);
    let differ: Vec<_> = differ.map(|(name, _)| name).collect();
    assert!(differ.is_empty(), "{differ:?} differ");
}

/// What a killed run left under final names is whole: frames as they should be, tables up to a point, a manifest and a checkpoint that can
/// be read.
fn ensure_whole(run: &Path, wanted: &BTreeMap<String, Vec<u8>>) {
    let entries =
        [run.to_owned(), run.join("frames")].into_iter().filter_map(|folder| fs::read_dir(folder).ok()).flatten();
    for entry in entries {
        let path = entry.unwrap().path();
        let name = path.strip_prefix(run).unwrap().to_str().unwrap().to_owned();
        let file = path.file_name().unwrap().to_str().unwrap();
        if path.is_dir() || is_partial(file) || file == ".lock" {
            continue;
        }
        match &*name {
            "manifest.json" => {
                json(fs::read(&path).unwrap());
            }
            "checkpoint.npz" => {
                Checkpoint::read(run).unwrap().unwrap();
            }
            "steps.csv" => {}
            "probes.csv" => {
                let table = fs::read(&path).unwrap();
                assert!(wanted[&name].starts_with(&table), "{name}");
            }
            _ if name.ends_with(".pvd") => {
                let text = fs::read_to_string(&path).unwrap();
                assert!(text.ends_with("</VTKFile>\n"), "{name}: {text}");
            }
            _ => assert!(wanted[&name] == fs::read(&path).unwrap(), "{name} differs"),
        }
    }
}
