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

/// What exponents of a power law come of points with spreads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exponents {
    /// Through all medians.
    pub fit: f64,
    /// Through the medians at the two largest x: what is fixed tells less there.
    pub last: f64,
    /// Least fit through values within the spreads.
    pub low: f64,
    /// Largest.
    pub high: f64,
}

impl Exponents {
    /// Of x and spreads of y; none where [`exponent`] has none.
    pub fn of(points: &[(f64, Spread)]) -> Option<Exponents> {
        let through = |value: &dyn Fn(f64, Spread) -> f64| {
            exponent(points.iter().map(|&(x, y)| (x, value(x, y))))
        };
        let mut sizes: Vec<f64> = points.iter().map(|point| point.0).collect();
        sizes.sort_by(f64::total_cmp);
        sizes.dedup();
        let before = *sizes.get(sizes.len().checked_sub(2)?)?;
        let last = points.iter().filter(|point| point.0 >= before);
        // The slope is a sum of the logarithms with weights that have the sign of what x is beyond the middle.
        let middle = points.iter().map(|point| point.0.ln()).sum::<f64>() / points.len() as f64;
        Some(Exponents {
            fit: through(&|_, y| y.median)?,
            last: exponent(last.map(|&(x, y)| (x, y.median)))?,
            low: through(&|x, y| if x.ln() > middle { y.min } else { y.max })?,
            high: through(&|x, y| if x.ln() > middle { y.max } else { y.min })?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::{Exponents, Spread, exponent};

    #[test]
    fn exponents_have_a_range_and_a_last_pair() {
        // A launch of 1 s beside a second per unit.
        let point = |x: f64| {
            let y = 1.0 + x;
            let (min, max) = (0.9 * y, 1.2 * y);
            let spread = Spread {
                median: y,
                min,
                max,
            };
            (x, spread)
        };
        let points = [10.0, 1.0, 100.0].map(point);
        let found = Exponents::of(&points).unwrap();
        assert!((found.last - (101.0_f64 / 11.0).log10()).abs() < 1e-12);
        assert!(found.low < found.fit && found.fit < found.high && found.fit < found.last);
        // Of three points a decade apart the slope is half that between the ends; what lies in the middle has no weight.
        let ends = |low: f64, high: f64| 0.5 * (high * 101.0 / (low * 2.0)).log10();
        assert!((found.low - ends(1.2, 0.9)).abs() < 1e-12, "{found:?}");
        assert!((found.high - ends(0.9, 1.2)).abs() < 1e-12, "{found:?}");
        let exact = Exponents::of(&[(2.0, Spread::exact(3.0)), (4.0, Spread::exact(6.0))]);
        let exact = exact.unwrap();
        for exponent in [exact.fit, exact.last, exact.low, exact.high] {
            assert!((exponent - 1.0).abs() < 1e-12, "{exact:?}");
        }
        assert_eq!(Exponents::of(&[point(2.0), point(2.0)]), None);
        assert_eq!(Exponents::of(&[]), None);
    }

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
