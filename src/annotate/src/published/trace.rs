//! Traces in the published forms: the stream of events, the episode, and notes as the
//! answers of a model.

use reel_trace::Trace;
use reel_world::{
    Tool, ToolCall,
    record::{MarkerTarget, StepRecord},
};
use serde_json::{Map, Value, json};

use super::{
    answer::Thought,
    record::{Episode, StreamStep, TaskMeta},
};
use crate::Annotation;

/// `<n>_meta.json` of a trace.
pub fn meta(trace: &Trace) -> TaskMeta {
    let task = &trace.task;
    let names = |ids: &[reel_world::ReceptacleId]| ids.iter().map(ToString::to_string).collect();
    TaskMeta {
        task_description: task.instruction.clone(),
        src: task.src.to_string(),
        dest: task.dest.to_string(),
        src_distractors: names(&task.src_distractors),
        dest_distractors: names(&task.dest_distractors),
    }
}

/// The stream of events of a trace: the description of the episode, then each action with its
/// error, if it failed, and its observation. The payload of an observation is its text, or the path
/// of its image if it is an image alone. The final `finish` is not in it.
pub fn events(trace: &Trace, episode: &Episode) -> Vec<Value> {
    let mut events = vec![json!({ "episode_id": episode.id(), "trace": trace.header.episode_id })];
    for (index, (record, step)) in played(trace).iter().zip(&episode.steps).enumerate() {
        let (name, payload) = step.action.iter().next().expect("an action has a name");
        events.push(json!({ "action": name, "payload": payload }));
        if record.outcome.error.is_some() {
            events.push(json!({ "action": "error", "payload": record.outcome.text }));
        }
        let shown = episode
            .image_path(index + 1)
            .filter(|_| step.text.is_empty());
        events.push(
            json!({ "action": "obs", "payload": shown.unwrap_or_else(|| step.text.clone()) }),
        );
    }
    events
}

/// A trace as an episode of the annotation. A step shows an image where the trace holds one.
pub fn episode(trace: &Trace, number: u32, eval_subset: Option<String>) -> Episode {
    let steps = played(trace).iter().map(|record| StreamStep {
        action: action(record, markers_before(trace, record)),
        text: record.outcome.text.clone(),
        image: trace.image(Some(record.step)).is_some(),
    });
    Episode {
        number,
        model_name: Some(trace.header.policy.name.clone()),
        eval_subset,
        task: meta(trace),
        steps: steps.collect(),
    }
}

/// The notes of a trace as a model's answers, one a record: each says what its action rests on, and
/// as History the result of the action before it. Records without a note have an empty answer.
pub fn answers(notes: &[Annotation]) -> Vec<String> {
    let answer = |(index, note): (usize, &Annotation)| {
        // The first History says that nothing was done yet.
        let before = if index > 1 {
            notes[index - 1].history.as_str()
        } else {
            ""
        };
        let last = note
            .history
            .strip_prefix(before)
            .unwrap_or(&note.history)
            .trim();
        let items = note.schedule.split("->").flat_map(|part| part.split(';'));
        let items = items.map(|item| {
            item.trim()
                .trim_start_matches(|letter: char| letter.is_ascii_digit())
                .trim_start_matches(". ")
        });
        let schedule: Vec<String> = items
            .filter(|item| !item.is_empty())
            .map(str::to_owned)
            .collect();
        let thought = Thought {
            reasoning: note.reasoning.clone(),
            history: if index == 0 {
                String::new()
            } else {
                last.to_owned()
            },
            schedule: (!schedule.is_empty()).then_some(schedule),
            subtask: note.subtask.clone(),
            last_action: None,
        };
        thought.to_json().to_string()
    };
    notes.iter().enumerate().map(answer).collect()
}

/// The steps but for a final `finish`.
fn played(trace: &Trace) -> &[StepRecord] {
    match trace.steps.split_last() {
        Some((last, before)) if last.tool_name() == "finish" => before,
        _ => &trace.steps,
    }
}

/// What the numbers stood for when a step was decided.
fn markers_before<'a>(trace: &'a Trace, record: &StepRecord) -> &'a [reel_world::record::Marker] {
    let before = record
        .step
        .checked_sub(1)
        .and_then(|index| trace.steps.get(index as usize));
    before.map_or(&[], |before| before.markers.as_slice())
}

/// A call under the tool's old name, `{tool: arguments}`; doors are named by their receptacle where
/// the number is known. A call that is none of the tools stands as it was made.
fn action(record: &StepRecord, markers: &[reel_world::record::Marker]) -> Map<String, Value> {
    let ToolCall { name, arguments } = &record.input.call;
    let tool = Tool::parse(&record.input.call).ok();
    let payload = match &tool {
        Some(Tool::Open { marker } | Tool::Close { marker }) => {
            let target = markers
                .iter()
                .find(|known| known.id == *marker)
                .map(|known| &known.target);
            match target {
                Some(MarkerTarget::Receptacle(receptacle)) => {
                    json!({ "receptacle_name": receptacle })
                }
                _ => arguments.clone(),
            }
        }
        Some(Tool::Ask { .. }) => json!({ "question": question(arguments) }),
        _ => arguments.clone(),
    };
    let name = match &tool {
        Some(tool) => tool.paper_name(),
        None => name.as_str(),
    };
    Map::from_iter([(name.to_owned(), payload)])
}

/// What a question asks, of whatever arguments.
fn question(arguments: &Value) -> String {
    let texts = arguments
        .as_object()
        .into_iter()
        .flat_map(|map| map.values())
        .filter_map(Value::as_str);
    texts.collect::<Vec<_>>().join(" - ")
}
