//! Messages on spans, as the conventions for generative AI, OpenInference, OpenLLMetry and OpenAI write them.

use std::collections::BTreeMap;

use serde_json::{Map, Value};

use crate::atif::{Content, Media, Part, words_of};

/// How references begin that Reel wrote itself.
const DIGEST: &str = "blake3:";

/// A message of a conversation.
#[derive(Clone, PartialEq, Debug, Default)]
pub(super) struct Message {
    pub(super) role: String,
    pub(super) parts: Vec<Part>,
    pub(super) reasoning: String,
    pub(super) calls: Vec<ToolRequest>,
    pub(super) responses: Vec<ToolResponse>,
    /// What it names and does not hold, or holds and is not read.
    pub(super) left_out: Vec<String>,
}

/// A call that a message asks for.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct ToolRequest {
    pub(super) id: Option<String>,
    pub(super) name: String,
    pub(super) arguments: Value,
}

/// The result of a call in a message.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct ToolResponse {
    pub(super) id: Option<String>,
    pub(super) content: Content,
}

impl Message {
    /// The words of the message, without images.
    pub(super) fn text(&self) -> String {
        words_of(&self.parts)
    }

    /// What is equal where two spans tell of the same message: images and reasoning may be told once.
    pub(super) fn fingerprint(&self) -> String {
        let calls: Vec<_> = self
            .calls
            .iter()
            .map(|call| (&call.id, &call.name))
            .collect();
        let ids: Vec<_> = self.responses.iter().map(|of| &of.id).collect();
        format!("{:?}", (&self.role, self.text(), calls, ids))
    }

    /// What was said, as a content.
    pub(super) fn content(&self) -> Content {
        content_of(self.parts.clone())
    }

    fn say(&mut self, text: &str) {
        if !text.is_empty() {
            self.parts.push(Part::Text {
                text: text.to_owned(),
            });
        }
    }

    /// The content of a message as a text, or as a list of parts.
    fn fill(&mut self, content: &Value) {
        match content {
            Value::String(text) => match parts_in(text) {
                Some(parts) => parts.iter().for_each(|part| self.part(part)),
                None => self.say(text),
            },
            Value::Array(parts) => parts.iter().for_each(|part| match part {
                Value::String(text) => self.say(text),
                part => self.part(part),
            }),
            Value::Null => {}
            other => self.say(&other.to_string()),
        }
    }

    fn part(&mut self, part: &Value) {
        let kind = part["type"].as_str().unwrap_or_default();
        let words = ["content", "text", "thinking"].map(|key| part[key].as_str());
        let words = words.into_iter().flatten().next();
        match kind {
            "text" | "input_text" | "output_text" => self.say(words.unwrap_or_default()),
            "reasoning" | "thinking" => {
                let words = words.unwrap_or_default();
                if !self.reasoning.is_empty() && !words.is_empty() {
                    self.reasoning.push('\n');
                }
                self.reasoning.push_str(words);
            }
            "tool_call" | "tool_use" => self.calls.push(ToolRequest {
                id: text_of(&part["id"]),
                name: text_of(&part["name"]).unwrap_or_default(),
                arguments: arguments(match &part["arguments"] {
                    Value::Null => &part["input"],
                    told => told,
                }),
            }),
            "tool_call_response" | "tool_result" => {
                let told = ["response", "result", "content"].map(|key| &part[key]);
                let told = told.into_iter().find(|told| !told.is_null());
                let id = text_of(&part["id"]).or_else(|| text_of(&part["tool_use_id"]));
                let content = self.result(told.unwrap_or(&Value::Null));
                self.responses.push(ToolResponse { id, content });
            }
            "blob" => {
                let mime = part["mime_type"].as_str().unwrap_or_default();
                let data = part["content"].as_str().unwrap_or_default();
                self.image(mime, format!("data:{mime};base64,{data}"));
            }
            "image_url" => {
                let url = part["image_url"]["url"].as_str();
                self.image("", url.unwrap_or_default().to_owned());
            }
            "uri" => self.image("", part["uri"].as_str().unwrap_or_default().to_owned()),
            other => self.left_out.push(format!(
                "a part of type '{}' is left out",
                other.escape_debug()
            )),
        }
    }

    /// An image that the span holds; addresses and files are not opened.
    fn image(&mut self, media_type: &str, path: String) {
        if path.starts_with("data:") {
            self.parts.push(Part::Image {
                source: Media {
                    media_type: media_type.to_owned(),
                    path,
                },
            });
            return;
        }
        let name: String = path.escape_debug().take(80).collect();
        self.left_out.push(format!(
            "image {name} is left out: the span names it and does not hold it"
        ));
    }

