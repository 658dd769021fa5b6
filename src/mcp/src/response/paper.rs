//! Profile `paper`: text, image, execution feedback. Nothing of the simulator's state:
//! no instances, poses, goals.

use reel_live::{CallResult, LiveError, StartedEpisode};
use reel_world::{HORIZON, record::EndReason};
use rmcp::model::{CallToolResult, ContentBlock};
use serde_json::{Value, json};

use super::{COMPLETED, Response, image, task_ids};

pub(super) fn say(said: &Response) -> CallToolResult {
    match said {
        Response::CallMade(made) => call(made),
        Response::EpisodeStarted(begun, _) => briefing(begun),
        Response::Completed => text(COMPLETED),
        Response::Tasks(tasks) => text(&task_ids(tasks)),
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
    let mut markers: Vec<u32> = step.markers.iter().map(|marker| marker.id).collect();
    markers.sort_unstable();
    said["markers"] = json!(markers);
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
    lines.push_str(&format!(
        "\nYou have {HORIZON} decisions. Call 'finish' when the task is done."
    ));
    let entry = |(id, category, room): &_| json!({"id": id, "category": category, "room": room});
    let receptacles: Vec<Value> = briefing.receptacles.iter().map(entry).collect();
    let said = json!({
        "ok": true,
        "text": lines,
        "decisions_left": HORIZON,
        "episode": {"task_id": begun.task.task_id, "instruction": briefing.instruction, "receptacles": receptacles},
    });
    let mut result = CallToolResult::success(vec![ContentBlock::text(lines), image(&begun.frame)]);
    result.structured_content = Some(said);
    result
}

fn text(text: &str) -> CallToolResult {
    let mut result = CallToolResult::success(vec![ContentBlock::text(text)]);
    result.structured_content = Some(json!({"ok": true, "text": text}));
    result
}
