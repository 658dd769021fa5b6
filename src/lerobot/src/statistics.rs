//! Statistics as LeRobot keeps them: of an episode and of all, over every frame.

use serde_json::{Map, Value, json};

use crate::columns::STATISTICS;

const QUANTILES: [f64; 5] = [0.01, 0.1, 0.5, 0.9, 0.99];

/// Statistics of one number of a column.
struct Summary {
    /// min, max, mean, std and the quantiles.
    values: [f64; 9],
}

/// Statistics of a column of vectors by their names in `stats.json`; the quantile is the smallest value that has at
/// least its share of the frames at or below it.
pub(crate) fn of_vectors(rows: &[Vec<f64>]) -> Map<String, Value> {
    let width = rows.first().map_or(0, Vec::len);
    let summaries: Vec<Summary> = (0..width)
        .map(|dimension| {
            let mut values: Vec<f64> = rows.iter().map(|row| row[dimension]).collect();
            values.sort_by(f64::total_cmp);
            let counted: Vec<(f64, u64)> = values.into_iter().map(|value| (value, 1)).collect();
            Summary::of(&counted)
        })
        .collect();
    named(&summaries, rows.len(), |value| json!(value))
}

/// How often each brightness is in each channel of some frames.
#[derive(Clone, Debug)]
pub(crate) struct ChannelHistograms {
    counts: [[u64; 256]; 3],
    frames: usize,
}

impl ChannelHistograms {
    pub(crate) fn new() -> Self {
        Self {
            counts: [[0; 256]; 3],
            frames: 0,
        }
    }

    /// Counts the pixels of a frame.
    pub(crate) fn add(&mut self, rgb: &[u8]) {
        self.frames += 1;
        for pixel in rgb.as_chunks::<3>().0 {
            for (counts, value) in self.counts.iter_mut().zip(pixel) {
                counts[usize::from(*value)] += 1;
            }
        }
    }

    /// Counts what another has counted.
    pub(crate) fn merge(&mut self, other: &Self) {
        self.frames += other.frames;
        for (counts, others) in self
            .counts
            .iter_mut()
            .flatten()
            .zip(other.counts.iter().flatten())
        {
            *counts += others;
        }
    }

    /// Statistics of a channel from 0 to 1, each as LeRobot shapes it: 3 x 1 x 1.
    pub(crate) fn statistics(&self) -> Map<String, Value> {
        let summaries = self.counts.each_ref().map(|counts| {
            let values = (0u16..).zip(counts).filter(|(_, count)| **count > 0);
            let values: Vec<(f64, u64)> = values
                .map(|(value, count)| (f64::from(value) / 255.0, *count))
                .collect();
            Summary::of(&values)
        });
        named(&summaries, self.frames, |value| json!([[value]]))
    }
}

impl Summary {
    /// Of values in ascending order with how often each is there.
    fn of(values: &[(f64, u64)]) -> Self {
        let count: u64 = values.iter().map(|(_, count)| count).sum();
        let count = count.max(1) as f64;
        let sum = |of: &dyn Fn(f64) -> f64| -> f64 {
            values
                .iter()
                .map(|(value, times)| of(*value) * *times as f64)
                .sum()
        };
        let mean = sum(&|value| value) / count;
        let variance = sum(&|value| (value - mean) * (value - mean)) / count;
        let end = |value: Option<&(f64, u64)>| value.map_or(0.0, |(value, _)| *value);
        let (min, max) = (end(values.first()), end(values.last()));
        let mut summary = [0.0; 9];
        summary[..4].copy_from_slice(&[min, max, mean, variance.sqrt()]);
        for (quantile, found) in QUANTILES.iter().zip(&mut summary[4..]) {
            let mut below = 0;
            let reached = values.iter().find(|(_, times)| {
                below += times;
                below as f64 >= quantile * count
            });
            *found = reached.map_or(max, |(value, _)| *value);
        }
        Self { values: summary }
    }
}

/// The statistics of all numbers of a column by name.
fn named(summaries: &[Summary], count: usize, shaped: impl Fn(f64) -> Value) -> Map<String, Value> {
    let mut at = 0..;
    let named = STATISTICS.map(|statistic| {
        if statistic == "count" {
            return (statistic.to_owned(), json!([count]));
        }
        let at = at.next().unwrap_or_default();
        let values = summaries.iter().map(|summary| shaped(summary.values[at]));
        (statistic.to_owned(), values.collect())
    });
    Map::from_iter(named)
}
