//! What one other call would have changed: plausible calls, and what comes of them.

#[path = "../blame/stage.rs"]
#[expect(dead_code, reason = "it also tells what was measured")]
mod stage;

use std::{
    collections::BTreeSet,
    sync::atomic::{AtomicUsize, Ordering},
};

use reel_counterfactual::{
    branch::{Branch, Continuation, fork},
    plausible::{Origin, PlayedOutcome, plausible_calls, play_all},
};
use reel_vectors::episodes;
use reel_world::{Tool, ToolCall};

use crate::stage::Stage;

#[test]
fn a_call_is_plausible_once_and_never_the_recorded_one() {
    let stage = Stage::new(12, 11);
    let mut origins = BTreeSet::new();
    for (task, policy) in stage
        .tasks
        .iter()
        .zip(["wrong-object", "no-ask", "gibberish"].iter().cycle())
    {
        let trace = stage.play(task, policy);
        let calls = plausible_calls(&trace);
        assert!(calls.is_sorted_by_key(|one| one.step));
        for (index, one) in calls.iter().enumerate() {
            let recorded = &trace.steps[one.step as usize].input.call;
            assert_ne!(
                Tool::parse(&one.call).ok(),
                Tool::parse(recorded).ok(),
                "{one:?}"
            );
            let twice = |other: &&_| **other == *one;
            assert_eq!(calls[..index].iter().find(twice), None);
            origins.insert(one.origin);
        }
    }
    let [advice, marker] = [Origin::Advice, Origin::Marker].map(|one| origins.contains(&one));
    assert!(advice && marker, "{origins:?}");
}

/// Every outcome is what a branch that is played by hand comes to, whoever plays beside it.
#[test]
fn outcomes_are_those_of_branches() {
    let stage = Stage::new(3, 5);
    let (mut alone, mut handed_over) = (0, 0);
    for task in &stage.tasks {
        let trace = stage.play(task, "wrong-object");
        let (mut told, done) = (0, AtomicUsize::new(0));
        let count = || {
            done.fetch_add(1, Ordering::Relaxed);
        };
        let played = play_all(&trace, 1, |calls| told = calls, count).unwrap();
        assert_eq!((told, done.into_inner()), (played.len(), played.len()));
        assert_eq!(played, play_all(&trace, 4, |_| (), || ()).unwrap());
        for one in &played {
            let at = one.plausible.step as usize;
            let call: ToolCall = one.plausible.call.clone();
            let fork = fork(&trace, at, None).unwrap();
            let by_hand = |continuation| -> PlayedOutcome {
                let calls = vec![call.clone()];
                let branch = Branch {
                    calls,
                    continuation,
                };
                branch.play(&fork, None).unwrap().into()
            };
            assert_eq!(one.with_recorded, by_hand(Continuation::Parent(at + 1)));
            let name = "planner".to_owned();
            let seed = trace.header.seed;
            let policy = || {
                by_hand(Continuation::Policy {
                    name: name.clone(),
                    seed,
                })
            };
            assert_eq!(one.with_planner, (!one.with_recorded.success).then(policy));
            alone += usize::from(one.with_recorded.success);
            handed_over += usize::from(one.with_planner.is_some_and(|then| then.success));
        }
    }
    assert!(alone > 0 && handed_over > alone, "{alone} {handed_over}");
}
