//! Random streams: one for each (seed, purpose, index), so that one draw more
//! somewhere changes nothing elsewhere.

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};
use reel_world::Digest;

/// A stream of random numbers.
#[derive(Debug)]
pub struct Stream(ChaCha8Rng);

impl Stream {
    /// The stream of a seed for a purpose and an index.
    pub fn new(seed: u64, purpose: &str, index: usize) -> Self {
        Self(ChaCha8Rng::from_seed(
            Digest::of(format!("{seed}/{purpose}/{index}").as_bytes()).0,
        ))
    }

    /// A number from 0 to below `n`.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the high half of the product is below n"
    )]
    pub fn below(&mut self, n: usize) -> usize {
        ((u128::from(self.0.next_u64()) * n as u128) >> 64) as usize
    }

    /// A number in `from..to`.
    pub fn between(&mut self, from: f64, to: f64) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "53 bits fit")]
        let unit = (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
        from + unit * (to - from)
    }

    /// One of the items.
    pub fn pick<'a, T>(&mut self, items: &'a [T]) -> Option<&'a T> {
        if items.is_empty() {
            None
        } else {
            items.get(self.below(items.len()))
        }
    }

    /// Some of the items, at most `most`, in random order.
    pub fn pick_some<T: Clone>(&mut self, items: &[T], most: usize) -> Vec<T> {
        let mut rest = items.to_vec();
        let count = most.min(rest.len());
        (0..count)
            .map(|_| rest.remove(self.below(rest.len())))
            .collect()
    }
}
