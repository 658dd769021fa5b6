//! Policies that take over in the middle: they have watched what came before, and make
//! the best of it.

use std::sync::Arc;

use reel_counterfactual::branch::{Branch, Continuation};
use reel_replay::Fork;
use reel_trace::{Images, Trace};
use reel_world::Task;

use crate::{episodes::tasks, folder::Folder};

/// At how many of the calls of an episode a policy that takes over still reaches the
/// goal; of how many.
fn rescued(folder: &Folder, task: &Arc<Task>, faulty: &str, heir: &str) -> (usize, usize, Trace) {
    let parent = folder.play(task, faulty, Images::None);
    let forks = Fork::at_every_call(&parent).unwrap();
    let reached = forks
        .iter()
        .filter(|fork| Branch::policy(heir, 1).play(fork, None).unwrap().success)
        .count();
    (reached, forks.len(), parent)
}

#[test]
fn the_oracle_saves_what_can_be_saved() {
    let folder = Folder::new();
    for (task, faulty) in [
        (0, "wrong-object"),
        (1, "wrong-receptacle"),
        (2, "no-ask"),
        (3, "forgets-door"),
    ] {
        let (reached, moments, parent) = rescued(&folder, &tasks()[task], faulty, "oracle");
        eprintln!(
            "{faulty} in {}: the oracle reaches the goal from {reached} of {moments} moments",
            parent.header.task_id
        );
        assert!(
            reached * 4 >= moments * 3,
            "{faulty} in {}: {reached} of {moments}",
            parent.header.task_id
        );
    }
}

#[test]
fn who_watched_itself_goes_on_as_it_would_have() {
    let folder = Folder::new();
    let parent = folder.play(&tasks()[0], "planner", Images::None);
    for at in [1, parent.steps.len() / 2, parent.steps.len() - 1] {
        let branch = Branch {
            calls: Vec::new(),
            continuation: Continuation::Policy {
                name: "planner".into(),
                seed: 3,
            },
        };
        let made = folder.branch(&branch, &parent, at, Images::None);
        let calls = |trace: &Trace| -> Vec<String> {
            trace
                .steps
                .iter()
                .map(|step| step.input.call.to_string())
                .collect()
        };
        assert_eq!(calls(&made), calls(&parent), "from call {at} on");
    }
}
