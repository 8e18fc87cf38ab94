//! steps.csv and probes.csv: a row per sub-step, with all digits of every number.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use crate::Error;
use crate::scene::Probe;
use crate::state::{CouplingReport, Exchange, LiquidReport, SeparationReport, SolidReport, StepReport};

/// A CSV file of rows, flushed once per frame.
#[derive(Debug)]
struct Table {
    path: PathBuf,
    writer: csv::Writer<File>,
}

impl Table {
    fn create(path: PathBuf) -> Result<Table, Error> {
        let file = File::create(&path).map_err(|problem| Error::unwritten(&path, &problem))?;
        Ok(Table { path, writer: csv::Writer::from_writer(file) })
    }

    /// Opens a table and truncates it to its first `bytes`. Also returns its columns, if it has any.
    fn resume(path: PathBuf, bytes: u64) -> Result<(Table, Option<Vec<String>>), Error> {
        let unreadable = |problem: String| {
            let cure = "restore the table of the run, or start again with --overwrite";
            Error::input(path.display().to_string(), problem, cure)
        };
        let mut file =
            OpenOptions::new().read(true).write(true).open(&path).map_err(|problem| unreadable(problem.to_string()))?;
        let mut head = None;
        if bytes > 0 {
            let mut last = [0];
            file.seek(SeekFrom::Start(bytes - 1))
                .and_then(|_| file.read_exact(&mut last))
                .and_then(|()| file.rewind())
                .map_err(|_| unreadable(format!("is shorter than its former {bytes} bytes")))?;
            if last != *b"\n" {
                return Err(unreadable(format!("has no row that ends at byte {bytes}")));
            }
            let mut reader = csv::Reader::from_reader(&file);
            let columns = reader.headers().map_err(|problem| unreadable(problem.to_string()))?;
            head = Some(columns.iter().map(str::to_owned).collect());
        }
        file.set_len(bytes)
            .and_then(|()| file.seek(SeekFrom::End(0)))
            .map_err(|problem| Error::unwritten(&path, &problem))?;
        let writer = csv::Writer::from_writer(file);
        Ok((Table { path, writer }, head))
    }

    fn record(&mut self, fields: impl IntoIterator<Item = String>) -> Result<(), Error> {
        self.writer.write_record(fields).map_err(|problem| match problem.into_kind() {
            csv::ErrorKind::Io(problem) => Error::unwritten(&self.path, &problem),
            problem => Error::output(&self.path, format!("{problem:?}")),
        })
    }

    fn flush(&mut self) -> Result<(), Error> {
        self.with_writer(|writer| writer.flush())
    }

    /// Flushes all rows, with `sync` to disk. Returns the length of the file, bytes.
    fn bytes(&mut self, sync: bool) -> Result<u64, Error> {
        self.flush()?;
        self.with_writer(|writer| {
            if sync {
                writer.get_ref().sync_data()?;
            }
            writer.get_ref().stream_position()
        })
    }

    fn with_writer<T>(&mut self, act: impl FnOnce(&mut csv::Writer<File>) -> io::Result<T>) -> Result<T, Error> {
        act(&mut self.writer).map_err(|problem| Error::unwritten(&self.path, &problem))
    }
}

/// The shortest text that reads back as the same f64; an error if it is not finite.
fn number(column: &str, step: u64, value: f64) -> Result<String, Error> {
    if value.is_finite() {
        Ok(format!("{value:?}"))
    } else {
        Err(Error::Stage { stage: "diagnose", step, problem: format!("{column} is {value:?}") })
    }
}

/// A row of steps.csv.
#[derive(Clone, Copy, Debug)]
pub struct StepRow<'a> {
    /// Number of the sub-step, from 0.
    pub step: u64,
    /// Time at the end of the sub-step, s.
    pub time: f64,
    /// Diagnostics.
    pub report: &'a StepReport,
    /// Liquid volume over target volume, in scenes with liquid.
    pub volume_ratio: Option<f64>,
}

