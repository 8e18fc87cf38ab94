//! Pairs of sub-steps from the same state, and what their differences tell.
//!
//! Nothing is supposed of how seconds are distributed: the ends of an interval are two of the differences, by their order, and the chance that it
//! misses the true median is one of tosses of a coin (the sign test; Conover, Practical Nonparametric Statistics, sections 3.2 and 3.4).

use super::super::statistics::Spread;

/// Of seconds that are more with an effect.
pub(super) const ADDS: &str = "adds";
/// Of those that are less.
const SAVES: &str = "saves";
/// Of those that two paths of one scene may differ by, too.
pub(super) const NOTHING: &str = "not told apart from nothing";
/// Where there is no interval.
const TOO_FEW: &str = "too few pairs";
/// Chance that an interval misses the median, at most.
const MISS: f64 = 0.05;

/// What a sub-step took.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Taken {
    /// s
    pub(super) seconds: f64,
    /// Outside of the solve.
    pub(super) dispatches: usize,
    /// In it.
    pub(super) solve_dispatches: usize,
}

/// Two sub-steps from the same state: with an effect, and without.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair(pub(super) [Taken; 2]);

impl Pair {
    /// The scene against two parts of it, each of which it was paired with: its two times in the middle, the parts' together.
    pub(super) fn against_both(&self, other: &Pair) -> Pair {
        let ([with, a], [again, b]) = (self.0, other.0);
        Pair([
            Taken {
                seconds: 0.5 * (with.seconds + again.seconds),
                ..with
            },
            Taken {
                seconds: a.seconds + b.seconds,
                dispatches: a.dispatches + b.dispatches,
                solve_dispatches: a.solve_dispatches + b.solve_dispatches,
            },
        ])
    }
}

/// Seconds that each pair has more with the effect.
pub(super) fn added(pairs: &[Pair]) -> Vec<f64> {
    let added = pairs
        .iter()
        .map(|Pair([with, without])| with.seconds - without.seconds);
    added.collect()
}

/// Median of a number of each pair.
pub(super) fn median(pairs: &[Pair], number: impl Fn(&Pair) -> f64) -> f64 {
    Spread::of(pairs.iter().map(number).collect()).median
}

/// What the effect adds to a count: of the pairs' differences the one in the middle, of an even number the lower of both.
pub(super) fn middle(pairs: &[Pair], count: impl Fn(&Taken) -> usize) -> i64 {
    let added = pairs
        .iter()
        .map(|Pair([with, without])| count(with) as i64 - count(without) as i64);
    let mut added: Vec<i64> = added.collect();
    added.sort_unstable();
    added[(added.len() - 1) / 2]
}

/// Pairs whose sub-steps have other numbers of dispatches outside of the solve.
pub(super) fn differing(pairs: &[Pair]) -> usize {
    let differ = |Pair([with, without]): &&Pair| with.dispatches != without.dispatches;
    pairs.iter().filter(differ).count()
}

/// The chance that of `n` tosses of a coin at most `k` are heads.
pub(super) fn at_most(k: usize, n: usize) -> f64 {
    // Of the logarithm, as 2^-n of very many pairs is no number.
    let mut ln_ways = 0.0;
    let mut chance = 0.0;
    for heads in 0..=k.min(n) {
        chance += f64::exp(ln_ways - n as f64 * std::f64::consts::LN_2);
        ln_ways += f64::ln((n - heads) as f64 / (heads + 1) as f64);
    }
    chance
}

/// The narrowest pair of values, as far from the least as from the largest, between which the true median is with a chance of at least 95 %;
/// `None` below six values.
pub(super) fn interval(mut values: Vec<f64>) -> Option<[f64; 2]> {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    let beyond = (0..n / 2).take_while(|&k| 2.0 * at_most(k, n) <= MISS);
    let k = beyond.last()?;
    Some([values[k], values[n - 1 - k]])
}

/// Seconds, of either sign, that a scene may differ by from itself: the farther end of the interval.
pub(super) fn noise(itself: &[Pair]) -> Option<f64> {
    let [low, high] = interval(added(itself))?;
    Some(low.abs().max(high.abs()))
}

/// What an interval around a median tells, beside what a scene may differ by from itself.
pub(super) fn told(interval: Option<[f64; 2]>, median: f64, noise: Option<f64>) -> &'static str {
    let (Some([low, high]), Some(noise)) = (interval, noise) else {
        return TOO_FEW;
    };
    match median {
        _ if (low <= 0.0 && high >= 0.0) || median.abs() <= noise => NOTHING,
        _ if median > 0.0 => ADDS,
        _ => SAVES,
    }
}

#[cfg(test)]
mod tests {
    use super::{
        ADDS, NOTHING, Pair, SAVES, TOO_FEW, Taken, at_most, differing, interval, middle, told,
    };

    #[test]
    fn tosses_of_a_coin() {
        for (k, n, ways) in [
            (0, 12, 1.0),
            (2, 12, 79.0),
            (3, 12, 299.0),
            (12, 12, 4096.0),
        ] {
            let chance = ways / 4096.0;
            assert!((at_most(k, n) - chance).abs() <= 1e-14, "{k} of {n}");
        }
        // Of very many half are at most half, but for the one in the middle: 0.5 + 0.5 sqrt(2 / (pi n)).
        let half = at_most(2000, 4000);
        assert!((half - 0.506_307).abs() < 1e-5, "{half}");
    }

    #[test]
    fn the_interval_is_that_of_the_tables() {
        let of = |n: usize| interval((1..=n).rev().map(|x| x as f64).collect());
        // Ranks at 95 % from tables of the sign test.
        for (n, low) in [
            (6, 1.0),
            (8, 1.0),
            (9, 2.0),
            (12, 3.0),
            (20, 6.0),
            (25, 8.0),
        ] {
            assert_eq!(of(n), Some([low, (n + 1) as f64 - low]), "{n} values");
        }
        assert_eq!((of(5), of(0)), (None, None));
    }

    #[test]
    fn what_two_of_a_kind_differ_by_is_nothing() {
        let around = |low, high| told(Some([low, high]), 0.5 * (low + high), Some(1.0));
        assert_eq!(around(-0.1, 9.0), NOTHING);
        assert_eq!(around(0.2, 1.4), NOTHING, "its median is within the noise");
        assert_eq!(around(0.9, 1.5), ADDS);
        assert_eq!(around(-1.5, -0.9), SAVES);
        assert_eq!(told(None, 5.0, None), TOO_FEW);
    }

    #[test]
    fn counts_are_those_of_the_pairs() {
        let taken = |dispatches, solve_dispatches| Taken {
            seconds: 1.0,
            dispatches,
            solve_dispatches,
        };
        let pairs = [(5, 90), (4, 7), (3, 11), (9, 10)]
            .map(|(n, solve)| Pair([taken(n, solve), taken(3, 10)]));
        assert_eq!(middle(&pairs, |taken| taken.dispatches), 1);
        assert_eq!(middle(&pairs, |taken| taken.solve_dispatches), 0);
        assert_eq!(differing(&pairs), 3);
        let [with, without] = pairs[0].against_both(&pairs[1]).0;
        assert_eq!((with.seconds, without.seconds), (1.0, 2.0));
        assert_eq!((with.dispatches, without.dispatches), (5, 6));
    }
}
