//! Random choices of policies: ChaCha8, one stream per purpose, keyed by (seed, purpose, index).
//! Never the simulator's streams.

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};
use reel_world::Digest;

/// The stream of a purpose.
pub fn stream(seed: u64, purpose: &str, index: u64) -> ChaCha8Rng {
    ChaCha8Rng::from_seed(Digest::of(format!("{seed}/{purpose}/{index}").as_bytes()).0)
}

/// A number below `bound`, which is not zero. The bias of the remainder is below 2^-32
/// for bounds of ours.
pub fn below(rng: &mut ChaCha8Rng, bound: usize) -> usize {
    assert!(bound > 0, "there is no number below zero");
    (rng.next_u64() % bound as u64) as usize
}

/// One of the choices, if there is any.
pub fn choose<'a, T>(rng: &mut ChaCha8Rng, choices: &'a [T]) -> Option<&'a T> {
    if choices.is_empty() {
        None
    } else {
        choices.get(below(rng, choices.len()))
    }
}

/// Shuffles the items in place by the Fisher-Yates algorithm.
pub fn shuffle<T>(rng: &mut ChaCha8Rng, items: &mut [T]) {
    for last in (1..items.len()).rev() {
        items.swap(last, below(rng, last + 1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_repeat_and_differ_by_every_part_of_the_key() {
        let first = |seed, purpose, index| stream(seed, purpose, index).next_u64();
        assert_eq!(first(1, "a", 0), first(1, "a", 0));
        let all = [
            first(1, "a", 0),
            first(2, "a", 0),
            first(1, "b", 0),
            first(1, "a", 1),
        ];
        assert!((0..4).all(|i| (0..i).all(|j| all[i] != all[j])));
    }

    #[test]
    fn a_shuffle_keeps_what_it_shuffles() {
        let mut items: Vec<u32> = (0..20).collect();
        shuffle(&mut stream(7, "test", 0), &mut items);
        assert_ne!(items, (0..20).collect::<Vec<_>>());
        items.sort_unstable();
        assert_eq!(items, (0..20).collect::<Vec<_>>());
    }
}
