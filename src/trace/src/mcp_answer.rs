//! What MCP servers answered, as it came: beside the records of episodes that were recorded between an
//! agent and its server, so that a recording can answer in the server's place.

use std::collections::BTreeMap;

use serde_json::Value;

use crate::schema::reel;

/// Which request of a recorded session an answer is to.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum AnsweredRequest {
    /// The last `tools/list` before the episode began.
    ToolList,
    /// The call that began the episode, and is no step of it.
    Start,
    /// The call of a step.
    Step(u32),
}

/// The answers of a recorded session by their requests: JSON objects with one member, `result` or
/// `error`, as the server sent it.
pub type McpAnswers = BTreeMap<AnsweredRequest, String>;

const CALL: &str = "tools/call";
const LIST: &str = "tools/list";

impl AnsweredRequest {
    /// The step it belongs to; `None` before the first.
    pub(crate) fn step(self) -> Option<u32> {
        match self {
            Self::ToolList | Self::Start => None,
            Self::Step(step) => Some(step),
        }
    }

    fn method(self) -> &'static str {
        match self {
            Self::ToolList => LIST,
            Self::Start | Self::Step(_) => CALL,
        }
    }
}

/// The message of an answer.
pub(crate) fn message(request: AnsweredRequest, json: &str) -> reel::McpAnswer {
    reel::McpAnswer {
        step: request.step(),
        method: request.method().to_owned(),
        json: json.to_owned(),
    }
}

/// The request that a message answers; `None` if it is of another method.
pub(crate) fn request(message: &reel::McpAnswer) -> Option<AnsweredRequest> {
    match (message.method.as_str(), message.step) {
        (LIST, None) => Some(AnsweredRequest::ToolList),
        (CALL, None) => Some(AnsweredRequest::Start),
        (CALL, Some(step)) => Some(AnsweredRequest::Step(step)),
        _ => None,
    }
}

/// Whether an answer holds an image, which a trace without images does not keep.
pub(crate) fn has_image(json: &str) -> bool {
    let answer: Value = serde_json::from_str(json).unwrap_or_default();
    let content = answer.pointer("/result/content").and_then(Value::as_array);
    let mut items = content.into_iter().flatten();
    items.any(|item| item.get("type").is_some_and(|kind| kind == "image"))
}
