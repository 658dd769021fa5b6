//! Measured episodes: what their steps cost, and which of them decided.

mod attribution;
mod faulty;
mod real_bench;
mod stage;

use reel_counterfactual::blame::blame;
use reel_vectors::episodes;

use crate::stage::{Stage, told};

#[test]
fn the_planner_regrets_nothing() {
    let stage = Stage::new(48, 11);
    let mut bad = Vec::new();
    for task in &stage.tasks {
        let trace = stage.play(task, "planner");
        let blame = blame(&trace);
        if blame.wasted_steps > 0 || blame.success != Some(true) {
            bad.push(format!(
                "{} {:?}\n{}",
                task.task_id,
                blame.success,
                told(&trace, &blame)
            ));
        }
    }
    assert!(
        bad.is_empty(),
        "{} of {}:\n{}",
        bad.len(),
        stage.tasks.len(),
        bad.join("\n")
    );
}

#[test]
fn what_broke_off_or_never_began_is_measured_too() {
    let stage = Stage::new(1, 11);
    let whole = stage.play(&stage.tasks[0], "wrong-object");
    for steps in 0..whole.steps.len() {
        let mut trace = whole.clone();
        trace.steps.truncate(steps);
        trace.end = None;
        let found = blame(&trace);
        assert_eq!((found.costs.len(), found.success), (steps, None));
        assert_eq!(found.decisive, None, "it did not fail yet");
    }
}
