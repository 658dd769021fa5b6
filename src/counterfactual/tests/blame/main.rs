//! Measured episodes: what their steps cost, and which of them decided.

mod attribution;
mod faulty;
mod real_bench;
mod stage;

use reel_counterfactual::blame::{CompetentAgent, blame, blame_against};
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

/// Its own play costs an agent nothing, and one who has nothing but the words measures other costs:
/// it may take for meant what they only fit.
#[test]
fn who_has_nothing_but_the_words_measures_otherwise_and_regrets_nothing() {
    let stage = Stage::new(24, 11);
    let (mut others, mut succeeded, mut regretted) = (0, 0, Vec::new());
    for task in &stage.tasks {
        let trace = stage.play(task, "planner-words");
        let [told_more, by_words] = [CompetentAgent::Planner, CompetentAgent::PlannerWords]
            .map(|agent| blame_against(&trace, agent));
        if by_words.wasted_steps > 0 {
            regretted.push(format!("{}\n{}", task.task_id, told(&trace, &by_words)));
        }
        succeeded += usize::from(by_words.success == Some(true));
        let costs = by_words.costs.iter().zip(&told_more.costs);
        others += costs
            .filter(|(one, other)| one.before != other.before)
            .count();
    }
    println!(
        "{succeeded} of {} succeed, {others} costs differ",
        stage.tasks.len()
    );
    assert!(others > 0, "the words say as much as the task");
    assert!(succeeded * 2 > stage.tasks.len(), "{succeeded}");
    assert!(
        regretted.is_empty(),
        "{} of {}:\n{}",
        regretted.len(),
        stage.tasks.len(),
        regretted.join("\n")
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
