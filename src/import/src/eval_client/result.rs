//! What the client reads out of the result of a call.

use serde_json::{Map, Value, json};

/// What a text that holds debug information begins with.
pub(crate) const DEBUG_TEXT: &str = "Debug Info:\n";

/// An item of a result.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Content {
    /// A text item of the result.
    Text(String),
    /// An image, in Base64.
    Image(String),
    /// Of another kind, which the client passes over.
    Other,
}

/// A result as the agent gets it.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct ToolResult {
    /// The texts, a line each; `None` if the result is images alone.
    pub text: Option<String>,
    /// Every image, in Base64.
    pub images: Vec<String>,
    /// The last debug information; what is no JSON object is under `raw`.
    pub debug: Map<String, Value>,
}

impl ToolResult {
    /// Reads the items of a result.
    pub fn of(content: &[Content]) -> Self {
        let mut result = Self::default();
        let mut texts: Vec<&str> = Vec::new();
        for item in content {
            match item {
                Content::Text(text) => match text.strip_prefix(DEBUG_TEXT) {
                    Some(debug) => result.debug = debug_info(debug),
                    None => texts.push(text),
                },
                Content::Image(image) => result.images.push(image.clone()),
                Content::Other => {}
            }
        }
        if !texts.is_empty() || result.images.is_empty() {
            result.text = Some(texts.join("\n").trim().to_owned());
        }
        result
    }
}

fn debug_info(text: &str) -> Map<String, Value> {
    match serde_json::from_str(text) {
        Ok(Value::Object(debug)) => debug,
        _ => Map::from_iter([("raw".to_owned(), json!(text))]),
    }
}
