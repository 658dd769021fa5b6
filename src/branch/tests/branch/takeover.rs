//! Policies that take over in the middle: they have watched what came before, and make the best of it.

use std::sync::Arc;

use reel_branch::{Branch, Then};
use reel_replay::Fork;
use reel_trace::{Images, Trace};
use reel_world::Task;

use crate::episodes::{Folder, tasks};

/// At how many of the calls of an episode a policy that takes over still reaches the goal; of how many.
fn rescued(folder: &Folder, task: &Arc<Task>, faulty: &str, heir: &str) -> (usize, usize, Trace) {
    let parent = folder.play(task, faulty, Images::None);
    let forks = Fork::everywhere(&parent).unwrap();
    let reached = forks.iter().filter(|fork| Branch::policy(heir, 1).play(fork, None).unwrap().success).count();
    (reached, forks.len(), parent)
}

#[test]
fn the_oracle_saves_what_can_be_saved() {
    let folder = Folder::new();
    for (task, faulty) in [(0, "wrong-object"), (1, "wrong-receptacle"), (2, "no-ask"), (3, "forgets-door")] {
        let (reached, moments, parent) = rescued(&folder, &tasks()[task], faulty, "oracle");
        eprintln!("{faulty} in {}: the oracle reaches the goal from {reached} of {moments} moments", parent.header.task_id);
        assert!(reached * 4 >= moments * 3, "{faulty} in {}: {reached} of {moments}", parent.header.task_id);
    }
}

#[test]
fn the_planner_puts_back_what_was_taken_by_mistake() {
    let folder = Folder::new();
    let mut put_back = 0;
    for task in &tasks()[..2] {
        let parent = folder.play(task, "wrong-object", Images::None);
        let alone = folder.play(task, "planner", Images::None).end.unwrap().metrics.success;
        let Some(picked) = parent.steps.iter().position(|step| step.held.is_some()) else { continue };
        let held = parent.steps[picked].held.clone();
        assert_ne!(held.as_ref(), Some(&task.target));
        let made = folder.branch(&Branch::policy("planner", 1), &parent, picked + 1, Images::None);
        let end = made.end.as_ref().unwrap();
        let home = task.object(held.as_ref().unwrap()).unwrap().receptacle.clone();
        assert_eq!(end.graphs.physics.place_of(held.as_ref().unwrap()), Some(&home), "{}", task.task_id);
        assert_eq!(end.metrics.success, alone, "{}", task.task_id);
        put_back += 1;
    }
    assert!(put_back > 0);
}

#[test]
fn who_watched_itself_goes_on_as_it_would_have() {
    let folder = Folder::new();
    let parent = folder.play(&tasks()[0], "planner", Images::None);
    for at in [1, parent.steps.len() / 2, parent.steps.len() - 1] {
        let branch = Branch { calls: Vec::new(), then: Then::Policy { name: "planner".into(), seed: 3 } };
        let made = folder.branch(&branch, &parent, at, Images::None);
        let calls = |trace: &Trace| -> Vec<String> { trace.steps.iter().map(|step| step.input.call.to_string()).collect() };
        assert_eq!(calls(&made), calls(&parent), "from call {at} on");
    }
}
