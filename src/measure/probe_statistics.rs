//! Statistics of the probes of a run: extremes with their times, time averages, last values.

use std::path::Path;

use crate::Error;
use crate::output::plot::Run;

/// Statistics of a column of probes.csv, in its unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Statistics {
    /// Least value and its time, s.
    pub least: [f64; 2],
    /// Largest value and its time, s.
    pub largest: [f64; 2],
    /// Mean over time: each value counts with the length of its sub-step.
    pub mean: f64,
    /// Value after the last sub-step.
    pub last: f64,
}

impl Statistics {
    /// Endings of the columns in tables, after the column of the probe and a colon, which no name of a probe has.
    pub const NAMES: [&str; 6] = ["least", "least_t", "largest", "largest_t", "mean", "last"];

    /// The numbers of [`Statistics::NAMES`].
    pub fn numbers(&self) -> [f64; 6] {
        let Statistics { least, largest, mean, last } = *self;
        [least[0], least[1], largest[0], largest[1], mean, last]
    }

    /// Statistics of values after sub-steps that end at these times, s, the first of which begins at 0. Sub-steps without a
    /// value do not count; `None` without any value.
    fn of(times: &[f64], values: &[Option<f64>]) -> Option<Statistics> {
        let mut found: Option<Statistics> = None;
        let (mut sum, mut span, mut before) = (0.0, 0.0, 0.0);
        for (&t, &value) in times.iter().zip(values) {
            let dt = t - before;
            before = t;
            let Some(value) = value else { continue };
            sum += dt * value;
            span += dt;
            let here = Statistics { least: [value, t], largest: [value, t], mean: value, last: value };
            let all = found.get_or_insert(here);
            if value < all.least[0] {
                all.least = here.least;
            }
            if value > all.largest[0] {
                all.largest = here.largest;
            }
            all.last = value;
        }
        let all = found?;
        let mean = if span > 0.0 { sum / span } else { all.mean };
        Some(Statistics { mean, ..all })
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
        let table = Run::read(&path, String::new())?;
        let probes = table.columns.iter().filter(|(name, _)| name != "step" && name != "t");
        let of =
            |(name, values): &(String, Vec<Option<f64>>)| Some((name.clone(), Statistics::of(&table.times, values)?));
        Ok(probes.filter_map(of).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::Statistics;

    #[test]
    fn means_weigh_sub_steps_and_extremes_have_their_times() {
        let times = [1.0, 1.5, 3.5, 4.0];
        let values = [Some(2.0), Some(-4.0), None, Some(6.0)];
        let found = Statistics::of(&times, &values).unwrap();
        // (1 s of 2, 0.5 s of -4, 0.5 s of 6) over 2 s.
        assert_eq!(found.numbers(), [-4.0, 1.5, 6.0, 4.0, 1.5, 6.0]);
        assert_eq!(Statistics::of(&times, &[None; 4]), None);
        // The first of equal extremes.
        let found = Statistics::of(&times, &[Some(1.0); 4]).unwrap();
        assert_eq!(found.numbers(), [1.0, 1.0, 1.0, 1.0, 1.0, 1.0]);
    }
}
