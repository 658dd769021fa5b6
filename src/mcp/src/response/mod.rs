//! What a profile says of what happened: the one place from which anything reaches a policy.

mod paper;
mod payload;
mod published;

use reel_live::{CallResult, LiveError, StartedEpisode};
use reel_world::{Frame, Profile, Scene, Task};
use rmcp::model::{CallToolResult, ContentBlock};
use std::sync::Arc;

/// What came of a request to a session.
pub enum Response {
    /// A call was made.
    CallMade(Box<CallResult>),
    /// An episode began in the given scene.
    EpisodeStarted(Box<StartedEpisode>, Arc<Scene>),
    /// Every task was played.
    Completed,
    /// The ids of the tasks.
    Tasks(Vec<String>),
    /// The rooms and receptacles of the scene, as `list_receptacles` reports them.
    Receptacles(Arc<Scene>),
}

/// What a policy is told.
pub fn tool_result(profile: Profile, said: &Response) -> CallToolResult {
    match profile {
        Profile::Paper => paper::say(said),
        Profile::RealRepo | Profile::RealGspo => published::say(profile, said),
    }
}

/// What a policy is told when a request failed. `tool` is the name it used.
pub fn refuse(profile: Profile, tool: &str, error: &LiveError) -> CallToolResult {
    match profile {
        Profile::Paper => paper::refuse(error),
        Profile::RealRepo | Profile::RealGspo => published::refuse(tool, error),
    }
}

/// A frame as a block of a result: a PNG file in Base64.
pub fn image(frame: &Frame) -> ContentBlock {
    let png = reel_trace::encode_png_fastest(
        &frame.rgb,
        reel_world::FRAME_WIDTH as u32,
        reel_world::FRAME_HEIGHT as u32,
    );
    ContentBlock::image(
        base64::Engine::encode(&base64::engine::general_purpose::STANDARD, png),
        "image/png",
    )
}

fn task_list(tasks: &[String]) -> String {
    serde_json::to_string(tasks).expect("texts are JSON")
}

/// The end text of the published server.
const COMPLETED: &str = "All evaluation episodes completed.";

/// The ids of tasks, in their order.
pub fn task_ids(tasks: &[Arc<Task>]) -> Vec<String> {
    tasks.iter().map(|task| task.task_id.clone()).collect()
}
