//! The published servers (profiles `real-repo` and `real-gspo`) to the letter: which items
//! an answer has, and the debug information that is always the last of them. What a tool
//! says is the outcome's text.

use reel_live::{CallResult, LiveError, PrivilegedState};
use reel_world::{
    Frame, Profile, ToolText,
    record::{Marker, MarkerTarget},
};
use rmcp::model::{CallToolResult, ContentBlock};
use serde_json::{Map, Value, json};

use super::{
    COMPLETED, Response, image,
    payload::{self, OrderedGraph},
    task_list,
};

/// A failure of the domain is text and no protocol error: the trainer would take that
/// for a broken connection.
pub(super) fn say(profile: Profile, said: &Response) -> CallToolResult {
    CallToolResult::success(match said {
        Response::CallMade(made) => call(made),
        Response::EpisodeStarted(begun, scene) => {
            let payload = payload::payload(profile, begun, scene).to_string();
            let taken_over = begun.taken_over.iter();
            let last = taken_over.map(|last| ContentBlock::text(&last.outcome.text));
            [ContentBlock::text(payload)]
                .into_iter()
                .chain(last)
                .collect()
        }
        Response::Completed => vec![ContentBlock::text(COMPLETED)],
        Response::Tasks(tasks) => vec![ContentBlock::text(task_list(tasks))],
        // Only before the first episode; in an episode it is a call like others.
        Response::Receptacles(scene) => {
            let before = json!({
                "CURRENT_LANDMARK": null, "CURRENT_POS": null, "CURRENT_INV": null, "CURRENT_MARKER_MAP": null,
                "world_graph": {}, "WORLD_GRAPH": "",
            });
            vec![
                ContentBlock::text(scene.furniture_listing()),
                image(&Frame::new()),
                debug_text(&before),
            ]
        }
    })
}

pub(super) fn refuse(tool: &str, error: &LiveError) -> CallToolResult {
    let text = ToolText::Exception.text(&[&tool, error]);
    CallToolResult::success(vec![ContentBlock::text(text)])
}

fn call(made: &CallResult) -> Vec<ContentBlock> {
    let outcome = &made.step.outcome;
    let mut content = Vec::new();
    if !outcome.text.is_empty() {
        content.push(ContentBlock::text(&outcome.text));
    }
    if outcome.is_exception() {
        return content;
    }
    content.extend(made.frame.as_ref().or(made.head_frame.as_ref()).map(image));
    content.push(debug_text(&state(&made.view)));
    content
}

fn debug_text(state: &Value) -> ContentBlock {
    ContentBlock::text(format!("Debug Info:\n{state}"))
}

fn state(view: &PrivilegedState) -> Value {
    let name = |target: &MarkerTarget| match target {
        MarkerTarget::Object(object) => object.to_string(),
        MarkerTarget::Receptacle(receptacle) => receptacle.to_string(),
    };
    let map = |markers: &Vec<Marker>| -> Map<String, Value> {
        markers
            .iter()
            .map(|marker| (marker.id.to_string(), Value::from(name(&marker.target))))
            .collect()
    };
    let graph = OrderedGraph::of(&view.objects_by_receptacle, &view.graphs.registry);
    json!({
        "CURRENT_LANDMARK": view.landmark,
        "CURRENT_POS": view.landmark.as_ref().map(|_| view.robot.camera.map(decimal)),
        "CURRENT_INV": view.held,
        "CURRENT_MARKER_MAP": view.markers.as_ref().map(map),
        "world_graph": graph.json(),
        "WORLD_GRAPH": graph.text(),
    })
}

/// A coordinate with the digits it has as a 32-bit number, not those that widening adds.
fn decimal(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(f64::from(value))
}
