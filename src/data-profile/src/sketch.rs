//! Summaries of a stream of values in bounded memory: quantiles and frequent values.
//!
//! Both are exact for columns of few values, say so, and give the same answer for the same rows in
//! the same order.

use std::{
    collections::{BTreeMap, HashMap},
    hash::{DefaultHasher, Hash as _, Hasher as _},
};

use serde::Serialize;

/// Distinct numbers up to which quantiles are exact.
const EXACT_MAX: usize = 4_096;
/// Ratio of the bounds of a bucket. A quantile is off by at most (ratio - 1) / (ratio + 1), that
/// is 0.5 %.
const BUCKET_RATIO: f64 = 1.01;
/// Distinct values that are kept when there are more than twice as many.
const VALUES_MAX: usize = 10_000;
/// Characters of a text that are shown.
const LABEL_CHARS: usize = 60;

/// Quantiles of numbers: exact up to 4,096 distinct ones, then by buckets of relative width, as in
/// [DDSketch](https://arxiv.org/abs/1908.10693), with a relative error of at most 0.5 %.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct QuantileSketch {
    count: u64,
    sum: f64,
    /// The mean as it is followed for the deviation; the sum is exact for integers.
    mean: f64,
    /// Sum of the squared distances from the mean, kept as Welford does.
    squares: f64,
    /// Values by [`ordered`] while they are few.
    exact: BTreeMap<u64, u64>,
    /// Buckets by sign and logarithm, once they are many.
    buckets: Option<BTreeMap<i64, u64>>,
}

impl QuantileSketch {
    /// Adds a finite number; others are ignored.
    pub fn add(&mut self, value: f64) {
        if !value.is_finite() {
            return;
        }
        self.count += 1;
        self.sum += value;
        let distance = value - self.mean;
        self.mean += distance / self.count as f64;
        self.squares += distance * (value - self.mean);
        if let Some(buckets) = &mut self.buckets {
            *buckets.entry(bucket(value)).or_default() += 1;
            return;
        }
        *self.exact.entry(ordered(value)).or_default() += 1;
        if self.exact.len() > EXACT_MAX {
            *self = self.by_buckets();
        }
    }

    /// How many numbers were added.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Their mean, or `None` if there are no numbers.
    pub fn mean(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / self.count as f64)
    }

    /// Their standard deviation, of the population, or `None` if there are no numbers.
    pub fn deviation(&self) -> Option<f64> {
        (self.count > 0).then(|| (self.squares / self.count as f64).sqrt())
    }

    /// Whether quantiles are exact.
    pub fn is_exact(&self) -> bool {
        self.buckets.is_none()
    }

    /// The number of rank `share * count`, rounded up, or `None` if there are no numbers.
    pub fn quantile(&self, share: f64) -> Option<f64> {
        let rank = ((share * self.count as f64).ceil() as u64).clamp(1, self.count.max(1));
        let mut below = 0;
        self.weights().into_iter().find_map(|(value, count)| {
            below += count;
            (below >= rank).then_some(value)
        })
    }

    /// How many numbers are not greater than `limit`.
    pub fn count_up_to(&self, limit: f64) -> u64 {
        self.weights()
            .iter()
            .take_while(|(value, _)| *value <= limit)
            .map(|(_, count)| count)
            .sum()
    }

    /// The same numbers by buckets, to be compared with a sketch of many.
    pub fn by_buckets(&self) -> Self {
        let mut buckets = self.buckets.clone().unwrap_or_default();
        for (value, count) in &self.exact {
            *buckets.entry(bucket(number(*value))).or_default() += count;
        }
        Self {
            count: self.count,
            sum: self.sum,
            mean: self.mean,
            squares: self.squares,
            exact: BTreeMap::new(),
            buckets: Some(buckets),
        }
    }

    /// Values with their counts, ascending.
    fn weights(&self) -> Vec<(f64, u64)> {
        match &self.buckets {
            Some(buckets) => buckets
                .iter()
                .map(|(index, count)| (middle(*index), *count))
                .collect(),
            None => self
                .exact
                .iter()
                .map(|(value, count)| (number(*value), *count))
                .collect(),
        }
    }
}

