//! Measures matching on precomputed masks: a million episodes of twelve steps. Prints nanoseconds a step.

use std::{hint::black_box, time::Instant};

use reel_pattern::{Matcher, Pattern};

const EPISODES: usize = 1_000_000;
const STEPS: usize = 12;
const PATTERNS: &[(&str, &str)] = &[
    ("canonical pipeline", "nav_to show_object_by_category gaze_at? pick nav_to show_receptacles? place"),
    ("pick without ask", "^ !ask* pick"),
    ("oscillation", "nav_to nav_to[argument <> argument@-1] nav_to[argument = argument@-2]{2,}"),
    ("failed, later ok", "pick[failed] .. pick[ok] .. place[goal_receptacle] $"),
];

fn main() {
    println!("{EPISODES} episodes of {STEPS} steps; seconds and nanoseconds a step");
    for (name, text) in PATTERNS {
        let pattern = Pattern::parse(text).expect("a valid pattern");
        let masks = masks(pattern.conditions().len());
        let mut matcher = pattern.matcher();
        time(name, "is_match", &masks, &mut matcher, |matcher, episode| usize::from(matcher.is_match(episode)));
        time(name, "count", &masks, &mut matcher, Matcher::count);
        time(name, "find", &masks, &mut matcher, |matcher, episode| usize::from(matcher.find(episode).is_some()));
    }
}

/// At most one condition a step, evenly drawn: tools exclude each other.
fn masks(conditions: usize) -> Vec<u64> {
    let mut state = 1_u64;
    let draw = || {
        // Knuth's MMIX generator
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (1 << ((state >> 33) as usize % (conditions + 1))) & ((1 << conditions) - 1)
    };
    std::iter::repeat_with(draw).take(EPISODES * STEPS).collect()
}

fn time(pattern: &str, call: &str, masks: &[u64], matcher: &mut Matcher, of: impl Fn(&mut Matcher, &[u64]) -> usize) {
    let begin = Instant::now();
    let sum: usize = masks.chunks_exact(STEPS).map(|episode| of(matcher, black_box(episode))).sum();
    let elapsed = begin.elapsed();
    let ns = elapsed.as_secs_f64() * 1e9 / (EPISODES * STEPS) as f64;
    println!("{pattern:20} {call:9} {:.3} s {ns:6.2} ns  ({sum})", elapsed.as_secs_f64());
}
