//! The published tasks (docs/spec.md#real-bench): the planner regrets nothing in them, and the
//! detours of the published plans are regret.

use std::collections::BTreeSet;

use rayon::prelude::*;
use reel_counterfactual::blame::blame;
use reel_world::{ReceptacleId, Task};
use serde_json::Value;

use crate::stage::{Stage, told};

/// Every so many tasks are played; all of them where `REEL_EVERY_TASK` is set.
fn step() -> usize {
    if std::env::var_os("REEL_EVERY_TASK").is_some() {
        1
    } else {
        9
    }
}

fn stage() -> Option<Stage> {
    let (scene, mut tasks) = reel_vectors::episodes::real_bench()?;
    tasks.sort_by(|one, other| one.task_id.cmp(&other.task_id));
    Some(Stage::of(
        tasks.into_iter().step_by(step()).collect(),
        scene,
    ))
}

/// Whether the published plan drives to furniture that is neither source nor destination.
fn strays(task: &Task) -> bool {
    let needed: BTreeSet<&ReceptacleId> = [&task.src, &task.dest].into();
    let drives = task.plan.iter().filter(|step| step.action == "nav_to");
    let mut to = drives.filter_map(|step| step.args.get("receptacle_name").and_then(Value::as_str));
    to.any(|id| !needed.contains(&ReceptacleId::from(id)))
}

#[test]
fn the_planner_regrets_nothing_and_the_published_detours_are_regret() {
    let Some(stage) = stage() else { return };
    let wrong: Vec<String> = stage
        .tasks
        .par_iter()
        .filter_map(|task| {
            let trace = stage.play(task, "planner");
            let found = blame(&trace);
            (found.wasted_steps > 0 || found.success != Some(true))
                .then(|| format!("{}\n{}", task.task_id, told(&trace, &found)))
        })
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let astray: Vec<_> = stage.tasks.iter().filter(|task| strays(task)).collect();
    let regretted = astray
        .par_iter()
        .filter(|task| blame(&stage.play(task, "oracle")).wasted_steps > 0)
        .count();
    eprintln!(
        "{} planner episodes without regret; {regretted} of {} published detours are regret",
        stage.tasks.len(),
        astray.len()
    );
    assert!(
        !astray.is_empty() && regretted == astray.len(),
        "{regretted} of {}",
        astray.len()
    );
}
