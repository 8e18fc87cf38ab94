//! Statistics of the probes of a run: extremes with their times, time averages, last values.

use std::path::Path;

use crate::Error;
use crate::output::plot::Run;

/// Statistics of a column of probes.csv, in its unit: the numbers of [`NAMES`].
pub type Statistics = [f64; 6];

/// Least and largest value with their times (s); mean over time, for which each value counts with the length of its sub-step; value after the last
/// sub-step. The names are endings of columns, after the column of the probe and a colon, which no name of a probe has.
pub const NAMES: [&str; 6] = ["least", "least_t", "largest", "largest_t", "mean", "last"];

/// Statistics of values after sub-steps that end at these times, s, the first of which begins at 0. Sub-steps without a
/// value do not count; `None` without any value.
pub fn statistics(times: &[f64], values: &[Option<f64>]) -> Option<Statistics> {
    let starts = std::iter::once(&0.0).chain(times);
    let steps = starts.zip(times).zip(values);
    // Value, end and length of each sub-step.
    let steps: Vec<[f64; 3]> = steps.filter_map(|((start, &t), value)| Some([(*value)?, t, t - start])).collect();
    let (&first, &[last, ..]) = (steps.first()?, steps.last()?);
    let least = steps.iter().fold(first, |least, step| if step[0] < least[0] { *step } else { least });
    let largest = steps.iter().fold(first, |largest, step| if step[0] > largest[0] { *step } else { largest });
    let span: f64 = steps.iter().map(|[.., dt]| dt).sum();
    let integral: f64 = steps.iter().map(|[value, _, dt]| dt * value).sum();
    let mean = if span > 0.0 { integral / span } else { first[0] };
    Some([least[0], least[1], largest[0], largest[1], mean, last])
}

/// Columns of a run's probes.csv with their statistics.
///
/// # Errors
/// [`Error::Input`] for a broken table.
pub fn read(run: &Path) -> Result<Vec<(String, Statistics)>, Error> {
    let path = run.join("probes.csv");
    if !path.is_file() {
        return Ok(Vec::new());
    }
    let Run { times, columns, .. } = Run::read(&path, String::new())?;
    let probes = columns.into_iter().filter(|(name, _)| name != "step" && name != "t");
    Ok(probes.filter_map(|(name, values)| Some((name, statistics(&times, &values)?))).collect())
}