    /// A result of a call: words, or parts of which some are images.
    fn result(&mut self, told: &Value) -> Content {
        let mut inner = Message::default();
        match told {
            Value::Array(parts) if are_parts(parts) => inner.fill(told),
            Value::String(text) => match (parts_in(text), text.starts_with('"')) {
                (Some(parts), _) => inner.fill(&Value::Array(parts)),
                (None, true) => match serde_json::from_str(text) {
                    Ok(Value::String(plain)) => inner.say(&plain),
                    _ => inner.say(text),
                },
                (None, false) => inner.say(text),
            },
            Value::Null => {}
            other => inner.say(&other.to_string()),
        }
        self.left_out.append(&mut inner.left_out);
        inner.content()
    }
}

/// A result that an attribute holds, and what of it is left out.
pub(super) fn result(told: &Value) -> (Content, Vec<String>) {
    let mut message = Message::default();
    let content = message.result(told);
    (content, message.left_out)
}

/// Whether something that was left out is only an image of ours that is named by its digest.
pub(super) fn is_reference(left_out: &str) -> bool {
    left_out.starts_with(&format!("image {DIGEST}"))
}

/// Messages in JSON: a list, a text that holds one, a field `messages`; anything else is words that somebody in that
/// role said.
pub(super) fn structured(value: &Value, role: &str) -> Vec<Message> {
    let parsed = match value {
        Value::String(text) => serde_json::from_str(text).unwrap_or(Value::Null),
        other => other.clone(),
    };
    let list = match parsed {
        Value::Array(list) => list,
        Value::Object(mut fields) => match fields.remove("messages") {
            Some(Value::Array(list)) => list,
            Some(other) => vec![other],
            None => vec![Value::Object(fields)],
        },
        _ => Vec::new(),
    };
    if !list.is_empty() && list.iter().all(|one| one["role"].is_string()) {
        return list.iter().map(|one| of_json(one, role)).collect();
    }
    if are_parts(&list) {
        // Parts without a message around them, as instructions have.
        let mut message = Message {
            role: role.to_owned(),
            ..Message::default()
        };
        message.fill(&Value::Array(list));
        return vec![message];
    }
    match value {
        Value::String(text) if text == "[]" => Vec::new(),
        Value::String(text) => words(text, role),
        Value::Array(list) if list.is_empty() => Vec::new(),
        Value::Null => Vec::new(),
        other => words(&other.to_string(), role),
    }
}

fn words(text: &str, role: &str) -> Vec<Message> {
    let mut message = Message {
        role: role.to_owned(),
        ..Message::default()
    };
    message.say(text);
    Vec::from_iter((!message.parts.is_empty()).then_some(message))
}

/// A message with `parts`, or as OpenAI has it with `content` and `tool_calls`.
fn of_json(told: &Value, role: &str) -> Message {
    let mut message = Message {
        role: told["role"].as_str().unwrap_or(role).to_owned(),
        ..Message::default()
    };
    let call_id = text_of(&told["tool_call_id"]);
    let content = match &told["parts"] {
        Value::Null => &told["content"],
        parts => parts,
    };
    if message.role == "tool" && told["parts"].is_null() {
        let content = message.result(content);
        message.responses.push(ToolResponse {
            id: call_id,
            content,
        });
        return message;
    }
    message.fill(content);
    for call in told["tool_calls"].as_array().into_iter().flatten() {
        let function = if call["function"].is_object() {
            &call["function"]
        } else {
            call
        };
        message.calls.push(ToolRequest {
            id: text_of(&call["id"]),
            name: text_of(&function["name"]).unwrap_or_default(),
            arguments: arguments(&function["arguments"]),
        });
    }
    message
}

