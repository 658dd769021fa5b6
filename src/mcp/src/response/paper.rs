//! Profile `paper`: text, image, execution feedback. Nothing of the simulator's state:
//! no instances, poses, goals.

use reel_live::{CallResult, LiveError, StartedEpisode};
use reel_world::{
    HORIZON,
    record::{EndReason, StepRecord},
};
use rmcp::model::{CallToolResult, ContentBlock};
use serde_json::{Value, json};

use super::{COMPLETED, Response, image, task_list};

pub(super) fn say(said: &Response) -> CallToolResult {
    match said {
        Response::CallMade(made) => call(made),
        Response::EpisodeStarted(begun, _) => briefing(begun),
        Response::Completed => text(COMPLETED),
        Response::Tasks(tasks) => text(&task_list(tasks)),
        Response::Receptacles(scene) => text(&scene.room_listing()),
    }
}

pub(super) fn refuse(error: &LiveError) -> CallToolResult {
    let code = match error {
        LiveError::NoEpisode => "no_episode",
        LiveError::Over(_) => "episode_over",
        LiveError::Overtaken => "overtaken",
        LiveError::UnknownTask(_) => "unknown_task",
        LiveError::Busy(_) | LiveError::NoLookUp | LiveError::NoUser => "busy",
        LiveError::Broken(_) | LiveError::Recording(_) => "broken",
        _ => "refused",
    };
    let text = error.to_string();
    let mut result = CallToolResult::error(vec![ContentBlock::text(text.clone())]);
    result.structured_content = Some(json!({"ok": false, "text": text, "error": {"code": code}}));
    result
}

fn call(made: &CallResult) -> CallToolResult {
    let (step, outcome) = (&made.step, &made.step.outcome);
    let mut said = json!({"ok": outcome.is_ok(), "text": outcome.text});
    if let Some(code) = outcome.error {
        said["error"] = json!({"code": code, "class": code.class()});
    }
    said["markers"] = json!(marker_ids(step));
    said["decision"] = json!(step.step + 1);
    said["decisions_left"] = json!(if made.ended.is_some() {
        0
    } else {
        HORIZON.saturating_sub(step.step + 1)
    });
    let mut text = outcome.text.clone();
    if let Some(reason) = made.ended {
        said["ended"] = json!(reason);
        if reason != EndReason::Finished {
            text.push_str("\nThe episode is over. Call 'finish' to begin the next one.");
        }
    }
    let mut content = vec![ContentBlock::text(text)];
    content.extend(made.frame.as_ref().map(image));
    let mut result = if outcome.is_ok() {
        CallToolResult::success(content)
    } else {
        CallToolResult::error(content)
    };
    result.structured_content = Some(said);
    result
}

fn briefing(begun: &StartedEpisode) -> CallToolResult {
    let briefing = &begun.briefing;
    let mut lines = format!("Task: {}\n\nReceptacles:\n", briefing.instruction);
    for (id, category, room) in &briefing.receptacles {
        lines.push_str(&format!("  - {id} ({category}) in {room}\n"));
    }
    let before = begun.taken_over.as_ref().map_or(0, |last| last.step + 1);
    let left = HORIZON.saturating_sub(before);
    lines.push_str(&format!(
        "\nYou have {left} decisions. Call 'finish' when the task is done."
    ));
    if let Some(last) = &begun.taken_over {
        let (call, text) = (&last.input.call, &last.outcome.text);
        lines.push_str(&format!(
            "\n\n{before} decisions were made before. The last was {call}:\n{text}"
        ));
    }
    let entry = |(id, category, room): &_| json!({"id": id, "category": category, "room": room});
    let receptacles: Vec<Value> = briefing.receptacles.iter().map(entry).collect();
    let mut said = json!({
        "ok": true,
        "text": lines,
        "decisions_left": left,
        "episode": {"task_id": begun.task.task_id, "instruction": briefing.instruction, "receptacles": receptacles},
    });
    if let Some(last) = &begun.taken_over {
        said["decision"] = json!(before);
        said["markers"] = json!(marker_ids(last));
    }
    let mut result = CallToolResult::success(vec![ContentBlock::text(lines), image(&begun.frame)]);
    result.structured_content = Some(said);
    result
}

/// The numbers of the marker map after a call, in their order.
fn marker_ids(step: &StepRecord) -> Vec<u32> {
    let mut ids: Vec<u32> = step.markers.iter().map(|marker| marker.id).collect();
    ids.sort_unstable();
    ids
}

fn text(text: &str) -> CallToolResult {
    let mut result = CallToolResult::success(vec![ContentBlock::text(text)]);
    result.structured_content = Some(json!({"ok": true, "text": text}));
    result
}
