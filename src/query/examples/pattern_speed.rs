//! Measures matching on precomputed masks: a million episodes of twelve steps.
//! Prints nanoseconds a step.

use std::{hint::black_box, time::Instant};

use reel_query::pattern::{Matcher, Pattern};

const EPISODES: usize = 1_000_000;
const STEPS: usize = 12;
const PATTERNS: &[(&str, &str)] = &[
    (
        "canonical pipeline",
        "nav_to show_object_by_category gaze_at? pick nav_to show_receptacles? place",
    ),
    ("pick without ask", "^ !ask* pick"),
    (
        "oscillation",
        "nav_to nav_to[argument <> argument@-1] nav_to[argument = argument@-2]{2,}",
    ),
    (
        "failed, later ok",
        "pick[failed] .. pick[ok] .. place[goal_receptacle] $",
    ),
];

fn main() {
    println!("{EPISODES} episodes of {STEPS} steps; seconds and nanoseconds a step");
    for (name, text) in PATTERNS {
        let pattern = Pattern::parse(text).expect("a valid pattern");
        let masks = masks(pattern.conditions().len());
        let mut matcher = pattern.matcher();
        time(
            name,
            "is_match",
            &masks,
            &mut matcher,
            |matcher, episode| usize::from(matcher.is_match(episode)),
        );
        time(name, "count", &masks, &mut matcher, Matcher::count);
        time(name, "find", &masks, &mut matcher, |matcher, episode| {
            usize::from(matcher.find(episode).is_some())
        });
    }
    // the largest pattern, and no truth vector comes twice: nothing to remember
    let conditions: Vec<String> = (0..62).map(|n| format!("[step = {n}]")).collect();
    let pattern = Pattern::parse(&format!(
        "({}){{7}} place .. finish $",
        conditions.join("|")
    ));
    let masks = random().take(EPISODES / 100 * STEPS).collect::<Vec<_>>();
    let mut matcher = pattern.expect("a valid pattern").matcher();
    time(
        "worst, 1/100 of it",
        "is_match",
        &masks,
        &mut matcher,
        |matcher, episode| usize::from(matcher.is_match(episode)),
    );
}

/// At most one condition a step, evenly drawn: tools exclude each other.
fn masks(conditions: usize) -> Vec<u64> {
    let one = |number: u64| (1 << (number % (conditions as u64 + 1))) & ((1 << conditions) - 1);
    random()
        .map(|number| one(number >> 33))
        .take(EPISODES * STEPS)
        .collect()
}

/// Pseudorandom numbers of Knuth's MMIX generator, starting from seed 1.
fn random() -> impl Iterator<Item = u64> {
    std::iter::successors(Some(1_u64), |state| {
        Some(
            state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407),
        )
    })
}

fn time(
    pattern: &str,
    call: &str,
    masks: &[u64],
    matcher: &mut Matcher,
    of: impl Fn(&mut Matcher, &[u64]) -> usize,
) {
    let begin = Instant::now();
    let sum: usize = masks
        .chunks_exact(STEPS)
        .map(|episode| of(matcher, black_box(episode)))
        .sum();
    let elapsed = begin.elapsed();
    let ns = elapsed.as_secs_f64() * 1e9 / masks.len() as f64;
    println!(
        "{pattern:20} {call:9} {:.3} s {ns:6.2} ns  ({sum})",
        elapsed.as_secs_f64()
    );
}
