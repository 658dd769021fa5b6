//! Single bits of messages and attachments flipped by someone who corrects every checksum: each is
//! refused, or lies in a field that is said to mean nothing.

use std::{cell::Cell, collections::BTreeMap, env};

use reel_trace::Trace;

use crate::{
    damage::{read, recorded, rewritten},
    sample::Source,
};

/// What viewers draw; made of the records, read by nothing of ours.
const DERIVED: &[&str] = &reel_world::words! {
    "/tf" "/scene" "/log" "/camera/head/annotations" "/camera/head/calibration"
};

#[test]
fn every_flipped_bit_is_refused_or_means_nothing() {
    let flips: u64 = env::var("REEL_FLIPS")
        .ok()
        .and_then(|count| count.parse().ok())
        .unwrap_or(2_000);
    let (trace, _) = recorded(&Source::seeded(5).sample(4));
    let original = read(&trace).unwrap();
    let count = payloads(&trace, &mut |_, _| {});
    let mut found: BTreeMap<String, [u64; 2]> = BTreeMap::new();
    for flip in 0..flips {
        // Golden-ratio steps spread over payloads and bits without repeating.
        let spread = (flip + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let (wanted, mut topic) = (spread % count, String::new());
        let next = Cell::new(0);
        let flipped = Cell::new(None);
        let changed = rewritten(&trace, |name, data| {
            let mut data = data.to_vec();
            if next.replace(next.get() + 1) == wanted && !data.is_empty() {
                let bit = (spread >> 20) as usize % (data.len() * 8);
                data[bit / 8] ^= 1 << (bit % 8);
                flipped.set(Some(name.to_owned()));
            }
            Some(data)
        });
        if let Some(name) = flipped.take() {
            topic = name;
        }
        let counts = found.entry(topic.clone()).or_default();
        match read(&changed) {
            Err(_) => counts[0] += 1,
            Ok(changed) => {
                counts[1] += 1;
                let reason = meaningless(&topic, &original, &changed);
                assert!(
                    reason.is_some(),
                    "a flipped bit in {topic} was believed (flip {flip})"
                );
            }
        }
    }
    for (topic, [refused, meaningless]) in &found {
        eprintln!("{topic:28} {refused:6} refused {meaningless:6} without meaning");
    }
    let refused: u64 = found.values().map(|counts| counts[0]).sum();
    assert!(refused * 3 > flips, "{refused} of {flips}");
}

/// Counts what `rewritten` hands out.
fn payloads(trace: &[u8], visit: &mut dyn FnMut(&str, usize)) -> u64 {
    let count = Cell::new(0);
    let visit = std::cell::RefCell::new(visit);
    rewritten(trace, |name, data| {
        count.set(count.get() + 1);
        (visit.borrow_mut())(name, data.len());
        Some(data.to_vec())
    });
    count.get()
}

/// Why a flip that was accepted says nothing; none where it says something.
fn meaningless(topic: &str, original: &Trace, changed: &Trace) -> Option<&'static str> {
    let plain = |trace: &Trace| {
        let mut trace = trace.clone();
        trace.header.build = String::new();
        for policy in trace
            .steps
            .iter_mut()
            .filter_map(|step| step.input.policy.as_mut())
        {
            policy.latency_ns = None;
        }
        (
            trace.header,
            trace.task,
            trace.scene,
            trace.start,
            trace.steps,
        )
    };
    if plain(original) != plain(changed) {
        return None;
    }
    if original.end != changed.end {
        return Some("the end: replay makes it again and compares");
    }
    if DERIVED.contains(&topic) {
        return Some("derived for viewers");
    }
    if original.header.build != changed.header.build {
        return Some("the version of Reel");
    }
    (original.steps != changed.steps).then_some("wall-clock time of the policy")
}
