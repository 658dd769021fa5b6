//! The conversation of the published agent for OpenAI-compatible endpoints.
//! Builds messages; sends nothing.

use serde_json::{Map, Value, json};

use crate::{
    PromptWording,
    python::{self, Ascii},
};

/// Images that go with a request: the last ones of the latest results.
const IMAGES_MAX: usize = 2;

/// A conversation, from the task on.
#[derive(Clone, PartialEq, Debug)]
pub struct VlmConversation<'w> {
    wording: &'w PromptWording,
    messages: Vec<Value>,
    images: Vec<String>,
}

/// What an answer of the endpoint comes to.
#[derive(Clone, PartialEq, Debug)]
pub struct VlmDecision {
    /// The tool; `None` if the answer calls none.
    pub tool_name: Option<String>,
    /// The arguments; empty where they do not read as an object.
    pub arguments: Map<String, Value>,
    /// Id of the tool call that is answered, as the endpoint gave it.
    pub tool_call_id: Option<String>,
    /// The answer as the agent files it.
    pub raw_response: Value,
}

impl<'w> VlmConversation<'w> {
    /// The system message and the task; `scene` as [`super::agent_scene`] writes it.
    pub fn new(task: &str, scene: &str, wording: &'w PromptWording) -> Self {
        let scene = if scene.is_empty() {
            String::new()
        } else {
            format!("{}{scene}", wording.vlm_scene_heading)
        };
        let system = format!("{}{scene}", wording.vlm_system);
        let messages = vec![
            json!({"role": "system", "content": system}),
            json!({"role": "user", "content": format!("{}{task}", wording.vlm_task)}),
        ];
        Self {
            wording,
            messages,
            images: Vec::new(),
        }
    }

    /// The messages of the next request: the conversation, and the latest images, which
    /// stay out of it.
    pub fn request(&self) -> Vec<Value> {
        let mut messages = self.messages.clone();
        if !self.images.is_empty() {
            let part = |image: &String| json!({"type": "image_url", "image_url": {"url": format!("data:image/png;base64,{image}")}});
            messages.push(json!({"role": "user", "content": self.images.iter().map(part).collect::<Vec<_>>()}));
        }
        messages
    }

    /// Takes in an answer: only its first call is kept and run.
    pub fn answer(&mut self, content: Value, calls: &[Value]) -> VlmDecision {
        let filed = |call: &Value| {
            let arguments = match &call["function"]["arguments"] {
                arguments @ Value::Object(_) => python::dumps(arguments, Ascii::Escaped).into(),
                other => other.clone(),
            };
            let function = json!({"name": call["function"]["name"], "arguments": arguments});
            json!({"id": call["id"], "type": "function", "function": function})
        };
        let filed: Vec<Value> = calls.iter().map(filed).collect();
        let raw_response = json!({"role": "assistant", "content": content, "tool_calls": filed});
        let mut kept = json!({"role": "assistant", "content": content});
        let Some(call) = calls.first() else {
            self.messages.push(kept);
            self.messages
                .push(json!({"role": "user", "content": self.wording.vlm_call_a_tool}));
            return VlmDecision {
                tool_name: None,
                arguments: Map::new(),
                tool_call_id: None,
                raw_response,
            };
        };
        kept["tool_calls"] = json!([filed[0]]);
        self.messages.push(kept);
        let arguments = match &call["function"]["arguments"] {
            Value::String(text) => {
                python::loads(if text.is_empty() { "{}" } else { text }).unwrap_or_default()
            }
            other => other.clone(),
        };
        let text = |value: &Value| value.as_str().map(str::to_owned);
        VlmDecision {
            tool_name: text(&call["function"]["name"]),
            arguments: arguments.as_object().cloned().unwrap_or_default(),
            tool_call_id: text(&call["id"]),
            raw_response,
        }
    }

    /// Takes in a result: its text (`None` if it holds images and no text) and
    /// its images in base64.
    pub fn observe(&mut self, tool_call_id: &str, text: Option<&str>, images: &[String]) {
        let content = match text {
            None => &self.wording.vlm_image_follows,
            Some("") => &self.wording.vlm_empty_result,
            Some(text) => text,
        };
        self.messages
            .push(json!({"role": "tool", "tool_call_id": tool_call_id, "content": content}));
        self.images.extend(images.last().cloned());
        let excess = self.images.len().saturating_sub(IMAGES_MAX);
        self.images.drain(..excess);
    }

    /// How many images the next request holds.
    pub fn images(&self) -> usize {
        self.images.len()
    }
}
