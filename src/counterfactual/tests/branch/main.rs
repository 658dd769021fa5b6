//! Branches of recorded episodes: random ones, of branches too and of what was compacted and
//! recovered, verified bit for bit; what they hold; and what is refused.

mod folder;
mod random;
mod takeover;

use reel_vectors::episodes;
use std::sync::Arc;

use reel_counterfactual::branch::{Branch, BranchError, Continuation, POLICY_NAME, fork};
use reel_replay::{Fork, Verdict, compact, compare, verify_branch, verify_trace};
use reel_trace::{Images, Trace};
use reel_world::{
    ToolCall,
    record::{Backend, EndReason},
};
use serde_json::json;

use crate::{episodes::tasks, folder::Folder};

fn walk() -> ToolCall {
    ToolCall::new("walk_around", json!({}))
}

#[test]
fn a_branch_has_the_parents_past_its_own_future_and_says_so() {
    let folder = Folder::new();
    let parent = folder.play(&tasks()[0], "no-ask", Images::Full);
    let branch = Branch {
        calls: vec![walk(), ToolCall::new("throw", json!({ "marker_id": 3 }))],
        continuation: Continuation::Stop,
    };
    let made = folder.branch(&branch, &parent, 3, Images::Full);
    let header = &made.header;
    assert_eq!(
        (
            header.policy.name.as_str(),
            header.parent.as_ref().unwrap().call
        ),
        (POLICY_NAME, 3)
    );
    assert_eq!(header.policy.parameters["calls"], json!(branch.calls));
    assert_eq!(header.parent.as_ref().unwrap().trace, parent.chain());
    assert_ne!(header.episode_id, parent.header.episode_id);
    assert_eq!(
        (made.steps.len(), made.end.as_ref().unwrap().reason),
        (5, EndReason::Aborted)
    );
    for (ours, theirs) in made.steps.iter().zip(&parent.steps[..3]) {
        // The words of the policy are inputs, and stay.
        assert_eq!(
            (&ours.input, &ours.outcome, &ours.reward),
            (&theirs.input, &theirs.outcome, &theirs.reward)
        );
        assert_eq!(made.image(Some(ours.step)), parent.image(Some(theirs.step)));
    }
    assert!(
        made.steps[4].outcome.error.is_some(),
        "an invalid call is feedback"
    );
    let descent = verify_branch(&made, &parent);
    assert!(descent.holds(), "{descent:?}");

    // Other calls at the same place are another episode; the same ones are the same, to the
    // byte, by whatever way.
    let other = folder.branch(
        &Branch {
            calls: vec![walk()],
            continuation: Continuation::Stop,
        },
        &parent,
        3,
        Images::Full,
    );
    assert_ne!(other.header.episode_id, header.episode_id);
    let lean = folder.path("lean.mcap");
    compact(&parent, &lean, false).unwrap();
    let again = folder.branch(&branch, &Trace::read(&lean).unwrap(), 3, Images::Full);
    assert!(
        std::fs::read(&again.path).unwrap() == std::fs::read(&made.path).unwrap(),
        "the way to the moment shows"
    );
}

#[test]
fn the_parents_calls_go_on_after_what_was_put_in_for_them() {
    let folder = Folder::new();
    let parent = folder.play(&tasks()[0], "oracle", Images::None);
    let last = parent.steps.len();
    let calls = |trace: &Trace| -> Vec<String> {
        trace
            .steps
            .iter()
            .map(|step| step.input.call.to_string())
            .collect()
    };
    let whole = calls(&parent);
    let inserted = Branch {
        calls: vec![walk()],
        continuation: Continuation::Parent(0),
    };
    let made = folder.branch(&inserted, &parent, 0, Images::None);
    assert_eq!(calls(&made)[1..], whole[..]);
    assert!(
        made.steps[1..]
            .iter()
            .all(|step| step.input.policy.is_none()),
        "words of another world"
    );
    let replaced = folder.branch(&Branch::replacing(1, walk()), &parent, 1, Images::None);
    assert_eq!(
        (&calls(&replaced)[0], &calls(&replaced)[2..]),
        (&whole[0], &whole[2..])
    );
    let deleted = folder.branch(
        &Branch {
            calls: Vec::new(),
            continuation: Continuation::Parent(last - 1),
        },
        &parent,
        last - 2,
        Images::None,
    );
    assert_eq!(
        calls(&deleted),
        [&whole[..last - 2], &whole[last - 1..]].concat()
    );
    for made in [&made, &replaced, &deleted] {
        assert!(verify_branch(made, &parent).holds());
    }
    let nothing_left = Branch {
        calls: Vec::new(),
        continuation: Continuation::Parent(last + 1),
    };
    assert!(
        matches!(nothing_left.play_at(&parent, 1, None), Err(BranchError::NoSuchCall { from, .. }) if from == last + 1)
    );

    // Side by side a call more does not shift what follows.
    let beside = compare(&parent, &made).unwrap();
    assert_eq!((beside.same_calls, beside.rows.len()), (0, last + 1));
    assert!(beside.rows[0].a.is_none() && beside.rows[1..].iter().all(|row| row.same_call));
    let beside = compare(&parent, &replaced).unwrap();
    assert_eq!(
        (
            beside.same_calls,
            beside.rows[0].same_call,
            beside.rows.len()
        ),
        (1, false, last - 1)
    );
    assert!(compare(&parent, &parent).unwrap().is_same());
    let elsewhere = folder.play(&tasks()[1], "oracle", Images::None);
    assert!(
        compare(&parent, &elsewhere)
            .unwrap_err()
            .to_string()
            .contains("different tasks")
    );
}

