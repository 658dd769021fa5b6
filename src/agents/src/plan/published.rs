//! A task's published plan as intents. Never checks whether the plan leads to the goal.

use reel_world::{InstanceId, PlanStep, Task};
use serde_json::Value;

use crate::plan::Intent;

/// The plan that came with the task, with `finish` at its end; none where the task has none or
/// where it holds an action or argument that is not understood.
///
/// A group of `find`, `gaze_at` and `pick` is about the task's target, whatever its category says,
/// or about the `instance` that our own tasks name where several move. An `ask` is said as its
/// `question` has it; without one, the words are left to the policy, which knows what it sees.
pub fn published_plan(task: &Task) -> Option<Vec<Intent>> {
    let mut intents = Vec::new();
    for step in &task.plan {
        let receptacle = || text(step, "receptacle_name").map(Into::into);
        match step.action.as_str() {
            "nav_to" => intents.push(Intent::NavTo(receptacle()?)),
            "open" => intents.push(Intent::Open(receptacle()?)),
            "close" => intents.push(Intent::Close(receptacle()?)),
            "place" => intents.push(Intent::Place(receptacle()?)),
            "find" | "gaze_at" => push_find(&mut intents, task, step),
            "pick" => {
                push_find(&mut intents, task, step);
                intents.push(Intent::Pick(meant(task, step)));
            }
            "ask" => {
                let question = text(step, "question").map(str::to_owned);
                intents.push(Intent::Ask {
                    about: meant(task, step),
                    question,
                });
            }
            "finish" => {}
            _ => return None,
        }
    }
    if intents.is_empty() {
        return None;
    }
    intents.push(Intent::Finish);
    Some(intents)
}

/// One `Find` for a run of steps that look for the target, questions in between included.
fn push_find(intents: &mut Vec<Intent>, task: &Task, step: &PlanStep) {
    let before = intents
        .iter()
        .rev()
        .find(|intent| !matches!(intent, Intent::Ask { .. }));
    if !matches!(before, Some(Intent::Find { .. })) {
        let category = text(step, "target_category")
            .unwrap_or(&task.target_object().category)
            .to_owned();
        intents.push(Intent::Find {
            category,
            target: meant(task, step),
        });
    }
}

fn meant(task: &Task, step: &PlanStep) -> InstanceId {
    text(step, "instance").map_or_else(|| task.target.clone(), Into::into)
}

fn text<'a>(step: &'a PlanStep, argument: &str) -> Option<&'a str> {
    step.args.get(argument).and_then(Value::as_str)
}