/// Messages in attributes `PREFIX.0.role`, `PREFIX.0.content`, ..., in which OpenInference has one name more
/// (`PREFIX.0.message.role`).
pub(super) fn flattened(attributes: &BTreeMap<String, Value>, prefix: &str) -> Vec<Message> {
    let messages = indexed(attributes, prefix).into_values();
    messages
        .map(|fields| {
            let plain = |(name, value): (String, Value)| {
                (
                    name.strip_prefix("message.").unwrap_or(&name).to_owned(),
                    value,
                )
            };
            let fields: BTreeMap<String, Value> = fields.into_iter().map(plain).collect();
            let text = |name: &str| fields.get(name).and_then(text_of);
            let mut told = Map::new();
            for name in ["role", "content", "tool_call_id"] {
                told.extend(
                    fields
                        .get(name)
                        .map(|value| (name.to_owned(), value.clone())),
                );
            }
            let role = text("role").unwrap_or_else(|| "assistant".to_owned());
            told.insert("role".to_owned(), role.clone().into());
            let mut message = of_json(&Value::Object(told), &role);
            for part in indexed(&fields, "contents").into_values() {
                message.part(&of_contents(&part));
            }
            for call in indexed(&fields, "tool_calls").into_values() {
                let field =
                    |names: [&str; 3]| names.iter().find_map(|name| call.get(*name)).cloned();
                let name = field(["tool_call.function.name", "function.name", "name"]);
                let given = [
                    "tool_call.function.arguments",
                    "function.arguments",
                    "arguments",
                ];
                message.calls.push(ToolRequest {
                    id: field(["tool_call.id", "id", "id"])
                        .as_ref()
                        .and_then(text_of),
                    name: name.as_ref().and_then(text_of).unwrap_or_default(),
                    arguments: arguments(&field(given).unwrap_or_default()),
                });
            }
            message
        })
        .collect()
}

/// A part of OpenInference in the names of the conventions.
fn of_contents(fields: &BTreeMap<String, Value>) -> Value {
    let field = |name: &str| {
        let value = fields.get(&format!("message_content.{name}"));
        value.and_then(text_of).unwrap_or_default()
    };
    match field("type").as_str() {
        "image" => serde_json::json!({"type": "uri", "uri": field("image.image.url")}),
        kind => serde_json::json!({"type": kind, "text": field("text")}),
    }
}

/// Attributes `PREFIX.NUMBER.NAME` by their number, then by their name.
pub(super) fn indexed(
    attributes: &BTreeMap<String, Value>,
    prefix: &str,
) -> BTreeMap<u32, BTreeMap<String, Value>> {
    let mut found: BTreeMap<u32, BTreeMap<String, Value>> = BTreeMap::new();
    let prefix = format!("{prefix}.");
    let named = attributes
        .range(prefix.clone()..)
        .take_while(|(name, _)| name.starts_with(&prefix));
    for (name, value) in named {
        let rest = name[prefix.len()..].split_once('.');
        if let Some((number, rest)) = rest.and_then(|(at, rest)| Some((at.parse().ok()?, rest))) {
            found
                .entry(number)
                .or_default()
                .insert(rest.to_owned(), value.clone());
        }
    }
    found
}

/// Arguments as an object: of a text the JSON in it, of anything else a field `input`.
pub(super) fn arguments(told: &Value) -> Value {
    let value = match told {
        Value::String(text) => serde_json::from_str(text).unwrap_or_else(|_| told.clone()),
        other => other.clone(),
    };
    match value {
        Value::Object(_) => value,
        Value::Null => Value::Object(Map::new()),
        Value::String(text) if text.is_empty() => Value::Object(Map::new()),
        other => Value::Object(Map::from_iter([("input".to_owned(), other)])),
    }
}

fn content_of(mut parts: Vec<Part>) -> Content {
    match parts.as_mut_slice() {
        [] => Content::Text(String::new()),
        [Part::Text { text }] => Content::Text(std::mem::take(text)),
        _ => Content::Parts(parts),
    }
}

/// The parts that a text holds as JSON, if it is such a list.
fn parts_in(text: &str) -> Option<Vec<Value>> {
    if !text.trim_start().starts_with('[') {
        return None;
    }
    let parts: Vec<Value> = serde_json::from_str(text).ok()?;
    are_parts(&parts).then_some(parts)
}

fn are_parts(parts: &[Value]) -> bool {
    const KINDS: [&str; 9] = [
        "text",
        "input_text",
        "output_text",
        "reasoning",
        "thinking",
        "blob",
        "uri",
        "image_url",
        "tool_result",
    ];
    let is_part = |part: &Value| {
        part["type"]
            .as_str()
            .is_some_and(|kind| KINDS.contains(&kind))
    };
    !parts.is_empty() && parts.iter().all(is_part)
}

/// A text that is not empty.
pub(super) fn text_of(value: &Value) -> Option<String> {
    match value {
        Value::String(text) if !text.is_empty() => Some(text.clone()),
        Value::Number(number) => Some(number.to_string()),
        _ => None,
    }
}
