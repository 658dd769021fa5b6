//! What several checks need of a row, worked out once: answers, calls, declared tools, what
//! its images look like.

use std::collections::HashMap;

use reel_world::ToolSpec;
use serde_json::Value;

use super::published::TOOL_CALL_TAG;
use crate::lint::{
    AssistantTurn, Call, Example, Image, ImageHeader, ImageSource, Part, RowLocation, Turn,
    show::image_bytes,
};

/// A digest short enough to keep by the million.
pub(super) type Key = [u8; 16];

/// A row and what was read out of it.
pub(super) struct RowFacts<'a> {
    pub(super) example: &'a Example,
    pub(super) answers: Vec<ModelTurn>,
    /// One for each image of the row.
    pub(super) images: Vec<ImageProbe>,
    /// Everything but answers, up to each answer: text with even white space,
    /// and images by digest.
    pub(super) contexts: Vec<Key>,
    /// The whole row: all turns and images.
    pub(super) whole: Key,
}

impl RowFacts<'_> {
    /// Whether some turn calls a tool natively, by a field of its own or by a tag in its text.
    pub(super) fn has_native_calls(&self) -> bool {
        self.answers.iter().any(|said| {
            let text = || self.example.turns[said.turn].text();
            said.by_function || (!said.calls.is_empty() && text().contains(TOOL_CALL_TAG))
        })
    }

    /// Whether it is a conversation of an agent outside of homes: it calls tools, and none of them
    /// is a tool of REAL's.
    pub(super) fn has_own_tools(&self) -> bool {
        let mut calls = self.answers.iter().flat_map(|said| &said.calls);
        self.has_native_calls() && calls.all(|call| ToolSpec::by_name(&call.name).is_none())
    }
}

/// A turn of the model.
pub(super) struct ModelTurn {
    /// Index of the turn in its row, from 0.
    pub(super) turn: usize,
    pub(super) answer: AssistantTurn,
    /// What it calls: by function calling, or in its JSON.
    pub(super) calls: Vec<Call>,
    /// Whether the calls are those of function calling.
    pub(super) by_function: bool,
}

/// What an image looks like from outside.
#[derive(Clone, Debug)]
pub(super) struct ImageProbe {
    /// Of its bytes; of its path or URL where there are none.
    pub(super) digest: Key,
    pub(super) header: Option<ImageHeader>,
    /// Why it cannot be used: what sort, and in words.
    pub(super) fault: Option<(&'static str, String)>,
}

/// Looks of image files by path, so that each is read once. Memory: some 150 bytes for
/// each file of images.
#[derive(Default)]
pub(super) struct ImageProbes(HashMap<Key, ImageProbe>);

impl<'a> RowFacts<'a> {
    pub(super) fn new(example: &'a Example, looks: &mut ImageProbes) -> Self {
        let frames: Vec<ImageProbe> = example.images.iter().map(|image| looks.of(image)).collect();
        let answers = example
            .turns
            .iter()
            .enumerate()
            .filter(|(_, turn)| turn.role.is_answer());
        let answers = answers
            .map(|(number, turn)| ModelTurn::of(number, turn))
            .collect();
        let mut hasher = blake3::Hasher::new();
        let mut contexts = Vec::new();
        for turn in &example.turns {
            if turn.role.is_answer() {
                contexts.push(key(&hasher));
            }
            hasher.update(turn.role.as_str().as_bytes());
            for part in &turn.parts {
                match part {
                    Part::Text(text) => text.split_whitespace().for_each(|word| {
                        hasher.update(word.as_bytes()).update(b" ");
                    }),
                    Part::Image(number) => {
                        let digest = frames.get(*number).map_or([0; 16], |look| look.digest);
                        hasher.update(b"\0image").update(&digest);
                    }
                    Part::Call(call) => {
                        hasher.update(b"\0call").update(call.canonical().as_bytes());
                    }
                }
            }
            hasher.update(b"\0");
        }
        Self {
            example,
            answers,
            images: frames,
            contexts,
            whole: key(&hasher),
        }
    }

    pub(super) fn place(&self) -> RowLocation {
        self.example.location
    }

