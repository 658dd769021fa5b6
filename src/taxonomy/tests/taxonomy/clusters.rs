//! Clusters at the size of a real store.

use std::time::{Duration, Instant};

use reel_taxonomy::clusters::{CallKind, CallSequence, group};

/// Numbers below a bound that look random (xorshift); equal seeds give equal numbers.
fn numbers(seed: u32) -> impl FnMut(u32) -> u32 {
    let mut state = seed.wrapping_add(1).wrapping_mul(2_654_435_769) | 1;
    move |bound| {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        state % bound
    }
}

/// The calls of an episode in one of 40 ways to fail, with about a tenth changed.
fn sequence(number: u32) -> CallSequence {
    let kind = |kind: u32| CallKind {
        tool: format!("tool_{}", kind % 12),
        object: kind.is_multiple_of(3).then(|| "target".to_owned()),
        receptacle: None,
        error: kind.is_multiple_of(5).then(|| "moderate".to_owned()),
    };
    let (mut way, mut change) = (numbers(number % 40), numbers(1_000 + number));
    let calls = (0..30).map(|_| {
        let usual = way(60);
        match change(10) {
            0 => kind(change(60)),
            _ => kind(usual),
        }
    });
    CallSequence {
        episode_id: number.to_string(),
        trace: format!("{number}.mcap"),
        calls: calls.collect(),
    }
}

#[test]
fn ten_thousand_different_sequences_are_grouped_in_seconds_by_their_ways() {
    let sequences: Vec<CallSequence> = (0..10_000).map(sequence).collect();
    let start = Instant::now();
    let grouping = group(&sequences, 0.4);
    let took = start.elapsed();
    println!("10,000 sequences of 30 calls: {took:?}");
    assert!(took < Duration::from_mins(1), "{took:?}");
    assert!(grouping.sequences > 9_000 && grouping.sampled.is_none());
    // Who is in a group with most of the others of its way.
    let together: usize = grouping
        .groups
        .iter()
        .map(|members| {
            let mut ways = [0_usize; 40];
            members.iter().for_each(|(index, _)| ways[index % 40] += 1);
            ways.into_iter().max().unwrap_or_default()
        })
        .sum();
    assert!(
        together > 9_500 && grouping.groups.len() < 1_000,
        "{together} {}",
        grouping.groups.len()
    );
}