impl StepRow<'_> {
    /// The columns of the row without those of the stages: see [`StepTable::columns`].
    pub fn columns(&self) -> Vec<&'static str> {
        let report = self.report;
        let has = |part: fn(&LiquidReport) -> bool| report.liquid.as_ref().is_some_and(part);
        let parts = [
            report.liquid.is_some(),
            has(|liquid| liquid.exchange.is_some()),
            has(|liquid| liquid.separation.is_some()),
            report.solid.is_some(),
        ];
        StepTable::columns(parts).collect()
    }

    /// The values of the columns as texts.
    ///
    /// # Errors
    /// [`Error::Stage`] for a number that is not finite.
    pub fn fields(&self) -> Result<Vec<String>, Error> {
        let StepRow { step, time, report, volume_ratio } = *self;
        let mut fields = vec![step.to_string(), number("t", step, time)?, number("dt", step, report.dt)?];
        if let (Some(liquid), Some(volume_ratio)) = (&report.liquid, volume_ratio) {
            fields.extend(liquid_fields(step, liquid, volume_ratio)?);
        }
        if let Some(solid) = &report.solid {
            fields.extend(solid_fields(step, solid)?);
        }
        if let Some(coupling) = &report.coupling {
            fields.extend(coupling_fields(step, coupling)?);
        }
        fields.push(number("wave_cfl", step, report.wave_cfl)?);
        fields.push(u8::from(report.dt_floored).to_string());
        fields.push(number("seconds_total", step, report.seconds_total)?);
        Ok(fields)
    }
}

/// steps.csv. Columns: [`StepTable::columns`], then `seconds_STAGE` of each stage of the first row.
#[derive(Debug)]
pub struct StepTable {
    table: Table,
    head: Option<Vec<String>>,
}

const FIRST: [&str; 3] = ["step", "t", "dt"];
/// Columns of every row before those of the stages.
const LAST: [&str; 3] = ["wave_cfl", "dt_floored", "seconds_total"];
/// Prefix of the columns of stages.
const SECONDS: &str = "seconds_";
const LIQUID: [&str; 16] = [
    "iterations",
    "residual_p",
    "status",
    "unknowns",
    "divergence",
    "volume",
    "volume_ratio",
    "momentum_x",
    "momentum_y",
    "momentum_z",
    "kinetic_energy",
    "potential_energy",
    "max_speed",
    "markers",
    "markers_dropped",
    "closed_components",
];
/// Columns of inflow and outflow.
const EXCHANGE: [&str; 6] =
    ["markers_left", "volume_left", "markers_sunk", "volume_sunk", "markers_emitted", "volume_emitted"];
/// Columns of separation.
const SEPARATION: [&str; 5] =
    ["separated_cells", "returned_cells", "separation_rounds", "least_pressure", "opened_volume"];
const SOLIDS: [&str; 19] = [
    "solid_solves",
    "unsettled_contacts",
    "contact_halvings",
    "solid_iterations",
    "residual_v",
    "solid_status",
    "solid_unknowns",
    "solid_momentum_x",
    "solid_momentum_y",
    "solid_momentum_z",
    "solid_angular_momentum_x",
    "solid_angular_momentum_y",
    "solid_angular_momentum_z",
    "solid_kinetic_energy",
    "solid_elastic_energy",
    "solid_potential_energy",
    "solid_max_speed",
    "min_det_f",
    "inverted",
];

const COUPLING: [&str; 10] = [
    "touching",
    "condensed",
    "force_x",
    "force_y",
    "force_z",
    "correction_x",
    "correction_y",
    "correction_z",
    "overlap_cells",
    "overlap_depth",
];