    /// The tools that the row declares: in its field, or as a JSON list after `Tools:` in its text.
    pub(super) fn tools(&self) -> Option<Vec<Tool>> {
        let listed = self.example.tools.as_ref().and_then(Tool::list);
        listed.or_else(|| {
            let prompts = self
                .example
                .turns
                .iter()
                .filter(|turn| !turn.role.is_answer());
            prompts.flat_map(Turn::texts).find_map(|text| {
                let after = &text[text.find("Tools:")? + "Tools:".len()..];
                let mut values =
                    serde_json::Deserializer::from_str(after.trim_start()).into_iter::<Value>();
                Tool::list(&values.next()?.ok()?)
            })
        })
    }
}

fn key(hasher: &blake3::Hasher) -> Key {
    let mut key = [0; 16];
    hasher.finalize_xof().fill(&mut key);
    key
}

/// A digest of some bytes.
pub(super) fn key_of(bytes: &[u8]) -> Key {
    key(blake3::Hasher::new().update(bytes))
}

impl ModelTurn {
    fn of(number: usize, turn: &Turn) -> Self {
        let mut calls: Vec<Call> = turn.calls().cloned().collect();
        let answer = AssistantTurn::parse(&turn.text());
        let by_function = !calls.is_empty();
        if !by_function {
            calls.extend(answer.action.clone());
        }
        Self {
            turn: number,
            answer,
            calls,
            by_function,
        }
    }
}

impl ImageProbes {
    fn of(&mut self, image: &Image) -> ImageProbe {
        match &image.source {
            ImageSource::File(path) => {
                let name = key_of(path.as_os_str().as_encoded_bytes());
                self.0
                    .entry(name)
                    .or_insert_with(|| look(image, name))
                    .clone()
            }
            _ => look(image, key_of(image.name.as_bytes())),
        }
    }
}

fn look(image: &Image, name: Key) -> ImageProbe {
    let fault = |kind, words: String| ImageProbe {
        digest: name,
        header: None,
        fault: Some((kind, words)),
    };
    match (&image.source, image_bytes(image)) {
        (_, Some(bytes)) => {
            let digest = key_of(&bytes);
            match ImageHeader::of(&bytes) {
                Ok(frame) => ImageProbe {
                    digest,
                    header: Some(frame),
                    fault: None,
                },
                Err(error) => ImageProbe {
                    digest,
                    header: None,
                    fault: Some(("undecodable", error.to_string())),
                },
            }
        }
        (ImageSource::Broken(why), None) => fault("undecodable", why.clone()),
        (ImageSource::Remote, None) => ImageProbe {
            digest: name,
            header: None,
            fault: None,
        },
        (_, None) => fault("missing", "no such file".to_owned()),
    }
}

/// A tool as a row declares it.
pub(super) struct Tool {
    pub(super) name: String,
    /// JSON Schema of its arguments; an object.
    pub(super) parameters: Value,
}

impl Tool {
    fn list(value: &Value) -> Option<Vec<Self>> {
        let tools: Vec<Self> = value.as_array()?.iter().filter_map(Self::of).collect();
        (!tools.is_empty()).then_some(tools)
    }

    fn of(value: &Value) -> Option<Self> {
        let value = value.get("function").unwrap_or(value);
        let parameters = ["parameters", "input_schema", "inputSchema"]
            .iter()
            .find_map(|key| value.get(*key));
        Some(Self {
            name: value.get("name")?.as_str()?.to_owned(),
            parameters: parameters.cloned().unwrap_or_default(),
        })
    }

    /// What a call's arguments do wrong by the schema: missing, unknown, of another type.
    pub(super) fn faults(&self, arguments: &Value) -> Vec<(&'static str, String)> {
        let empty = serde_json::Map::new();
        let arguments = match arguments {
            Value::Null => &empty,
            Value::Object(arguments) => arguments,
            other => {
                return vec![(
                    "wrong type",
                    format!("the arguments of {} are not an object: {other}", self.name),
                )];
            }
        };
        let properties = self
            .parameters
            .get("properties")
            .and_then(Value::as_object)
            .unwrap_or(&empty);
        let required = self
            .parameters
            .get("required")
            .and_then(Value::as_array)
            .into_iter()
            .flatten()
            .filter_map(Value::as_str);
        let missing = required.filter(|name| !arguments.contains_key(*name));
        let mut faults: Vec<_> = missing
            .map(|name| {
                (
                    "missing argument",
                    format!("{} lacks its argument {name}", self.name),
                )
            })
            .collect();
        for (name, value) in arguments {
            match properties.get(name.as_str()) {
                None if self.takes_others() => {}
                None => faults.push((
                    "unknown argument",
                    format!("{} has no argument {name}", self.name),
                )),
                Some(schema) => {
                    let wanted = schema
                        .get("type")
                        .and_then(Value::as_str)
                        .unwrap_or_default();
                    let allowed = schema
                        .get("enum")
                        .and_then(Value::as_array)
                        .is_none_or(|values| values.contains(value));
                    if !is_of_type(value, wanted) || !allowed {
                        let expected = if allowed {
                            wanted
                        } else {
                            "one of the listed values"
                        };
                        faults.push((
                            "wrong type",
                            format!("{} wants {name} as {expected}, found {value}", self.name),
                        ));
                    }
                }
            }
        }
        faults
    }

    /// Whether the schema takes arguments that it does not name: it says so, or names none at all.
    /// One that is silent is taken as closed: an invented argument is what models get wrong.
    fn takes_others(&self) -> bool {
        let others = self.parameters.get("additionalProperties");
        others.is_some_and(|others| others.is_object() || others == true)
            || self.parameters.get("properties").is_none()
    }
}

fn is_of_type(value: &Value, wanted: &str) -> bool {
    match wanted {
        "string" => value.is_string(),
        "integer" => value.is_i64() || value.is_u64(),
        "number" => value.is_number(),
        "boolean" => value.is_boolean(),
        "array" => value.is_array(),
        "object" => value.is_object(),
        _ => true,
    }
}
