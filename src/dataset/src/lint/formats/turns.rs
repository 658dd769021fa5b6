//! Turns as the formats write them: text with tags, lists of parts, calls.

use serde_json::Value;

use super::{Source, format_warning, has_tags, image};
use crate::lint::{Call, Format, Image, ImageSource, Part, Role, Turn, example::FormatWarning};

/// Reads the turns of one row; counts tags and keeps what it wonders at.
pub(super) struct Reader<'a> {
    source: &'a Source<'a>,
    tags: usize,
    /// Images that stand in the turns themselves.
    own: Vec<Image>,
    warnings: Vec<FormatWarning>,
}

impl<'a> Reader<'a> {
    pub(super) fn new(source: &'a Source<'a>) -> Self {
        Self {
            source,
            tags: 0,
            own: Vec::new(),
            warnings: Vec::new(),
        }
    }

    pub(super) fn finish(self) -> (Vec<Image>, Vec<FormatWarning>) {
        (self.own, self.warnings)
    }

    /// A list of turns.
    pub(super) fn turns(&mut self, key: &str, messages: &Value) -> Result<Vec<Turn>, String> {
        let Value::Array(turns) = messages else {
            return Err(format!(
                "`{key}` is no list: expected a list of turns, found {}",
                kind_of(messages)
            ));
        };
        turns
            .iter()
            .enumerate()
            .map(|(number, turn)| {
                self.turn(turn)
                    .map_err(|what| format!("`{key}[{number}]`: {what}"))
            })
            .collect()
    }

    /// A prompt or completion: a text, or turns.
    pub(super) fn side(
        &mut self,
        key: &str,
        value: &Value,
        role: &str,
    ) -> Result<Vec<Turn>, String> {
        match value {
            Value::String(text) => {
                let parts = self.tagged(text);
                Ok(vec![Turn {
                    role: self.source.columns.role_of(role),
                    parts,
                }])
            }
            _ => self.turns(key, value),
        }
    }

    /// Images listed beside the turns: a path, an object with bytes or a path, or
    /// a list of those.
    pub(super) fn images(&mut self, listed: &Value) -> Vec<Image> {
        match listed {
            Value::Null => Vec::new(),
            Value::Array(items) => items.iter().map(|item| self.image(item)).collect(),
            one => vec![self.image(one)],
        }
    }

    fn image(&self, value: &Value) -> Image {
        let path = value.as_str().or_else(|| {
            ["path", "url", "image"]
                .iter()
                .find_map(|key| value.get(key)?.as_str())
        });
        match path {
            Some(path) => image(path, self.source.resolve),
            None => {
                let why = format!("expected the path of an image, found {}", kind_of(value));
                Image {
                    name: String::new(),
                    source: ImageSource::Broken(why),
                }
            }
        }
    }

    fn turn(&mut self, turn: &Value) -> Result<Turn, String> {
        let columns = self.source.columns;
        let Value::Object(fields) = turn else {
            return Err(format!(
                "expected an object with `{}` and `{}`, found {}",
                columns.role,
                columns.content,
                kind_of(turn)
            ));
        };
        let Some(role) = fields.get(columns.role.as_str()).and_then(Value::as_str) else {
            return Err(format!(
                "no `{}`: expected one of {}",
                columns.role,
                columns.role_names()
            ));
        };
        let role = columns.role_of(role);
        let mut parts = match fields.get(columns.content.as_str()) {
            Some(Value::String(text)) => self.tagged(text),
            Some(Value::Array(items)) => items.iter().filter_map(|item| self.part(item)).collect(),
            Some(Value::Null) => Vec::new(),
            None if fields.contains_key("tool_calls") => Vec::new(),
            None => return Err(format!("no `{}`: expected a text", columns.content)),
            Some(other) => {
                return Err(format!(
                    "`{}` is {}: expected a text or a list of parts",
                    columns.content,
                    kind_of(other)
                ));
            }
        };
        if role == Role::ToolCall {
            parts = self.spoken_call(parts);
        }
        if let Some(calls) = fields.get("tool_calls").filter(|calls| !calls.is_null()) {
            let read: Vec<Option<Call>> = calls
                .as_array()
                .into_iter()
                .flatten()
                .map(Call::of_value)
                .collect();
            if read.is_empty() || read.contains(&None) {
                self.warnings.push(format_warning(
                    "tool calls",
                    true,
                    "`tool_calls` holds something that is no call: expected {id, type, function}",
                ));
            }
            self.check_arguments(calls);
            parts.extend(read.into_iter().flatten().map(Part::Call));
        }
        if role == Role::ToolResult
            && self.source.format == Format::OpenAi
            && fields.get("tool_call_id").is_none()
        {
            self.warnings.push(format_warning(
                "tool call id",
                true,
                "a tool's result without `tool_call_id`: the server refuses it",
            ));
        }
        Ok(Turn { role, parts })
    }

