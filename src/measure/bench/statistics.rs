//! Median and spread of repeated values, exponents of growth, rows by groups.

use serde::Serialize;

/// Median, least and largest of repeated values.
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
    /// Spread of at least one value.
    ///
    /// # Panics
    /// Without values.
    pub fn of(mut values: Vec<f64>) -> Spread {
        assert!(!values.is_empty(), "a spread needs values");
        values.sort_by(f64::total_cmp);
        let n = values.len();
        Spread { median: 0.5 * (values[(n - 1) / 2] + values[n / 2]), min: values[0], max: values[n - 1] }
    }

    /// Spread of a value without repeats.
    pub fn exact(value: f64) -> Spread {
        Spread::of(vec![value])
    }

    /// First quartile, median and third, interpolated as `numpy.quantile` does.
    ///
    /// # Panics
    /// Without values.
    pub fn quartiles(mut values: Vec<f64>) -> [f64; 3] {
        assert!(!values.is_empty(), "quartiles need values");
        values.sort_by(f64::total_cmp);
        [0.25, 0.5, 0.75].map(|share| {
            let at = share * (values.len() - 1) as f64;
            let [below, above] = [at.floor(), at.ceil()].map(|at| values[at as usize]);
            below + at.fract() * (above - below)
        })
    }
}

/// Exponent e of y ~ x^e through points, by least squares of the logarithms. `None` where all x are equal, or a coordinate is not above 0.
pub fn exponent(points: impl IntoIterator<Item = (f64, f64)>) -> Option<f64> {
    let points: Vec<[f64; 2]> = points.into_iter().map(|(x, y)| [x.ln(), y.ln()]).collect();
    let same = points.iter().all(|point| point[0] == points[0][0]);
    if same || !points.as_flattened().iter().all(|ln| ln.is_finite()) {
        return None;
    }
    let n = points.len() as f64;
    let means = [0, 1].map(|axis| points.iter().map(|point| point[axis]).sum::<f64>() / n);
    let offsets = points.iter().map(|[x, y]| [x - means[0], y - means[1]]);
    let [both, square] = offsets.fold([0.0; 2], |[both, square], [x, y]| [both + x * y, square + x * x]);
    Some(both / square)
}

/// Exponents of a power law through points (x, spread of y): through all medians; through the medians at the two largest x, where fixed costs count
/// least; the least and the largest through values within the spreads. `None` where [`exponent`] has none.
pub fn exponents(points: &[(f64, Spread)]) -> Option<[f64; 4]> {
    let through = |value: &dyn Fn(f64, Spread) -> f64| exponent(points.iter().map(|&(x, y)| (x, value(x, y))));
    let mut sizes: Vec<f64> = points.iter().map(|point| point.0).collect();
    sizes.sort_by(f64::total_cmp);
    sizes.dedup();
    let before = *sizes.get(sizes.len().checked_sub(2)?)?;
    let last = points.iter().filter(|point| point.0 >= before);
    // The slope is a sum of the logarithms with weights that have the sign of x less its mean.
    let middle = points.iter().map(|point| point.0.ln()).sum::<f64>() / points.len() as f64;
    Some([
        through(&|_, y| y.median)?,
        exponent(last.map(|&(x, y)| (x, y.median)))?,
        through(&|x, y| if x.ln() > middle { y.min } else { y.max })?,
        through(&|x, y| if x.ln() > middle { y.max } else { y.min })?,
    ])
}

/// Items by key, in the order of first appearance; those without a key are left out.
pub fn grouped<T: Copy, K: PartialEq>(
    items: impl IntoIterator<Item = T>,
    key: impl Fn(T) -> Option<K>,
) -> Vec<(K, Vec<T>)> {
    let mut groups: Vec<(K, Vec<T>)> = Vec::new();
    for item in items {
        let Some(key) = key(item) else { continue };
        match groups.iter_mut().find(|(known, _)| *known == key) {
            Some((_, members)) => members.push(item),
            None => groups.push((key, vec![item])),
        }
    }
    groups
}
