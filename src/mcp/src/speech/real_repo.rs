//! Profile `real-repo`: the published server to the letter (SPEC section 9), its debug information included.

use std::collections::BTreeMap;

use reel_live::{Begun, LiveError, Made, View};
use reel_world::{
    DoorState, ErrorCode, InstanceId, Scene, Task, WorldGraph,
    record::{MarkerTarget, UserSource},
};
use rmcp::model::{CallToolResult, ContentBlock};
use serde_json::{Map, Value, json};

use super::{COMPLETED, Said, picture, task_ids};

/// Tools whose success is told in words; all others answer with the picture alone.
const WORDS: [&str; 3] = ["walk_around", "ask", "list_receptacles"];

/// A failure of the domain is text and no protocol error: the trainer would take that for a broken connection.
pub(super) fn say(said: &Said, json: bool) -> CallToolResult {
    CallToolResult::success(match said {
        Said::Made(made) => call(made, json),
        Said::Begun(begun, scene) => {
            vec![ContentBlock::text(payload(begun, scene).to_string()), picture(&begun.frame), debug_info(&begun.view)]
        }
        Said::Completed => vec![ContentBlock::text(COMPLETED)],
        Said::Tasks(tasks) => vec![ContentBlock::text(task_ids(tasks))],
        Said::Receptacles(scene) => vec![ContentBlock::text(scene.room_listing())],
    })
}

pub(super) fn refuse(tool: &str, error: &LiveError) -> CallToolResult {
    CallToolResult::success(vec![ContentBlock::text(format!("Error executing {tool}: {error}"))])
}

fn call(made: &Made, json: bool) -> Vec<ContentBlock> {
    let (step, outcome) = (&made.step, &made.step.outcome);
    let tool = step.tool.as_deref();
    let in_json = json && step.input.call.name == "ask";
    if outcome.error == Some(ErrorCode::BadArguments) && !in_json {
        // The published server stumbles over it.
        return vec![ContentBlock::text(format!("Error executing {}: {}", step.input.call.name, outcome.text))];
    }
    let mut content = Vec::new();
    if !outcome.is_ok() || tool.is_some_and(|tool| WORDS.contains(&tool)) {
        content.push(ContentBlock::text(if in_json { answer(made) } else { text(made) }));
    }
    content.extend(made.frame.as_ref().or(made.look.as_ref()).map(picture));
    content.push(debug_info(&made.view));
    content
}

/// What the tool says. Where the simulator's text names what a number stands for or what is held by what the paper's policy may
/// know of it, the published server names the instance.
fn text(made: &Made) -> String {
    let (step, outcome, view) = (&made.step, &made.step.outcome, &made.view);
    match (outcome.error, &view.held) {
        (Some(ErrorCode::AlreadyHolding), Some(held)) => {
            format!("You are already holding '{held}'. Place it before picking another object.")
        }
        (Some(ErrorCode::NotASurface), _) => {
            let number = step.input.call.arguments.get("marker_id").map(|number| number.to_string().replace('"', ""));
            let marker = view.markers.iter().find(|marker| number.as_deref() == Some(&marker.id.to_string()));
            match marker.map(|marker| &marker.target) {
                Some(MarkerTarget::Object(object)) => format!("'{object}' is not a valid placement surface."),
                _ => outcome.text.clone(),
            }
        }
        _ => outcome.text.clone(),
    }
}

/// What the user said, as the published server says it.
fn answer(made: &Made) -> String {
    let step = &made.step;
    let Some(reply) = &step.reply else {
        return json!({"error": "target_category and target_description must be non-empty", "source": "task_metadata"})
            .to_string();
    };
    let source = match reply.source {
        UserSource::RuleBased => "task_metadata",
        UserSource::Model => "model",
        UserSource::Human => "human",
    };
    let category = step.input.call.arguments.get("target_category").and_then(Value::as_str).unwrap_or_default();
    json!({"target_category": category, "target_description": reply.text, "source": source}).to_string()
}

/// What is known when an episode begins.
fn payload(begun: &Begun, scene: &Scene) -> Value {
    let task = &begun.task;
    let target = task.target_object();
    let mut rooms: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for receptacle in &scene.receptacles {
        rooms.entry(&receptacle.room).or_default().push(receptacle.id.as_str());
    }
    json!({
        "task_id": task.task_id,
        "benchmark_task_id": task.task_id,
        "family": task.family,
        "global_index": begun.index,
        "episode_idx": begun.number,
        "episode_local_idx": begun.number,
        "episode_range": [0, begun.of],
        "task_description": task.instruction,
        "scene_id": task.scene_id,
        "rooms_and_furniture": rooms,
        "initial_world_graph": graph(&task.initial),
        "target_world_graph": graph(&target_graph(task)),
        "target_object": {"id": target.asset, "name": target.instance, "category": target.category},
        "source_furniture": task.src,
        "destination_furniture": task.dest,
        "source_distractors": task.src_distractors,
        "destination_distractors": task.dest_distractors,
        "object_distractors": task.object_distractors,
        "distractor_metadata": task.extra.get("distractor_metadata").cloned().unwrap_or_else(|| json!({})),
        "execution_plan": task.plan,
    })
}

/// The start with the target moved: what the published server scores, the file's own goal does not always conserve objects.
fn target_graph(task: &Task) -> WorldGraph {
    let mut graph = task.initial.clone();
    graph.remove(&task.src, &task.target);
    graph.add(&task.dest, &task.target);
    graph
}

/// `{receptacle: {content: [instance], door: bool}}`; a door is `true` where it is open.
fn graph(graph: &WorldGraph) -> Value {
    let state = |state: &reel_world::ReceptacleState| {
        let mut entry = Map::new();
        let instances = state.content.iter().flat_map(|(object, count)| std::iter::repeat_n(object, *count as usize));
        entry.insert("content".to_owned(), json!(instances.collect::<Vec<&InstanceId>>()));
        if let Some(door) = state.door {
            entry.insert("door".to_owned(), json!(door == DoorState::Open));
        }
        Value::Object(entry)
    };
    graph.receptacles.iter().map(|(receptacle, of)| (receptacle.to_string(), state(of))).collect::<Map<_, _>>().into()
}

/// The same in the form of its older log: a line for each receptacle that holds something.
fn summary(graph: &WorldGraph) -> String {
    let line = |(receptacle, state): (&reel_world::ReceptacleId, &reel_world::ReceptacleState)| {
        let instances = state.content.iter().flat_map(|(object, count)| std::iter::repeat_n(object, *count as usize));
        let objects: Vec<String> = instances.map(|object| format!("'{object}'")).collect();
        (!objects.is_empty()).then(|| format!("{receptacle}: [{}]\n", objects.join(", ")))
    };
    graph.receptacles.iter().filter_map(line).collect()
}

/// `Debug Info:` and the state, always the last item.
fn debug_info(view: &View) -> ContentBlock {
    let marker = |target: &MarkerTarget| match target {
        MarkerTarget::Object(object) => object.to_string(),
        MarkerTarget::Receptacle(receptacle) => receptacle.to_string(),
    };
    let markers: Map<String, Value> =
        view.markers.iter().map(|it| (it.id.to_string(), Value::from(marker(&it.target)))).collect();
    let registry = &view.graphs.registry;
    let state = json!({
        "CURRENT_LANDMARK": view.landmark,
        "CURRENT_POS": view.robot.base,
        "CURRENT_INV": view.held,
        "CURRENT_MARKER_MAP": markers,
        "world_graph": graph(registry),
        "WORLD_GRAPH": summary(registry),
    });
    ContentBlock::text(format!("Debug Info:\n{state}"))
}