impl StepTable {
    /// The columns of a scene with or without liquid, inflow or outflow, separation, and solids.
    ///
    /// Units: s, relative true residual (f64), 1/s, m^3, kg m/s, kg m^2/s (about the origin), J, m/s, N (forces of the
    /// liquid on the solids), m. `markers_dropped`, and the markers and volumes (m^3) that left, sank or were emitted, are
    /// counts of this sub-step. `dt_floored`, `touching` and `condensed` are 0 or 1. A `status` is `converged` or the
    /// failure. `inverted` counts elements.
    pub fn columns([liquid, exchange, separation, solids]: [bool; 4]) -> impl Iterator<Item = &'static str> {
        let parts: [(bool, &[&str]); 7] = [
            (true, &FIRST),
            (liquid, &LIQUID),
            (exchange, &EXCHANGE),
            (separation, &SEPARATION),
            (solids, &SOLIDS),
            (liquid && solids, &COUPLING),
            (true, &LAST),
        ];
        let present = parts.into_iter().filter(|(present, _)| *present);
        present.flat_map(|(_, columns)| columns.iter().copied())
    }

    /// Creates steps.csv in `run`; the first row determines the header.
    pub fn create(run: &Path) -> Result<StepTable, Error> {
        Ok(StepTable { table: Table::create(run.join("steps.csv"))?, head: None })
    }

    /// Resumes steps.csv, truncated to its first `bytes`; an error if no row ends there.
    pub fn resume(run: &Path, bytes: u64) -> Result<StepTable, Error> {
        let (table, head) = Table::resume(run.join("steps.csv"), bytes)?;
        Ok(StepTable { table, head })
    }

    /// Appends a row; nonfinite numbers are errors.
    ///
    /// All rows have the same parts. Stages may differ, since a run may resume on another adapter: stages missing in the
    /// header are omitted, and stages missing in the row have an empty cell.
    pub fn push(&mut self, row: &StepRow) -> Result<(), Error> {
        let StepRow { step, report, .. } = *row;
        let columns = row.columns();
        let head = match &mut self.head {
            Some(head) => head,
            None => {
                let stages = report.seconds.iter();
                let stages = stages.map(|(stage, _)| format!("{SECONDS}{stage}"));
                let columns = columns.iter().map(|column| (*column).to_owned());
                let head: Vec<String> = columns.chain(stages).collect();
                self.table.record(head.iter().cloned())?;
                self.head.insert(head)
            }
        };
        let (before, timed) = head.split_at(columns.len().min(head.len()));
        if before != columns {
            let problem = format!("step {step} has the columns {columns:?}, the first {head:?}");
            return Err(Error::output(&self.table.path, problem));
        }
        let mut fields = row.fields()?;
        for column in timed {
            let name = column.strip_prefix(SECONDS);
            let mut stages = report.seconds.iter();
            fields.push(match stages.find(|(stage, _)| name == Some(*stage)) {
                Some(&(stage, seconds)) => number(stage, step, seconds)?,
                None => String::new(),
            });
        }
        self.table.record(fields)
    }

    /// Flushes all rows; once per frame.
    pub fn flush(&mut self) -> Result<(), Error> {
        self.table.flush()
    }

    /// Flushes all rows, with `sync` to disk. Returns the length of the file, bytes.
    pub fn bytes(&mut self, sync: bool) -> Result<u64, Error> {
        self.table.bytes(sync)
    }
}

fn liquid_fields(step: u64, liquid: &LiquidReport, volume_ratio: f64) -> Result<Vec<String>, Error> {
    let LiquidReport { solve, diagnosis, .. } = liquid;
    let real = |column: &str, value: f64| number(column, step, value);
    let mut fields = vec![
        solve.iterations.to_string(),
        real("residual_p", solve.residual)?,
        solve.status.name().to_owned(),
        solve.unknowns.to_string(),
        real("divergence", diagnosis.divergence)?,
        real("volume", diagnosis.volume)?,
        real("volume_ratio", volume_ratio)?,
        real("momentum_x", diagnosis.momentum[0])?,
        real("momentum_y", diagnosis.momentum[1])?,
        real("momentum_z", diagnosis.momentum[2])?,
        real("kinetic_energy", diagnosis.kinetic_energy)?,
        real("potential_energy", diagnosis.potential_energy)?,
        real("max_speed", diagnosis.max_speed)?,
        liquid.markers.to_string(),
        liquid.dropped.to_string(),
        liquid.closed_components.to_string(),
    ];
    if let Some(exchange) = liquid.exchange {
        let Exchange { left, sunk, emitted, volume_left, volume_sunk, volume_emitted } = exchange;
        for (markers, volume, column) in [
            (left, volume_left, "volume_left"),
            (sunk, volume_sunk, "volume_sunk"),
            (emitted, volume_emitted, "volume_emitted"),
        ] {
            fields.push(markers.to_string());
            fields.push(real(column, volume)?);
        }
    }
    if let Some(separation) = liquid.separation {
        let SeparationReport { cells, returned, rounds, least_pressure, opened } = separation;
        fields.extend([
            cells.to_string(),
            returned.to_string(),
            rounds.to_string(),
            real("least_pressure", least_pressure)?,
            real("opened_volume", opened)?,
        ]);
    }
    Ok(fields)
}