/// A number as an integer of the same order; -0 and 0 are one.
fn ordered(value: f64) -> u64 {
    let bits = (value + 0.0).to_bits();
    if bits >> 63 == 1 {
        !bits
    } else {
        bits | 1 << 63
    }
}

fn number(ordered: u64) -> f64 {
    f64::from_bits(if ordered >> 63 == 1 {
        ordered & !(1 << 63)
    } else {
        !ordered
    })
}

/// Far enough from 0 that the logarithms of all floats stay on their side.
const BUCKET_SHIFT: i64 = 1 << 20;

/// The bucket of a number: 0 for 0, and the logarithm, shifted away from 0, on both sides.
fn bucket(value: f64) -> i64 {
    if value == 0.0 {
        return 0;
    }
    let logarithm = (value.abs().ln() / BUCKET_RATIO.ln()).ceil() as i64 + BUCKET_SHIFT;
    if value < 0.0 { -logarithm } else { logarithm }
}

/// The number in a bucket from which all others differ by the same share at most.
fn middle(bucket: i64) -> f64 {
    if bucket == 0 {
        return 0.0;
    }
    let upper = BUCKET_RATIO.powf((bucket.abs() - BUCKET_SHIFT) as f64);
    let middle = 2.0 * upper / (BUCKET_RATIO + 1.0);
    if bucket < 0 { -middle } else { middle }
}

/// A value of a column that is counted.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub(crate) enum Key {
    Bool(bool),
    Integer(i128),
    /// A float as the integer that [`ordered`] makes of it.
    Float(u64),
    /// A text as its digest.
    Text(u64),
}

/// A value and how often it occurs.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct TopValue {
    /// The value; texts are cut after 60 characters.
    pub value: String,
    /// Rows that have the value; a lower bound if the counts are not exact.
    pub count: u64,
}

/// The frequent values of a stream: exact up to 20,000 distinct ones; beyond that those that
/// [Misra and Gries](https://doi.org/10.1016/0167-6423(82)90012-0) guarantee, with a bound on what
/// their counts may lack.
#[derive(Clone, Debug, Default)]
pub struct Counts {
    counts: HashMap<Key, u64>,
    labels: HashMap<u64, String>,
    total: u64,
    missed: u64,
}

impl Counts {
    pub(crate) fn add(&mut self, key: Key) {
        self.total += 1;
        *self.counts.entry(key).or_default() += 1;
        if self.counts.len() > 2 * VALUES_MAX {
            self.prune();
        }
    }

    /// Counts a text under its digest of 64 bits.
    pub fn add_text(&mut self, text: &str) {
        let mut hasher = DefaultHasher::new();
        text.hash(&mut hasher);
        let digest = hasher.finish();
        self.labels.entry(digest).or_insert_with(|| label(text));
        self.add(Key::Text(digest));
    }

    pub(crate) fn add_float(&mut self, value: f64) {
        self.add(Key::Float(ordered(value)));
    }

    /// Drops all but the most frequent values, each with its count less that of the first dropped.
    fn prune(&mut self) {
        let mut counts: Vec<u64> = self.counts.values().copied().collect();
        counts.sort_unstable_by(|a, b| b.cmp(a));
        let lost = counts.get(VALUES_MAX).copied().unwrap_or_default();
        self.missed += lost;
        self.counts.retain(|_, count| {
            *count = count.saturating_sub(lost);
            *count > 0
        });
        let counts = &self.counts;
        self.labels
            .retain(|digest, _| counts.contains_key(&Key::Text(*digest)));
    }

    /// Whether every distinct value is counted exactly.
    pub fn is_exact(&self) -> bool {
        self.missed == 0
    }

    /// How many values were added.
    pub fn total(&self) -> u64 {
        self.total
    }

    /// How many distinct values are counted.
    pub fn distinct(&self) -> usize {
        self.counts.len()
    }

