//! How far apart two distributions are.

use crate::sketch::{Counts, QuantileSketch};

/// Population stability index from which a shift counts as significant: N. Siddiqi, *Credit Risk
/// Scorecards* (2006), calls less than 0.1 no change and more than 0.25 a major one. Its
/// statistics are in B. Yurdakul and J. Naranjo, [Statistical properties of the population
/// stability index](https://doi.org/10.21314/JRMV.2020.227).
pub const PSI_THRESHOLD: f64 = 0.25;

/// Bins of numbers: the tenths of the first set.
const BINS: usize = 10;
/// Distinct values up to which a column is compared value by value.
pub(crate) const CATEGORIES_MAX: usize = 1_000;
/// What is added to each count, so that an empty bin has a finite logarithm: Jeffreys' prior.
const PRIOR: f64 = 0.5;

/// The population stability index of two histograms over the same bins: the sum of
/// `(p - q) * ln(p / q)` over the bins that either has, with half a row added to each. 0 if one of
/// the histograms is empty.
pub fn psi(old: &[u64], new: &[u64]) -> f64 {
    let count = |counts: &[u64], bin: usize| counts.get(bin).copied().unwrap_or_default();
    let bins: Vec<(u64, u64)> = (0..old.len().max(new.len()))
        .map(|bin| (count(old, bin), count(new, bin)))
        .filter(|counts| *counts != (0, 0))
        .collect();
    let (all_old, all_new) = (old.iter().sum::<u64>(), new.iter().sum::<u64>());
    if all_old == 0 || all_new == 0 {
        return 0.0;
    }
    let share =
        |count: u64, all: u64| (count as f64 + PRIOR) / (all as f64 + PRIOR * bins.len() as f64);
    bins.iter()
        .map(|(old, new)| {
            let (p, q) = (share(*old, all_old), share(*new, all_new));
            (p - q) * (p / q).ln()
        })
        .sum()
}

/// The [Jensen-Shannon divergence](https://doi.org/10.1109/18.61115) of two histograms over the
/// same bins, to base 2: from 0 for equal shares to 1 for histograms that share no bin.
pub fn js_divergence(old: &[u64], new: &[u64]) -> f64 {
    let bins = old.len().max(new.len());
    let (all_old, all_new) = (old.iter().sum::<u64>(), new.iter().sum::<u64>());
    if all_old == 0 || all_new == 0 {
        return 0.0;
    }
    let share = |counts: &[u64], all: u64, bin: usize| {
        counts.get(bin).copied().unwrap_or_default() as f64 / all as f64
    };
    let term = |p: f64, middle: f64| {
        if p > 0.0 {
            0.5 * p * (p / middle).log2()
        } else {
            0.0
        }
    };
    let sum: f64 = (0..bins)
        .map(|bin| {
            let (p, q) = (share(old, all_old, bin), share(new, all_new, bin));
            let middle = f64::midpoint(p, q);
            term(p, middle) + term(q, middle)
        })
        .sum();
    sum.clamp(0.0, 1.0)
}

/// Two histograms over the same bins: the tenths of the first, and one for rows without a number.
pub(crate) fn binned(
    old: &QuantileSketch,
    new: &QuantileSketch,
    nulls: (u64, u64),
) -> (Vec<u64>, Vec<u64>) {
    let (old, new) = if old.is_exact() && new.is_exact() {
        (old.clone(), new.clone())
    } else {
        (old.by_buckets(), new.by_buckets())
    };
    let mut edges: Vec<f64> = (1..BINS)
        .filter_map(|bin| old.quantile(bin as f64 / BINS as f64))
        .collect();
    edges.dedup();
    let count = |sketch: &QuantileSketch, nulls: u64| {
        let mut below = 0;
        let mut counts = vec![nulls];
        for edge in &edges {
            let up_to = sketch.count_up_to(*edge);
            counts.push(up_to.saturating_sub(below));
            below = up_to;
        }
        counts.push(sketch.count().saturating_sub(below));
        counts
    };
    (count(&old, nulls.0), count(&new, nulls.1))
}

/// Two histograms of the values of a column, and one bin for rows without a value; `None` if
/// there are too many values to be categories, or most occur once.
pub(crate) fn by_value(
    old: &Counts,
    new: &Counts,
    nulls: (u64, u64),
) -> Option<(Vec<u64>, Vec<u64>)> {
    let few = |counts: &Counts| {
        let distinct = counts.distinct();
        counts.is_exact() && distinct <= CATEGORIES_MAX && 2 * distinct as u64 <= counts.total() + 1
    };
    if !few(old) || !few(new) {
        return None;
    }
    let (mut left, mut right) = (vec![nulls.0], vec![nulls.1]);
    for (_, old, new) in old.paired(new) {
        left.push(old);
        right.push(new);
    }
    Some((left, right))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn equal_shares_have_no_drift_and_disjoint_ones_the_most() {
        assert!(psi(&[100, 300], &[1_000, 3_000]).abs() < 1e-4);
        assert_eq!(js_divergence(&[1, 3], &[10, 30]), 0.0);
        assert_eq!(js_divergence(&[5, 0], &[0, 7]), 1.0);
        assert!(psi(&[1_000, 0], &[0, 1_000]) > 10.0);
        assert_eq!(psi(&[], &[1]), 0.0);
        assert_eq!(psi(&[0, 120, 0], &[0, 21, 0]), 0.0);
    }

    #[test]
    fn a_small_shift_has_a_small_index() {
        // By hand: the sum of (p - q) * ln(p / q), without the prior, is 0.01514.
        let old = [1_000; 10];
        let new = [800, 850, 900, 950, 1_000, 1_000, 1_050, 1_100, 1_150, 1_200];
        let found = psi(&old, &new);
        assert!((found - 0.01514).abs() < 0.0001, "{found}");
    }

    #[test]
    fn bins_are_the_tenths_of_the_first_set() {
        let sketch = |values: std::ops::Range<u32>| {
            let mut sketch = QuantileSketch::default();
            values.for_each(|value| sketch.add(f64::from(value)));
            sketch
        };
        let (old, new) = binned(&sketch(0..1_000), &sketch(500..1_500), (7, 0));
        assert_eq!(old, [7, 100, 100, 100, 100, 100, 100, 100, 100, 100, 100]);
        assert_eq!(new, [0, 0, 0, 0, 0, 0, 100, 100, 100, 100, 600]);
        let (old, new) = binned(&sketch(0..1_000), &sketch(0..10_000), (0, 0));
        assert_eq!(old.iter().sum::<u64>(), 1_000);
        assert_eq!(new.iter().sum::<u64>(), 10_000);
    }

    proptest! {
        #[test]
        fn both_measures_are_symmetric_and_not_negative(
            pairs in proptest::collection::vec((0_u64..50, 0_u64..50), 1..20)
        ) {
            let (old, new): (Vec<u64>, Vec<u64>) = pairs.into_iter().unzip();
            prop_assert!(psi(&old, &new) >= -1e-12);
            prop_assert!((psi(&old, &new) - psi(&new, &old)).abs() < 1e-9);
            prop_assert!((js_divergence(&old, &new) - js_divergence(&new, &old)).abs() < 1e-9);
        }
    }
}