fn solid_fields(step: u64, solid: &SolidReport) -> Result<Vec<String>, Error> {
    let SolidReport { solve, contact, diagnosis } = solid;
    let real = |column: &str, value: f64| number(column, step, value);
    Ok(vec![
        contact.solves.to_string(),
        contact.unsettled.to_string(),
        contact.next_halvings.unwrap_or_default().to_string(),
        solve.iterations.to_string(),
        real("residual_v", solve.residual)?,
        solve.status.name().to_owned(),
        solve.unknowns.to_string(),
        real("solid_momentum_x", diagnosis.momentum[0])?,
        real("solid_momentum_y", diagnosis.momentum[1])?,
        real("solid_momentum_z", diagnosis.momentum[2])?,
        real("solid_angular_momentum_x", diagnosis.angular_momentum[0])?,
        real("solid_angular_momentum_y", diagnosis.angular_momentum[1])?,
        real("solid_angular_momentum_z", diagnosis.angular_momentum[2])?,
        real("solid_kinetic_energy", diagnosis.kinetic_energy)?,
        real("solid_elastic_energy", diagnosis.elastic_energy)?,
        real("solid_potential_energy", diagnosis.potential_energy)?,
        real("solid_max_speed", diagnosis.max_speed)?,
        real("min_det_f", diagnosis.min_det)?,
        diagnosis.inverted.to_string(),
    ])
}

fn coupling_fields(step: u64, coupling: &CouplingReport) -> Result<Vec<String>, Error> {
    let CouplingReport { touching, condensed, force, correction, overlap_cells, overlap_depth } = *coupling;
    let mut fields = [touching, condensed].map(|is| u8::from(is).to_string()).to_vec();
    let forces = force.into_iter().chain(correction);
    for (column, value) in COUPLING[2..].iter().zip(forces) {
        fields.push(number(column, step, value)?);
    }
    fields.push(overlap_cells.to_string());
    fields.push(number("overlap_depth", step, overlap_depth)?);
    Ok(fields)
}

/// probes.csv with the columns `step`, `t` (s) and the [`Probe::columns`] of each probe.
#[derive(Debug)]
pub struct ProbeTable {
    table: Table,
    columns: Vec<String>,
}

impl ProbeTable {
    /// Creates probes.csv in `run` with its header.
    pub fn create(run: &Path, probes: &[Probe]) -> Result<ProbeTable, Error> {
        let columns: Vec<String> = probes.iter().flat_map(Probe::columns).collect();
        let mut table = Table::create(run.join("probes.csv"))?;
        let first = ["step", "t"].map(str::to_owned);
        table.record(first.into_iter().chain(columns.iter().cloned()))?;
        Ok(ProbeTable { table, columns })
    }

    /// Resumes probes.csv, truncated to its first `bytes`; an error if no row ends there or the columns differ.
    pub fn resume(run: &Path, probes: &[Probe], bytes: u64) -> Result<ProbeTable, Error> {
        let columns: Vec<String> = probes.iter().flat_map(Probe::columns).collect();
        let (table, head) = Table::resume(run.join("probes.csv"), bytes)?;
        let present = head.as_ref().and_then(|head| head.get(2..));
        if present != Some(&columns[..]) {
            return Err(Error::input(
                table.path.display().to_string(),
                "does not have the columns of the scene's probes",
                "restore the table of the run, or start again with --overwrite",
            ));
        }
        Ok(ProbeTable { table, columns })
    }

    /// Appends the values of all columns after a sub-step, numbered from 0, at a time (s).
    pub fn push(&mut self, step: u64, time: f64, values: &[f64]) -> Result<(), Error> {
        assert_eq!(values.len(), self.columns.len(), "one value for each column of probes.csv");
        let mut fields = vec![step.to_string(), number("t", step, time)?];
        for (column, &value) in self.columns.iter().zip(values) {
            fields.push(number(&format!("probe {column}"), step, value)?);
        }
        self.table.record(fields)
    }

    /// Flushes all rows; once per frame.
    pub fn flush(&mut self) -> Result<(), Error> {
        self.table.flush()
    }

    /// Flushes all rows, with `sync` to disk. Returns the length of the file, bytes.
    pub fn bytes(&mut self, sync: bool) -> Result<u64, Error> {
        self.table.bytes(sync)
    }
}
