//! An episode as a request: the prompt file, then the robot's own prompt and the record between
//! lines, then what to write.

use std::{ops::Range, sync::Arc};

use reel_llm::client::{Message, Part, Request, Role};
use reel_prompt::{EpisodePrompt, Prompt, SingleTurn};
use reel_world::Digest;
use serde_json::{Map, Value, json};

use super::FrameBefore;
use crate::{
    PrivilegedFacts, PublicTask, Step,
    step::{MarkedItem, ObservedObject},
};

/// What the model is told before it gets a record.
const PROMPT: &str = include_str!("../../prompts/annotate.md");

/// What it is told when nothing in its answer can be read.
pub(super) const RETRY_PROMPT: &str = "Your answer holds no note that can be read. Answer again, with the one JSON array of whole objects and nothing else.";

/// The version of a request: the digest of the annotator's prompt file and of the prompt of the
/// robot that is annotated.
pub fn version(robot: &Prompt) -> Digest {
    Digest::of([PROMPT, &robot.digest().to_string()].concat().as_bytes())
}

/// What the model is asked about a batch of decisions; the steps `shown` before it are part of the
/// record. Of the last one only the call is shown, of later ones nothing. `robot` is the prompt that the robot acts on, shown as it
/// stands at the first decision.
pub(super) fn request(
    robot: &Arc<Prompt>,
    task: &PublicTask,
    steps: &[Step<'_>],
    secrets: &PrivilegedFacts,
    before: Option<&str>,
    (shown, batch): (usize, Range<usize>),
) -> Request {
    let receptacles: Vec<Value> = task
        .receptacles
        .iter()
        .map(|place| json!({"id": place.id, "category": place.category, "room": place.room}))
        .collect();
    let mut record = format!(
        "{}\n",
        json!({"task": task.instruction, "receptacles": receptacles})
    );
    record.push_str(&format!(
        "{}\n",
        json!({"for_your_eyes_only": secrets.truth()})
    ));
    let first_shown = batch.start.saturating_sub(shown);
    for (index, step) in steps[..batch.end].iter().enumerate().skip(first_shown) {
        let over = index + 1 < batch.end;
        record.push_str(&format!("{}\n", line(index, step, secrets, over)));
    }
    let places = task
        .receptacles
        .iter()
        .map(|place| (place.id.as_str(), place.room.as_str()));
    let prompt = SingleTurn::new(Arc::new(EpisodePrompt::new(
        Arc::clone(robot),
        &task.instruction,
        places,
    )))
    .prompt();
    // Nobody who writes into the record knows the digest of all of it.
    let code = Digest::of(record.as_bytes()).short();
    let (first, last) = (batch.start, batch.end - 1);
    let history = before.map_or(String::new(), |history| {
        format!("The history of step {} was: {history}\n\n", first - 1)
    });
    let text = format!(
        "BEGIN PROMPT {code}\n{prompt}\nEND PROMPT {code}\n\nBEGIN RECORD {code}\n{record}END RECORD {code}\n\n{history}Write the notes of steps {first} to {last}: one JSON array of {} objects.",
        batch.len()
    );
    Request {
        messages: vec![
            Message::text(Role::System, PROMPT),
            Message::text(Role::User, text),
        ],
        ..Request::default()
    }
}

/// Adds the image that the robot saw before each decision of a batch, where there was one.
pub(super) fn add_frames(request: &mut Request, batch: Range<usize>, frames: &FrameBefore<'_>) {
    let asked = request
        .messages
        .last_mut()
        .expect("a request ends with what is asked");
    for index in batch {
        if let Some(bytes) = frames(index) {
            asked.parts.push(Part::Text(format!(
                "What the robot saw before step {index}:"
            )));
            asked.parts.push(Part::Image {
                media_type: "image/png".to_owned(),
                bytes,
            });
        }
    }
}

fn line(index: usize, step: &Step<'_>, secrets: &PrivilegedFacts, over: bool) -> Value {
    let mut line = Map::new();
    line.insert("step".into(), json!(index));
    line.insert("tool".into(), json!(step.tool));
    line.insert("argument".into(), json!(step.argument));
    if !over {
        return Value::Object(line);
    }
    line.insert("outcome".into(), json!(step.outcome));
    if let Some(code) = step.error {
        line.insert("error".into(), json!(code.as_str()));
    }
    if let Some(reply) = step.reply {
        line.insert("reply".into(), json!(reply));
    }
    let looks =
        |thing: &ObservedObject<'_>| json!({"category": thing.category, "looks": thing.caption});
    let markers = step.markers.iter().map(|(number, marked)| match marked {
        MarkedItem::Object(thing) => {
            json!({"marker": number, "category": thing.category, "looks": thing.caption, "is_what_is_meant": secrets.is_target(marked)})
        }
        MarkedItem::Receptacle(id) => json!({"marker": number, "receptacle": id}),
    });
    let markers: Vec<Value> = markers.collect();
    if !markers.is_empty() {
        line.insert("markers".into(), Value::Array(markers));
    }
    let numbered = |thing: &&ObservedObject<'_>| {
        step.markers
            .iter()
            .any(|(_, marked)| *marked == MarkedItem::Object(**thing))
    };
    let in_view: Vec<Value> = step
        .visible
        .iter()
        .filter(|thing| step.error.is_none() && !numbered(thing))
        .map(looks)
        .collect();
    if !in_view.is_empty() {
        line.insert("in_view".into(), Value::Array(in_view));
    }
    if let Some(held) = &step.held {
        line.insert("in_hand".into(), looks(held));
    }
    Value::Object(line)
}
