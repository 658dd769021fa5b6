//! The sentence that says why a step decided, from the records and the measured losses. Never a
//! measurement of its own.

use std::collections::BTreeMap;

use reel_trace::Trace;
use reel_world::{InstanceId, Task, Tool, record::StepRecord};

use crate::blame::{
    Cause, Harm,
    cost::DecisionPoint,
    decide::{is_skill_failure, losses},
};

/// Repetitions of a call that are worth a word.
const REPEATED: usize = 3;

/// Why the step did harm, in a sentence.
pub(super) fn explanation(
    trace: &Trace,
    moments: &[DecisionPoint],
    record: &StepRecord,
    harm: Harm,
    cause: Cause,
) -> String {
    let step = record.step as usize;
    match harm {
        Harm::World => world(trace, record, cause),
        Harm::Ending => {
            let (cost, left) = (moments[step].cost, moments[step].budget);
            match cost.filter(|cost| *cost <= left) {
                Some(needed) => format!(
                    "it ended the episode with {left} decisions left, of which {needed} were enough to succeed for sure"
                ),
                None => format!(
                    "it ended the episode with {left} decisions left, in which success was still possible"
                ),
            }
        }
        Harm::Time => time(trace, moments, step),
    }
}

fn world(trace: &Trace, record: &StepRecord, cause: Cause) -> String {
    let task = &trace.task;
    let (target, wanted) = (
        name(task, &task.target),
        task.goal.receptacle_of(&task.target).unwrap_or(&task.dest),
    );
    let (tool, object, receptacle) = (
        record.tool_name(),
        record.object.as_ref(),
        record.receptacle.as_ref(),
    );
    match (tool, object, receptacle) {
        ("pick", Some(object), _) if *object == task.target => format!(
            "it took what was meant, {target}, at a moment at which it could only put it down again"
        ),
        ("pick", Some(object), _) => format!(
            "it took {}; meant was {target}{}",
            name(task, object),
            difference(trace, record, object, cause)
        ),
        ("place", Some(object), Some(receptacle)) if *object == task.target => {
            format!("it put {target} on {receptacle}; it belongs on {wanted}")
        }
        ("place", Some(object), Some(receptacle)) => format!(
            "it left {} on {receptacle}, where it does not belong",
            name(task, object)
        ),
        (_, _, Some(receptacle)) => {
            format!("after it more was left to do: {tool} at {receptacle}")
        }
        _ => format!("after it more was left to do: {tool}"),
    }
}

/// How the taken object could have been told from the meant one.
fn difference(trace: &Trace, record: &StepRecord, object: &InstanceId, cause: Cause) -> String {
    let task = &trace.task;
    match cause {
        Cause::Communication => {
            let asked = trace.steps[..record.step as usize].iter().any(|step| {
                step.outcome.error.is_none()
                    && matches!(Tool::parse(&step.input.call), Ok(Tool::Ask { .. }))
            });
            match asked {
                true => ", and the answers that it had did not tell them apart",
                false => ", and it asked nobody although several things fitted",
            }
            .to_owned()
        }
        Cause::Perception => {
            let place = |id: &InstanceId| task.initial.receptacle_of(id);
            match (
                name(task, object) == name(task, &task.target),
                place(object),
                place(&task.target),
            ) {
                (true, Some(one), Some(other)) if one != other => {
                    format!(", which looks the same and stood on {other}, not on {one}")
                }
                (true, ..) => ", which looks the same".to_owned(),
                (false, ..) => ", which looks different".to_owned(),
            }
        }
        Cause::Memory | Cause::Primitive | Cause::Other => String::new(),
    }
}

fn time(trace: &Trace, moments: &[DecisionPoint], step: usize) -> String {
    let rest = &trace.steps[step..];
    let lost = losses(trace, moments)[step..]
        .iter()
        .filter(|lost| **lost > 0)
        .count();
    let due = moments[step].advice.to_call();
    let mut sentence = match rest.len() {
        1 => format!("it brought nothing nearer; {due} was next"),
        calls => {
            format!("{lost} of the {calls} calls from here on brought it no nearer; {due} was next")
        }
    };
    let failed = rest
        .iter()
        .filter(|step| step.outcome.error.is_some())
        .count();
    let skills = rest.iter().filter(|step| is_skill_failure(step)).count();
    if skills > 0 {
        sentence += &format!("; a skill of the robot failed {skills} times");
    } else if failed >= REPEATED {
        sentence += &format!("; {failed} calls failed");
    }
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for step in rest {
        *counts.entry(step.input.call.to_string()).or_default() += 1;
    }
    let most = counts.into_iter().max_by_key(|(_, count)| *count);
    if let Some((call, count)) = most.filter(|(_, count)| *count >= REPEATED) {
        sentence += &format!("; it called {call} {count} times");
    }
    sentence
}

/// An object as its caption or category names it.
fn name(task: &Task, id: &InstanceId) -> String {
    match task.object(id) {
        None => id.to_string(),
        Some(known) => match &known.caption {
            Some(caption) => format!("the {}", caption.trim_end_matches('.').to_lowercase()),
            None => format!("the {}", known.category),
        },
    }
}