    fn check_arguments(&mut self, calls: &Value) {
        let arguments = |call: &Value| {
            call.get("function")
                .unwrap_or(call)
                .get("arguments")
                .cloned()
        };
        for arguments in calls.as_array().into_iter().flatten().filter_map(arguments) {
            let told = match (&arguments, self.source.format) {
                (Value::String(text), _) if serde_json::from_str::<Value>(text).is_err() => {
                    "`arguments` is a text that is not JSON"
                }
                (Value::String(_), _) | (_, Format::Trl | Format::Parquet | Format::MsSwift) => {
                    continue;
                }
                _ => "`arguments` is no text: the OpenAI format wants JSON inside a string",
            };
            self.warnings.push(format_warning("tool calls", true, told));
        }
    }

    /// A turn whose whole text is a call, or a list of calls; thoughts may stand before it.
    fn spoken_call(&mut self, parts: Vec<Part>) -> Vec<Part> {
        let turn = Turn {
            role: Role::ToolCall,
            parts,
        };
        let text = turn.text();
        let (thought, spoken) = text.find(THOUGHT_END).map_or(("", text.as_str()), |at| {
            text.split_at(at + THOUGHT_END.len())
        });
        let calls = match serde_json::from_str::<Value>(spoken) {
            Ok(Value::Array(items)) => items.iter().map(Call::of_value).collect(),
            Ok(one) => Call::of_value(&one).map(|call| vec![call]),
            Err(_) => None,
        };
        let Some(calls) = calls else {
            let told =
                "a tool call that does not read: expected {\"name\": .., \"arguments\": {..}}";
            self.warnings.push(format_warning("tool calls", true, told));
            return turn.parts;
        };
        let thought = (!thought.is_empty()).then(|| Part::Text(thought.to_owned()));
        thought
            .into_iter()
            .chain(calls.into_iter().map(Part::Call))
            .collect()
    }

    fn part(&mut self, item: &Value) -> Option<Part> {
        if let Value::String(text) = item {
            return Some(Part::Text(text.clone()));
        }
        let inline = ["image_url", "image"]
            .iter()
            .find_map(|key| item.get(key).filter(|it| !it.is_null()));
        match item.get("type").and_then(Value::as_str) {
            Some("text" | "input_text" | "output_text") => Some(Part::Text(
                item.get("text")
                    .and_then(Value::as_str)
                    .unwrap_or_default()
                    .to_owned(),
            )),
            Some("image" | "image_url" | "input_image") => {
                if let Some(inline) = inline {
                    let image = self.image(inline);
                    self.own.push(image);
                    return Some(Part::Image(self.own.len() - 1));
                }
                self.tags += 1;
                Some(Part::Image(self.tags - 1))
            }
            other => {
                let other = other.unwrap_or("nothing").to_owned();
                self.warnings.push(format_warning(
                    "part",
                    true,
                    format!("a part of type {other}: expected text or image"),
                ));
                None
            }
        }
    }

    /// A text, cut at its tags where the format has tags.
    fn tagged(&mut self, text: &str) -> Vec<Part> {
        if !has_tags(self.source.format) || !text.contains("<image>") {
            return vec![Part::Text(text.to_owned())];
        }
        let mut parts = Vec::new();
        for (number, piece) in text.split("<image>").enumerate() {
            if number > 0 {
                parts.push(Part::Image(self.tags));
                self.tags += 1;
            }
            if !piece.is_empty() {
                parts.push(Part::Text(piece.to_owned()));
            }
        }
        parts
    }
}

/// What ends a thought before a call.
const THOUGHT_END: &str = "</think>";

fn kind_of(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "a truth value",
        Value::Number(_) => "a number",
        Value::String(_) => "a text",
        Value::Array(_) => "a list",
        Value::Object(_) => "an object",
    }
}
