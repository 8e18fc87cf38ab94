//! Median and spread of repeated timings.

use serde::Serialize;

/// Seconds of repeated runs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Median.
    pub median: f64,
    /// Least.
    pub min: f64,
    /// Largest.
    pub max: f64,
}

impl Spread {
    /// Of at least one value.
    ///
    /// # Panics
    /// Without values.
    pub fn of(mut values: Vec<f64>) -> Spread {
        assert!(!values.is_empty(), "a spread needs values");
        values.sort_by(f64::total_cmp);
        let n = values.len();
        let median = 0.5 * (values[(n - 1) / 2] + values[n / 2]);
        Spread {
            median,
            min: values[0],
            max: values[n - 1],
        }
    }
}

impl Spread {
    /// First quartile, median and third, between values as `numpy.quantile` takes them.
    ///
    /// # Panics
    /// Without values.
    pub fn quartiles(mut values: Vec<f64>) -> [f64; 3] {
        assert!(!values.is_empty(), "quartiles need values");
        values.sort_by(f64::total_cmp);
        [0.25, 0.5, 0.75].map(|share| {
            let at = share * (values.len() - 1) as f64;
            let below = at.floor() as usize;
            let above = at.ceil() as usize;
            values[below] + (at - at.floor()) * (values[above] - values[below])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::Spread;

    #[test]
    fn median_of_odd_and_even_counts() {
        assert_eq!(
            Spread::of(vec![3.0, 1.0, 2.0]),
            Spread {
                median: 2.0,
                min: 1.0,
                max: 3.0
            },
            "odd"
        );
        assert_eq!(Spread::of(vec![4.0, 1.0, 2.0, 3.0]).median, 2.5, "even");
    }

    #[test]
    fn quartiles_lie_between_values() {
        assert_eq!(
            Spread::quartiles(vec![4.0, 1.0, 2.0, 3.0]),
            [1.75, 2.5, 3.25]
        );
        assert_eq!(Spread::quartiles(vec![2.0]), [2.0; 3]);
    }
}