    /// The most frequent values. Where counts are not exact, only values that are certainly more
    /// frequent than all that were dropped.
    pub fn top(&self, most: usize) -> Vec<TopValue> {
        let mut counts: Vec<(&Key, u64)> = self
            .counts
            .iter()
            .map(|(key, count)| (key, *count))
            .filter(|(_, count)| *count > self.missed)
            .collect();
        counts.sort_unstable_by(|a, b| b.1.cmp(&a.1).then_with(|| a.0.cmp(b.0)));
        counts
            .into_iter()
            .take(most)
            .map(|(key, count)| TopValue {
                value: self.show(key),
                count,
            })
            .collect()
    }

    /// Counts of both streams by value, for values that either has.
    pub(crate) fn paired(&self, other: &Self) -> Vec<(String, u64, u64)> {
        let mut keys: Vec<&Key> = self.counts.keys().chain(other.counts.keys()).collect();
        keys.sort_unstable();
        keys.dedup();
        let count = |counts: &Self, key| counts.counts.get(key).copied().unwrap_or_default();
        keys.into_iter()
            .map(|key| {
                let shown = if self.counts.contains_key(key) {
                    self.show(key)
                } else {
                    other.show(key)
                };
                (shown, count(self, key), count(other, key))
            })
            .collect()
    }

    fn show(&self, key: &Key) -> String {
        match key {
            Key::Bool(value) => value.to_string(),
            Key::Integer(value) => value.to_string(),
            Key::Float(value) => number(*value).to_string(),
            Key::Text(digest) => self.labels.get(digest).cloned().unwrap_or_default(),
        }
    }
}

/// The beginning of a text, on one line.
pub(crate) fn label(text: &str) -> String {
    let mut label = String::new();
    for (index, letter) in text.chars().enumerate() {
        if index == LABEL_CHARS {
            label.push('…');
            break;
        }
        label.push(if letter.is_control() { ' ' } else { letter });
    }
    label
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn sketch(values: &[f64]) -> QuantileSketch {
        let mut sketch = QuantileSketch::default();
        values.iter().for_each(|value| sketch.add(*value));
        sketch
    }

    #[test]
    fn quantiles_of_few_values_are_exact() {
        let values = sketch(&[3.0, -1.0, 2.0, 2.0, f64::NAN, -0.0, 0.0]);
        assert!(values.is_exact());
        assert_eq!(values.count(), 6);
        assert_eq!(values.quantile(0.0), Some(-1.0));
        assert_eq!(values.quantile(0.5), Some(0.0));
        assert_eq!(values.quantile(1.0), Some(3.0));
        assert_eq!(values.count_up_to(0.0), 3);
        assert_eq!(QuantileSketch::default().quantile(0.5), None);
    }

    proptest! {
        #[test]
        fn quantiles_by_buckets_are_off_by_half_a_percent(
            values in proptest::collection::vec(prop_oneof![-1e12..1e12_f64, -1.0..1.0_f64, Just(0.0), 1e-300..1e-290_f64], 1..200),
            share in 0.0..=1.0_f64,
        ) {
            let exact = sketch(&values);
            let of = |sketch: &QuantileSketch| sketch.quantile(share).unwrap();
            let (expected, found) = (of(&exact), of(&exact.by_buckets()));
            prop_assert!((found - expected).abs() <= 0.005 * expected.abs(), "{expected} {found}");
        }
    }

    #[test]
    fn many_values_go_to_buckets() {
        let values: Vec<f64> = (0..100_000_u32).map(f64::from).collect();
        let values = sketch(&values);
        assert!(!values.is_exact());
        let median = values.quantile(0.5).unwrap();
        assert!((median - 49_999.0).abs() < 250.0, "{median}");
    }

    #[test]
    fn frequent_values_survive_a_flood_of_rare_ones() {
        let mut counts = Counts::default();
        for rare in 0..200_000_i128 {
            counts.add(Key::Integer(rare));
            if rare % 10 == 0 {
                counts.add_text("often\nthere");
            }
        }
        assert!(!counts.is_exact());
        let top = counts.top(5);
        assert_eq!(top[0].value, "often there");
        assert_eq!(top.len(), 1, "rare values are not sure: {top:?}");
        let lacking = 20_000 - top[0].count;
        assert!(lacking <= counts.missed, "{lacking} of {}", counts.missed);
        assert!(counts.distinct() <= 2 * VALUES_MAX);
    }
}
