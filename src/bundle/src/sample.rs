//! Executing only some episodes: which, and how likely it is that forged ones are not among them.

use std::collections::BTreeSet;

use reel_statistics::uniform;
use serde::Serialize;

/// Episodes to be executed.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct Sample {
    /// Draws them: who forges must not know it before the bundle is handed in.
    pub seed: u64,
    /// Their numbers in the shard, in rising order.
    pub episodes: Vec<u32>,
}

impl Sample {
    /// Every episode of a bundle.
    pub fn all(episodes: u32) -> Self {
        Self {
            seed: 0,
            episodes: (0..episodes).collect(),
        }
    }

    /// A share of the episodes, at least one, drawn without replacement.
    pub fn draw(episodes: u32, share: f64, seed: u64) -> Self {
        let wanted = ((f64::from(episodes) * share).ceil() as u32).clamp(1.min(episodes), episodes);
        let (mut drawn, mut next) = (BTreeSet::new(), uniform(seed));
        // Floyd's: each subset of that size is as likely as any other.
        for last in episodes - wanted..episodes {
            let one = next(last + 1);
            drawn.insert(if drawn.contains(&one) { last } else { one });
        }
        Self {
            seed,
            episodes: drawn.into_iter().collect(),
        }
    }
}

/// How likely it is that none of `forged` episodes is among `drawn` of `all`: C(all - forged, drawn) / C(all, drawn).
pub fn miss_probability(all: u32, drawn: u32, forged: u32) -> f64 {
    let (all, drawn, forged) = (u64::from(all), u64::from(drawn), u64::from(forged));
    (0..forged.min(all))
        .map(|before| {
            let left = all - before;
            left.saturating_sub(drawn) as f64 / left as f64
        })
        .product()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_sample_misses() {
        assert!((miss_probability(180, 9, 1) - 0.95).abs() < 1e-12);
        assert!((miss_probability(180, 9, 18) - 0.378_616).abs() < 1e-6);
        assert!((miss_probability(180, 9, 50) - 0.049_354).abs() < 1e-6);
        assert_eq!(
            (miss_probability(5, 5, 1), miss_probability(5, 3, 3)),
            (0.0, 0.0)
        );
        assert_eq!(miss_probability(5, 3, 0), 1.0);
    }

    #[test]
    fn a_draw_is_of_its_size_and_every_episode_is_drawn_as_often() {
        let mut counts = [0_u32; 20];
        for seed in 0..4000 {
            let sample = Sample::draw(20, 0.25, seed);
            assert_eq!(sample.episodes.len(), 5);
            assert!(sample.episodes.is_sorted_by(|a, b| a < b));
            sample
                .episodes
                .iter()
                .for_each(|one| counts[*one as usize] += 1);
        }
        // 1,000 expected; five standard deviations are 137
        assert!(
            counts.iter().all(|count| count.abs_diff(1000) < 140),
            "{counts:?}"
        );
        assert_eq!(Sample::draw(20, 0.25, 7), Sample::draw(20, 0.25, 7));
        assert!(Sample::draw(0, 0.25, 7).episodes.is_empty());
        assert_eq!(Sample::draw(3, 0.001, 7).episodes.len(), 1);
        assert_eq!(Sample::draw(3, 1.0, 7).episodes, [0, 1, 2]);
    }
}
