//! Pairs of sub-steps from the same state, and the significance of their differences.
//!
//! No distribution of the seconds is assumed: the ends of an interval are two of the differences, by their order, and the probability that it
//! misses the true median is that of tosses of a coin (sign test; Conover, Practical Nonparametric Statistics, sections 3.2 and 3.4).

use super::super::statistics::Spread;

/// Seconds are more with an effect.
pub const ADDS: &str = "adds";
/// They are less.
const SAVES: &str = "saves";
/// Two paths of one scene differ by as much.
pub const NOTHING: &str = "not told apart from nothing";
/// There is no interval.
const TOO_FEW: &str = "too few pairs";
/// Probability that an interval misses the median, at most.
const MISS: f64 = 0.05;

/// A timed sub-step.
#[derive(Clone, Copy, Debug, Default)]
pub struct Taken {
    /// s
    pub seconds: f64,
    /// Outside of the solve.
    pub dispatches: usize,
    /// In the solve.
    pub solve_dispatches: usize,
}

/// Two sub-steps from the same state: with an effect, and without.
pub type Pair = [Taken; 2];

/// The scene against two parts of it, each paired with it: the mean of its two times, the sum of the parts'.
pub fn against_both([with, a]: Pair, [again, b]: Pair) -> Pair {
    let whole = Taken {
        seconds: 0.5 * (with.seconds + again.seconds),
        ..with
    };
    let parts = Taken {
        seconds: a.seconds + b.seconds,
        dispatches: a.dispatches + b.dispatches,
        solve_dispatches: a.solve_dispatches + b.solve_dispatches,
    };
    [whole, parts]
}

/// Seconds that each pair has more with the effect.
pub fn added(pairs: &[Pair]) -> Vec<f64> {
    pairs
        .iter()
        .map(|[with, without]| with.seconds - without.seconds)
        .collect()
}

/// Median seconds with the effect (0) or without (1).
pub(super) fn median(pairs: &[Pair], side: usize) -> f64 {
    Spread::of(pairs.iter().map(|pair| pair[side].seconds).collect()).median
}

/// Median of the differences of a count; of an even number of pairs the lower of the two in the middle.
pub fn middle(pairs: &[Pair], count: impl Fn(&Taken) -> usize) -> i64 {
    let added = pairs
        .iter()
        .map(|[with, without]| count(with) as i64 - count(without) as i64);
    let mut added: Vec<i64> = added.collect();
    added.sort_unstable();
    added[(added.len() - 1) / 2]
}

/// Pairs with different numbers of dispatches outside of the solve.
pub fn differing(pairs: &[Pair]) -> usize {
    pairs
        .iter()
        .filter(|[with, without]| with.dispatches != without.dispatches)
        .count()
}

/// Probability that of `n` tosses of a coin at most `k` are heads.
pub fn at_most(k: usize, n: usize) -> f64 {
    // By logarithms, as 2^-n of very many pairs underflows.
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
    let beyond = (0..n / 2).take_while(|&k| 2.0 * at_most(k, n) <= MISS);
    let k = beyond.last()?;
    Some([values[k], values[n - 1 - k]])
}

/// Seconds, of either sign, by which a scene may differ from itself: the farther end of the interval.
pub(super) fn noise(itself: &[Pair]) -> Option<f64> {
    let [low, high] = interval(added(itself))?;
    Some(low.abs().max(high.abs()))
}

/// Verdict on an interval around a median, beside the difference of a scene from itself.
pub fn told(interval: Option<[f64; 2]>, median: f64, noise: Option<f64>) -> &'static str {
    let (Some([low, high]), Some(noise)) = (interval, noise) else {
        return TOO_FEW;
    };
    match median {
        _ if (low <= 0.0 && high >= 0.0) || median.abs() <= noise => NOTHING,
        _ if median > 0.0 => ADDS,
        _ => SAVES,
    }
}
