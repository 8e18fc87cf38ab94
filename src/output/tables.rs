//! steps.csv and probes.csv: a row per sub-step, every number with all digits it needs to be read back exactly.

use std::fs::File;
use std::path::{Path, PathBuf};

use crate::Error;
use crate::scene::Probe;
use crate::state::{Diagnosis, LiquidReport, StepReport};

/// A CSV file that grows by rows and is flushed once per frame.
#[derive(Debug)]
struct Table {
    path: PathBuf,
    writer: csv::Writer<File>,
}

impl Table {
    fn create(path: PathBuf) -> Result<Table, Error> {
        let file = File::create(&path).map_err(|problem| Error::output(&path, problem))?;
        Ok(Table {
            path,
            writer: csv::Writer::from_writer(file),
        })
    }

    fn record(&mut self, fields: impl IntoIterator<Item = String>) -> Result<(), Error> {
        self.writer
            .write_record(fields)
            .map_err(|problem| Error::output(&self.path, problem))
    }

    fn flush(&mut self) -> Result<(), Error> {
        self.writer
            .flush()
            .map_err(|problem| Error::output(&self.path, problem))
    }
}

/// The shortest text that reads back as the same f64, or the error that names the column.
fn number(column: &str, step: u64, value: f64) -> Result<String, Error> {
    if value.is_finite() {
        Ok(format!("{value:?}"))
    } else {
        Err(Error::Stage {
            stage: "diagnose",
            step,
            problem: format!("{column} is {value:?}"),
        })
    }
}

/// A row of steps.csv.
#[derive(Clone, Copy, Debug)]
pub struct StepRow<'a> {
    /// Number of the sub-step, from 0.
    pub step: u64,
    /// Time at its end, s.
    pub time: f64,
    /// What it did.
    pub report: &'a StepReport,
    /// Liquid volume over the volume to hold, where there is liquid.
    pub volume_ratio: Option<f64>,
}

/// steps.csv. Columns: [`StepTable::COLUMNS`], then `seconds_STAGE` of each stage of the first row.
#[derive(Debug)]
pub struct StepTable {
    table: Table,
    stages: Option<Vec<&'static str>>,
}

impl StepTable {
    /// Units: s, relative residual (f64, true), 1/s, m^3, kg m/s, J, m/s; `markers_dropped` in this sub-step;
    /// `dt_floored` is 0 or 1; `status` of the solve is `converged` or what went wrong. Of a liquid that is not there, nothing.
    pub const COLUMNS: [&'static str; 21] = [
        "step",
        "t",
        "dt",
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
        "dt_floored",
        "seconds_total",
    ];

    /// A new steps.csv in `run`; the head line comes with the first row, which tells the stages.
    pub fn create(run: &Path) -> Result<StepTable, Error> {
        Ok(StepTable {
            table: Table::create(run.join("steps.csv"))?,
            stages: None,
        })
    }

    /// Appends a row. Every row must time the same stages; a number that is not finite is an error.
    pub fn push(&mut self, row: &StepRow) -> Result<(), Error> {
        let StepRow {
            step,
            time,
            report,
            volume_ratio,
        } = *row;
        let stages: Vec<&'static str> = report.seconds.iter().map(|&(stage, _)| stage).collect();
        match &self.stages {
            None => {
                let head = Self::COLUMNS.map(str::to_owned);
                self.table.record(
                    head.into_iter()
                        .chain(stages.iter().map(|stage| format!("seconds_{stage}"))),
                )?;
                self.stages = Some(stages);
            }
            Some(first) if *first != stages => {
                let problem =
                    format!("step {step} timed the stages {stages:?}, the first step {first:?}");
                return Err(Error::output(&self.table.path, problem));
            }
            Some(_) => {}
        }
        let real = |column: &str, value: f64| number(column, step, value);
        // A column of what the scene does not have stays empty.
        let liquid = report.liquid;
        let text = |of: fn(LiquidReport) -> String| liquid.map_or(String::new(), of);
        let diagnosis = liquid.map(|liquid| liquid.diagnosis);
        let known = |column: &str, value: Option<f64>| {
            value.map_or(Ok(String::new()), |value| number(column, step, value))
        };
        let diagnosed = |column: &str, of: fn(Diagnosis) -> f64| known(column, diagnosis.map(of));
        let mut fields = vec![
            step.to_string(),
            real("t", time)?,
            real("dt", report.dt)?,
            text(|liquid| liquid.solve.iterations.to_string()),
            known("residual_p", liquid.map(|liquid| liquid.solve.residual))?,
            text(|liquid| liquid.solve.status.name().to_owned()),
            text(|liquid| liquid.solve.unknowns.to_string()),
            diagnosed("divergence", |liquid| liquid.divergence)?,
            diagnosed("volume", |liquid| liquid.volume)?,
            known("volume_ratio", volume_ratio)?,
            diagnosed("momentum_x", |liquid| liquid.momentum[0])?,
            diagnosed("momentum_y", |liquid| liquid.momentum[1])?,
            diagnosed("momentum_z", |liquid| liquid.momentum[2])?,
            diagnosed("kinetic_energy", |liquid| liquid.kinetic_energy)?,
            diagnosed("potential_energy", |liquid| liquid.potential_energy)?,
            diagnosed("max_speed", |liquid| liquid.max_speed)?,
            text(|liquid| liquid.markers.to_string()),
            text(|liquid| liquid.dropped.to_string()),
            text(|liquid| liquid.closed_components.to_string()),
            u8::from(report.dt_floored).to_string(),
            real(
                "seconds_total",
                report.seconds.iter().map(|&(_, seconds)| seconds).sum(),
            )?,
        ];
        for &(stage, seconds) in &report.seconds {
            fields.push(number(stage, step, seconds)?);
        }
        self.table.record(fields)
    }

    /// Brings all rows to the file; once per frame.
    pub fn flush(&mut self) -> Result<(), Error> {
        self.table.flush()
    }
}

/// probes.csv. Columns: `t` (s), then the [`Probe::columns`] of each probe.
#[derive(Debug)]
pub struct ProbeTable {
    table: Table,
    columns: Vec<String>,
}

impl ProbeTable {
    /// A new probes.csv in `run` with its head line.
    pub fn create(run: &Path, probes: &[Probe]) -> Result<ProbeTable, Error> {
        let columns: Vec<String> = probes.iter().flat_map(Probe::columns).collect();
        let mut table = Table::create(run.join("probes.csv"))?;
        table.record(std::iter::once("t".to_owned()).chain(columns.iter().cloned()))?;
        Ok(ProbeTable { table, columns })
    }

    /// Appends the values of all columns at a time (s). `step` is for the error where one is not finite.
    pub fn push(&mut self, step: u64, time: f64, values: &[f64]) -> Result<(), Error> {
        assert_eq!(
            values.len(),
            self.columns.len(),
            "one value for each column of probes.csv"
        );
        let mut fields = vec![number("t", step, time)?];
        for (column, &value) in self.columns.iter().zip(values) {
            fields.push(number(&format!("probe {column}"), step, value)?);
        }
        self.table.record(fields)
    }

    /// Brings all rows to the file; once per frame.
    pub fn flush(&mut self) -> Result<(), Error> {
        self.table.flush()
    }
}
