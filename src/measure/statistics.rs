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
    /// Of what has none.
    pub fn exact(value: f64) -> Spread {
        Spread {
            median: value,
            min: value,
            max: value,
        }
    }

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

/// The exponent of a power law y ~ x^e through points, by least squares of the logarithms; none where all x are the same, or a number has no
/// finite logarithm: where it is not above 0.
pub fn exponent(points: impl IntoIterator<Item = (f64, f64)>) -> Option<f64> {
    let points = points.into_iter();
    let points: Vec<[f64; 2]> = points.map(|(x, y)| [x.ln(), y.ln()]).collect();
    let same = points.iter().all(|point| point[0] == points[0][0]);
    if same || !points.as_flattened().iter().all(|ln| ln.is_finite()) {
        return None;
    }
    let n = points.len() as f64;
    let middle = [0, 1].map(|axis| points.iter().map(|point| point[axis]).sum::<f64>() / n);
    let offsets = points.iter().map(|[x, y]| [x - middle[0], y - middle[1]]);
    let [both, square] = offsets.fold([0.0; 2], |[both, square], [x, y]| {
        [both + x * y, square + x * x]
    });
    Some(both / square)
}

#[cfg(test)]
mod tests {
    use super::{Spread, exponent};

    #[test]
    fn the_exponent_of_a_power_is_found() {
        let points = [1.0_f64, 3.0, 10.0].map(|x| (x, 5.0 * x.powf(1.5)));
        assert!((exponent(points).unwrap() - 1.5).abs() < 1e-12);
        assert_eq!(exponent([(2.0, 1.0), (2.0, 4.0)]), None);
        assert_eq!(exponent([]), None);
    }

    #[test]
    fn what_has_no_exponent_gets_none() {
        // Whether or not their mean is what they are.
        for x in [0.1, 3.0, 7.0, 4401.0, 281_721.0] {
            for n in 1..8_u32 {
                let points = (0..n).map(|k| (x, 1.0 + f64::from(k)));
                assert_eq!(exponent(points), None, "{n} times {x}");
            }
        }
        for none in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(exponent([(1.0, none), (2.0, 4.0)]), None, "{none}");
            assert_eq!(exponent([(none, 1.0), (2.0, 4.0)]), None, "{none}");
        }
    }

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
