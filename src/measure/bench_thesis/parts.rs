//! What earlier runs have left in the folder: removed, or with `--resume` taken up where it can stand beside what this run measures.

use std::fs;
use std::path::Path;

use serde::Serialize;
use serde_json::Value;

use super::{Table, systems};
use crate::Error;
use crate::measure::statistics::Spread;
use crate::measure::table::Machine;

/// All that the bench writes.
pub(super) const FILES: [&str; 8] = [
    "thesis.json",
    "thesis.svg",
    "thesis_scenes.csv",
    "thesis_systems.csv",
    "thesis_means.csv",
    "thesis_growth.csv",
    "thesis.csv",
    "thesis_orders.csv",
];

/// Those of them that a run which goes on has nothing of.
pub(super) const NOT_KEPT: [&str; 4] = [
    "thesis.svg",
    "thesis_scenes.csv",
    "thesis.csv",
    "thesis_orders.csv",
];

/// Keys of thesis.json that runs have in common whose rows stand in one table.
const IN_COMMON: [&str; 8] = [
    "cutwater",
    "sources",
    "adapter",
    "driver",
    "cpu",
    "threads",
    "precisions",
    "repeats",
];

/// The cure for rows that cannot be taken up.
pub(super) const ANEW: &str =
    "measure into another folder (--out), or leave --resume out to measure all anew";

/// A run that measured some of the rows: when, and how busy the machine was.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Part {
    /// When it began, UTC, as RFC 3339 has it.
    pub measured: String,
    /// Load average of the minute before, where the system tells.
    pub load: Option<f64>,
    /// Bytes per second of a copy, read and written.
    pub copy_bandwidth: Spread,
}

impl Part {
    pub(super) fn of(machine: &Machine) -> Part {
        Part {
            measured: machine.host.measured.clone(),
            load: machine.host.load,
            copy_bandwidth: machine.copy_bandwidth,
        }
    }

    fn read(json: &Value) -> Option<Part> {
        let bandwidth = |of: &str| json["copy_bandwidth"][of].as_f64();
        Some(Part {
            measured: json["measured"].as_str()?.to_owned(),
            load: json["load"].as_f64(),
            copy_bandwidth: Spread {
                median: bandwidth("median")?,
                min: bandwidth("min")?,
                max: bandwidth("max")?,
            },
        })
    }
}

impl Table {
    /// Takes up the rows of tables 6.2 to 6.4 that earlier runs have left, and when these ran.
    ///
    /// # Errors
    /// [`Error::Input`] where they cannot be read, or those runs had not what this one has.
    pub(super) fn take_up(&mut self, out: &Path) -> Result<(), Error> {
        let (rows, path) = (out.join("thesis_systems.csv"), out.join("thesis.json"));
        if !rows.exists() {
            return Ok(());
        }
        let refused = |problem: String| Error::input(path.display().to_string(), problem, ANEW);
        let text = fs::read_to_string(&path).map_err(|problem| {
            refused(format!(
                "tells how thesis_systems.csv was measured, and cannot be read: {problem}"
            ))
        })?;
        let then: Value = serde_json::from_str(&text)
            .map_err(|problem| refused(format!("cannot be read: {problem}")))?;
        let now = serde_json::to_value(&*self).map_err(|problem| Error::output(&path, problem))?;
        for key in IN_COMMON {
            let (then, now) = (&then[key], &now[key]);
            if then != now {
                return Err(refused(format!("it has {key} {then}, this run {now}")));
            }
        }
        let parts = then["parts"].as_array();
        let parts: Option<Vec<Part>> =
            parts.and_then(|parts| parts.iter().map(Part::read).collect());
        self.parts = parts
            .ok_or_else(|| refused("it does not say when its parts were measured".to_owned()))?;
        self.systems = systems::kept(&rows)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::{Part, Table};
    use crate::measure::statistics::Spread;
    use crate::measure::table::{Host, Machine, write_json};

    fn table() -> Table {
        let host = Host {
            cutwater: "0.1.0",
            sources: "0123456789ab",
            measured: "2026-11-22T05:00:00Z".to_owned(),
            cpu: Some("a CPU".to_owned()),
            threads: 2,
            load: Some(0.1),
        };
        let copy_bandwidth = Spread {
            median: 2e9,
            min: 1e9,
            max: 1e10 / 3.0,
        };
        let machine = Machine {
            host,
            adapter: "an adapter".to_owned(),
            driver: "a driver".to_owned(),
            copy_bandwidth,
        };
        Table::new(machine, vec!["mixed"], 3)
    }

    #[test]
    fn rows_are_taken_up_with_their_parts_or_refused() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        let (rows, json) = (out.join("thesis_systems.csv"), out.join("thesis.json"));
        let mut earlier = table();
        earlier.parts = vec![Part::of(&earlier.machine)];
        write_json(&earlier, &json).unwrap();
        // Without rows it does not matter whose the file is.
        let mut other = table();
        other.repeats = 1;
        other.take_up(out).unwrap();
        assert!(other.parts.is_empty());
        fs::write(&rows, "").unwrap();
        let mut later = table();
        later.machine.host.measured = "2026-11-23T05:00:00Z".to_owned();
        later.machine.host.load = None;
        later.machine.copy_bandwidth.median = 3e9;
        later.take_up(out).unwrap();
        assert_eq!(later.parts, earlier.parts);

        let refused = |mut table: Table, part: &str| {
            let error = table.take_up(out).unwrap_err();
            let text = error.to_string();
            assert_eq!(error.exit_code(), 2, "{text}");
            for part in [part, "thesis.json", "--resume"] {
                assert!(text.contains(part), "{part}: {text}");
            }
        };
        type Change = (&'static str, fn(&mut Table));
        let changes: [Change; 8] = [
            ("cutwater", |table| table.machine.host.cutwater = "0.0.9"),
            ("sources", |table| table.machine.host.sources = ""),
            ("adapter", |table| table.machine.adapter.push('2')),
            ("driver", |table| table.machine.driver.push('2')),
            ("cpu", |table| table.machine.host.cpu = None),
            ("threads", |table| table.machine.host.threads = 4),
            ("precisions", |table| table.precisions.push("f32")),
            ("repeats", |table| table.repeats = 1),
        ];
        for (key, change) in changes {
            let mut other = table();
            change(&mut other);
            refused(other, &format!("it has {key} "));
        }
        let mut without = serde_json::to_value(&earlier).unwrap();
        without.as_object_mut().unwrap().remove("parts");
        write_json(&without, &json).unwrap();
        refused(table(), "does not say when");
        fs::write(&json, "{").unwrap();
        refused(table(), "cannot be read");
        fs::remove_file(&json).unwrap();
        refused(table(), "thesis_systems.csv");
    }
}