#[test]
fn a_trial_comes_to_what_a_recording_comes_to() {
    let folder = Folder::new();
    let parent = folder.play(&tasks()[2], "wrong-object", Images::None);
    let branch = Branch::policy("planner", 5);
    let forks = Fork::at_every_call(&parent).unwrap();
    assert_eq!(
        forks.iter().map(Fork::call).collect::<Vec<_>>(),
        (0..parent.steps.len()).collect::<Vec<_>>()
    );
    for fork in forks.iter().step_by(4) {
        let trial = branch.play(fork, None).unwrap();
        let recorded = folder.branch(&branch, &parent, fork.call(), Images::None);
        let end = recorded.end.as_ref().unwrap();
        assert_eq!(
            (&trial.episode_id, trial.length, trial.end_reason),
            (&recorded.header.episode_id, end.steps, end.reason)
        );
        assert_eq!(
            (trial.success, trial.total_reward),
            (end.metrics.success, end.metrics.total_reward)
        );
    }
}

#[test]
fn who_cannot_be_a_parent_is_told_why() {
    let folder = Folder::new();
    let parent = folder.play(&tasks()[0], "oracle", Images::None);
    let refused = |trace: &Trace, at: usize| fork(trace, at, None).unwrap_err().to_string();
    let last = parent.steps.len();
    let ended = refused(&parent, last);
    assert!(
        ended.contains(&format!(
            "the episode ended with call {}: branch at one of the calls 0 to",
            last - 1
        )),
        "{ended}"
    );
    assert!(refused(&parent, last + 1).contains("unknown call"));

    let mut other = parent.clone();
    other.header.sim_version = 1;
    assert!(
        refused(&other, 1).contains("recorded by simulator 1, this is"),
        "{}",
        refused(&other, 1)
    );
    for (backend, word) in [
        (Backend::Proxy, "through a proxy"),
        (Backend::Robot, "on a robot"),
    ] {
        other.header = parent.header.clone();
        other.header.backend = backend;
        assert!(refused(&other, 1).contains(word), "{}", refused(&other, 1));
    }
    let unknown = Branch::policy("clever", 0)
        .play_at(&parent, 1, None)
        .unwrap_err();
    assert!(
        unknown.to_string().contains("no policy is called 'clever'"),
        "{unknown}"
    );

    // A parent that is not what its inputs give is named, with the place.
    let mut forged = parent.clone();
    forged.steps[1].robot.yaw += 0.5;
    let error = fork(&forged, 3, None).unwrap_err();
    assert!(
        error.is_divergence() && error.to_string().contains("robot.yaw"),
        "{error}"
    );
    assert!(!fork(&parent, last, None).unwrap_err().is_divergence());
}

#[test]
fn a_past_that_is_not_the_parents_is_found() {
    let folder = Folder::new();
    let parent = folder.play(&tasks()[3], "oracle", Images::None);
    let branch = folder.branch(
        &Branch {
            calls: vec![walk()],
            continuation: Continuation::Stop,
        },
        &parent,
        4,
        Images::None,
    );
    let mut changed = branch.clone();
    changed.steps[2]
        .input
        .policy
        .as_mut()
        .unwrap()
        .reasoning
        .push('!');
    let found = verify_branch(&changed, &parent).prefix.unwrap();
    assert!(
        found.to_string().contains("call 2") && found.field.contains("reasoning"),
        "{found}"
    );
    let mut other_seed = branch.clone();
    other_seed.header.seed += 1;
    assert!(
        verify_branch(&other_seed, &parent)
            .prefix
            .unwrap()
            .field
            .contains("seed")
    );
    let mut claims = branch.clone();
    claims.header.policy.parameters.insert(
        "calls".into(),
        json!([{ "name": "finish", "arguments": {} }]),
    );
    assert!(
        verify_branch(&claims, &parent)
            .prefix
            .unwrap()
            .field
            .contains("substituted")
    );

    let unrelated =
        |branch: &Trace, parent: &Trace| verify_branch(branch, parent).unrelated.unwrap();
    assert!(unrelated(&branch, &branch).contains("branches from the trace"));
    assert_eq!(unrelated(&parent, &parent), "it is no branch");
    let descent = verify_branch(&branch, &parent);
    assert!(
        descent.holds() && matches!(descent.verdict, Verdict::Exact { calls: 5, .. }),
        "{descent:?}"
    );
    assert!(verify_trace(&Arc::new(branch)).is_exact());
}
