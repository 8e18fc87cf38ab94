//! Pairs of sub-steps from the same state, and the significance of their differences.
//!
//! The sign test assumes no distribution of the seconds. The ends of an interval are order statistics of the differences. The probability that it
//! misses the true median is binomial (Conover, Practical Nonparametric Statistics, sections 3.2 and 3.4).

use super::super::statistics::Spread;

/// More seconds with the effect.
pub const ADDS: &str = "adds";
/// Fewer seconds with the effect.
const SAVES: &str = "saves";
/// A difference as between two paths of the same scene.
pub const NOTHING: &str = "not told apart from nothing";
/// No interval.
const TOO_FEW: &str = "too few pairs";
/// Largest probability that an interval misses the median.
const MISS: f64 = 0.05;

/// Cost of a sub-step.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cost {
    /// Wall-clock seconds.
    pub seconds: f64,
    /// Dispatches outside the solve.
    pub dispatches: usize,
    /// Dispatches in the solve.
    pub solve_dispatches: usize,
}

/// Two sub-steps from the same state: with an effect, and without.
pub type Pair = [Cost; 2];

/// Pair of the scene and two parts of it, from a pair with each part: the mean of the scene's costs, and the sum of the parts' costs.
pub fn against_both([with, a]: Pair, [again, b]: Pair) -> Pair {
    let whole = Cost { seconds: 0.5 * (with.seconds + again.seconds), ..with };
    let parts = Cost {
        seconds: a.seconds + b.seconds,
        dispatches: a.dispatches + b.dispatches,
        solve_dispatches: a.solve_dispatches + b.solve_dispatches,
    };
    [whole, parts]
}

/// Seconds that the effect adds in each pair.
pub fn added(pairs: &[Pair]) -> Vec<f64> {
    pairs.iter().map(|[with, without]| with.seconds - without.seconds).collect()
}

/// Median seconds with the effect (0) or without (1).
pub(super) fn median(pairs: &[Pair], side: usize) -> f64 {
    Spread::of(pairs.iter().map(|pair| pair[side].seconds).collect()).median
}

/// Median of the differences of a count; for an even number of pairs the lower of the two in the middle.
pub fn middle(pairs: &[Pair], count: impl Fn(&Cost) -> usize) -> i64 {
    let mut added: Vec<i64> = pairs.iter().map(|[with, without]| count(with) as i64 - count(without) as i64).collect();
    added.sort_unstable();
    added[(added.len() - 1) / 2]
}

/// Number of pairs with different dispatches outside the solve.
pub fn differing(pairs: &[Pair]) -> usize {
    pairs.iter().filter(|[with, without]| with.dispatches != without.dispatches).count()
}

/// Probability of at most `k` heads in `n` tosses of a coin.
pub fn at_most(k: usize, n: usize) -> f64 {
    // Logarithms, as 2^-n underflows for large n.
    let (mut ln_ways, mut chance) = (0.0, 0.0);
    for heads in 0..=k.min(n) {
        chance += f64::exp(ln_ways - n as f64 * std::f64::consts::LN_2);
        ln_ways += f64::ln((n - heads) as f64 / (heads + 1) as f64);
    }
    chance
}

/// Narrowest symmetric pair of ordered values that contains the true median with a probability of at least 95 %; `None` below six values.
pub fn interval(mut values: Vec<f64>) -> Option<[f64; 2]> {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    let k = (0..n / 2).take_while(|&k| 2.0 * at_most(k, n) <= MISS).last()?;
    Some([values[k], values[n - 1 - k]])
}

/// Difference in seconds of a scene from itself: the larger magnitude of the ends of the interval.
pub(super) fn noise(itself: &[Pair]) -> Option<f64> {
    let [low, high] = interval(added(itself))?;
    Some(low.abs().max(high.abs()))
}

/// Verdict on an interval around a median, given the difference of a scene from itself.
pub fn verdict(interval: Option<[f64; 2]>, median: f64, noise: Option<f64>) -> &'static str {
    let (Some([low, high]), Some(noise)) = (interval, noise) else { return TOO_FEW };
    match median {
        _ if (low <= 0.0 && high >= 0.0) || median.abs() <= noise => NOTHING,
        _ if median > 0.0 => ADDS,
        _ => SAVES,
    }
}
