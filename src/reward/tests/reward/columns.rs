//! An episode as its table columns hold it, turned into facts from its texts alone: what whoever
//! reads tables has to do.

use std::collections::BTreeSet;

use reel_reward::{Authority, EpisodeFacts, MarkerReferent, StepHead, TaskFacts};
use reel_world::{
    DoorState, ErrorClass, GraphEvent, Task,
    record::{GraphChanges, MarkerTarget, StartRecord, StepRecord},
};

/// A row of `changes`.
struct ChangeRow {
    authority: &'static str,
    event: &'static str,
    object: Option<String>,
    receptacle: String,
    door_from: Option<String>,
    door_to: Option<String>,
}

/// One step, or the start, as texts and numbers.
#[derive(Default)]
struct StepRow {
    tool: String,
    error_code: Option<String>,
    error_class: Option<String>,
    argument: Option<String>,
    object: Option<String>,
    receptacle: Option<String>,
    held: Option<String>,
    reply: Option<String>,
    text: String,
    changes: Vec<ChangeRow>,
    /// Objects seen or told for the first time.
    seen: Vec<String>,
    /// The marker map where the call set it: number, kind, id.
    markers: Option<Vec<(u32, &'static str, String)>>,
}

/// The facts of an episode by way of its columns.
pub fn facts_from_columns(
    facts: &mut TaskFacts,
    task: &Task,
    start: &StartRecord,
    steps: &[StepRecord],
) -> EpisodeFacts {
    let rows = columns(task, start, steps);
    let mut episode = EpisodeFacts::default();
    facts.begin(&mut episode);
    for (index, row) in rows.iter().enumerate() {
        if index > 0 {
            let call = facts.head_of_call(
                &row.tool,
                row.error_code.as_deref(),
                row.argument.as_deref(),
            );
            let head = StepHead {
                trainer_reading: facts.trainer_reading(&call, &row.text),
                error: row.error_class.as_deref().map(|class| match class {
                    "severe" => ErrorClass::Severe,
                    _ => ErrorClass::Moderate,
                }),
                object: row.object.as_deref().map(|object| facts.object(object)),
                receptacle: row
                    .receptacle
                    .as_deref()
                    .map(|place| facts.receptacle(place)),
                held: row.held.as_deref().map(|object| facts.object(object)),
                reply: row.reply.as_deref().map(|text| facts.text(text)),
                ..call
            };
            episode.step(head);
        }
        for change in &row.changes {
            let authority = if change.authority == "physics" {
                Authority::Physics
            } else {
                Authority::Registry
            };
            let (from, to) = (change.door_from.as_deref(), change.door_to.as_deref());
            let change = facts.change(
                change.event,
                change.object.as_deref(),
                &change.receptacle,
                from,
                to,
            );
            episode.change(authority, change.expect("a row of ours is a change"));
        }
        for object in &row.seen {
            episode.push_visible(facts.object(object));
        }
        if let Some(markers) = &row.markers {
            episode.set_markers();
            for (number, kind, id) in markers {
                let target = if *kind == "object" {
                    MarkerReferent::Object(facts.object(id))
                } else {
                    MarkerReferent::Receptacle(facts.receptacle(id))
                };
                episode.mark(*number, target);
            }
        }
    }
    episode
}

/// The first row is the start.
fn columns(task: &Task, start: &StartRecord, steps: &[StepRecord]) -> Vec<StepRow> {
    let mut known = BTreeSet::new();
    let graphs = &start.graphs;
    let changes = GraphChanges {
        physics: graphs.physics.difference(&task.initial),
        registry: graphs.registry.difference(&task.initial),
    };
    let visible = start.visible.iter().map(|seen| seen.object.to_string());
    let seen = visible
        .filter(|object| known.insert(object.clone()))
        .collect();
    let mut rows = vec![StepRow {
        changes: change_rows(&changes),
        seen,
        ..StepRow::default()
    }];
    let mut map = Vec::new();
    for step in steps {
        let shown = step
            .visible
            .iter()
            .map(|seen| &seen.object)
            .chain(&step.listed)
            .map(ToString::to_string);
        let arguments = &step.input.call.arguments;
        let argument = arguments
            .get("receptacle_name")
            .or(arguments.get("marker_id"));
        rows.push(StepRow {
            tool: step.tool_name().to_owned(),
            error_code: step.outcome.error.map(|code| code.to_string()),
            error_class: step.outcome.error.map(|code| match code.class() {
                ErrorClass::Severe => "severe".to_owned(),
                ErrorClass::Moderate => "moderate".to_owned(),
            }),
            argument: argument.map(|value| {
                value
                    .as_str()
                    .map_or_else(|| value.to_string(), str::to_owned)
            }),
            object: step.object.as_ref().map(ToString::to_string),
            receptacle: step.receptacle.as_ref().map(ToString::to_string),
            held: step.held.as_ref().map(ToString::to_string),
            reply: step.reply.as_ref().map(|reply| reply.text.clone()),
            text: step.outcome.text.clone(),
            changes: change_rows(&step.changes),
            seen: shown
                .filter(|object| known.insert(object.clone()))
                .collect(),
            markers: (step.markers != map).then(|| {
                step.markers
                    .iter()
                    .map(|marker| match &marker.target {
                        MarkerTarget::Object(id) => (marker.id, "object", id.to_string()),
                        MarkerTarget::Receptacle(id) => (marker.id, "receptacle", id.to_string()),
                    })
                    .collect()
            }),
        });
        map.clone_from(&step.markers);
    }
    rows
}

fn change_rows(changes: &GraphChanges) -> Vec<ChangeRow> {
    let of = |authority, events: &[GraphEvent]| -> Vec<ChangeRow> {
        events
            .iter()
            .map(|event| change_row(authority, event))
            .collect()
    };
    let mut rows = of("registry", &changes.registry);
    rows.extend(of("physics", &changes.physics));
    rows
}

fn change_row(authority: &'static str, event: &GraphEvent) -> ChangeRow {
    let name = |state: &DoorState| Some(state.to_string());
    let (event_name, door_from, door_to) = match event {
        GraphEvent::Add { .. } => ("add", None, None),
        GraphEvent::Remove { .. } => ("remove", None, None),
        GraphEvent::Door { from, to, .. } => ("door", name(from), name(to)),
    };
    let (object, receptacle) = (
        event.object().map(ToString::to_string),
        event.receptacle().to_string(),
    );
    ChangeRow {
        authority,
        event: event_name,
        object,
        receptacle,
        door_from,
        door_to,
    }
}
