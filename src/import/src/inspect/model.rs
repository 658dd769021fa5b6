//! The logs of Inspect as far as they are read and written: header, samples, messages, scores.
//! Read leniently: unknown fields are ignored, and of events only what models were told and what they took is read.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::lenient::{or_default, or_empty};

/// Version of the logs that is written.
pub(super) const VERSION: u32 = 2;

/// The header of a log: which task was evaluated with which model.
#[derive(Clone, Debug, Default, Deserialize)]
pub(super) struct Header {
    #[serde(default)]
    pub(super) eval: Spec,
    /// Only in logs that are one JSON document.
    #[serde(default)]
    pub(super) samples: Option<Vec<Value>>,
}

/// What was evaluated: a task, with which model and solver.
#[derive(Clone, Debug, Default, Deserialize)]
pub(super) struct Spec {
    #[serde(default)]
    pub(super) task: String,
    #[serde(default)]
    pub(super) model: String,
    #[serde(default, deserialize_with = "or_default")]
    pub(super) eval_id: Option<String>,
    #[serde(default, deserialize_with = "or_default")]
    pub(super) solver: Option<String>,
    #[serde(default, deserialize_with = "or_default")]
    pub(super) task_version: Option<Value>,
    #[serde(default, deserialize_with = "or_default")]
    pub(super) config: SpecConfig,
}

/// How it was evaluated: how often each sample was played.
#[derive(Clone, Debug, Default, Deserialize)]
pub(super) struct SpecConfig {
    #[serde(default, deserialize_with = "or_default")]
    pub(super) epochs: Option<u32>,
}

/// One sample of a dataset as one agent played it.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub(super) struct Sample {
    /// Its name in the dataset: a text or a number.
    pub(super) id: Value,
    #[serde(default = "one")]
    pub(super) epoch: u32,
    #[serde(default)]
    pub(super) input: Value,
    #[serde(default)]
    pub(super) target: Value,
    #[serde(default, deserialize_with = "or_empty")]
    pub(super) messages: Vec<Message>,
    #[serde(default, deserialize_with = "or_default")]
    pub(super) output: Output,
    #[serde(default, deserialize_with = "or_empty")]
    pub(super) scores: Map<String, Value>,
    #[serde(default, deserialize_with = "or_empty")]
    pub(super) metadata: Map<String, Value>,
    #[serde(default, deserialize_with = "or_empty")]
    pub(super) store: Map<String, Value>,
    #[serde(default, deserialize_with = "or_default")]
    pub(super) events: Vec<Event>,
    #[serde(default, deserialize_with = "or_empty")]
    pub(super) attachments: BTreeMap<String, String>,
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "or_default"
    )]
    pub(super) error: Option<SampleError>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) limit: Option<Value>,
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "or_default"
    )]
    pub(super) uuid: Option<String>,
}

fn one() -> u32 {
    1
}

/// Why a sample could not be played to its end.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub(super) struct SampleError {
    #[serde(default)]
    pub(super) message: String,
    /// Inspect reads no error without it.
    #[serde(skip_deserializing)]
    pub(super) traceback: String,
    /// Inspect reads no error without it.
    #[serde(skip_deserializing)]
    pub(super) traceback_ansi: String,
}

/// One message of the conversation.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub(super) struct Message {
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "or_default"
    )]
    pub(super) id: Option<String>,
    /// `system`, `user`, `assistant` or `tool`.
    pub(super) role: String,
    #[serde(default)]
    pub(super) content: Content,
    #[serde(
        default,
        skip_serializing_if = "Vec::is_empty",
        deserialize_with = "or_empty"
    )]
    pub(super) tool_calls: Vec<Call>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) tool_call_id: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) function: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) error: Option<CallError>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) model: Option<String>,
    #[serde(
        default,
        skip_serializing_if = "Map::is_empty",
        deserialize_with = "or_empty"
    )]
    pub(super) metadata: Map<String, Value>,
}

/// A text, or parts of several types.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(untagged, expecting = "a text, or a list of parts with a type")]
pub(super) enum Content {
    Text(String),
    Parts(Vec<Part>),
}

impl Default for Content {
    fn default() -> Self {
        Self::Text(String::new())
    }
}

/// A part of a content, by its type.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "lowercase")]
pub(super) enum Part {
    Text {
        text: String,
    },
    Reasoning {
        reasoning: String,
    },
    /// An image as `data:` URI, as reference to an attachment, as path or address.
    Image {
        image: String,
    },
    /// Sounds, videos, documents and whatever else there will be.
    #[serde(other, skip_serializing)]
    Other,
}

/// A call of a tool.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub(super) struct Call {
    #[serde(default)]
    pub(super) id: String,
    pub(super) function: String,
    #[serde(default)]
    pub(super) arguments: Value,
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "or_default"
    )]
    pub(super) parse_error: Option<String>,
}

/// Why a call failed.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub(super) struct CallError {
    #[serde(default, rename = "type")]
    pub(super) kind: String,
    #[serde(default)]
    pub(super) message: String,
}

/// What a model answered.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub(super) struct Output {
    #[serde(default)]
    pub(super) model: String,
    #[serde(default, deserialize_with = "or_default")]
    pub(super) choices: Vec<Choice>,
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "or_default"
    )]
    pub(super) usage: Option<Usage>,
}

/// One of the model's answers.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub(super) struct Choice {
    pub(super) message: Message,
    #[serde(default)]
    pub(super) stop_reason: String,
}

/// Tokens of one inference.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize)]
pub(super) struct Usage {
    #[serde(default, deserialize_with = "or_default")]
    pub(super) input_tokens: u32,
    #[serde(default, deserialize_with = "or_default")]
    pub(super) output_tokens: u32,
    #[serde(default, deserialize_with = "or_default")]
    pub(super) total_tokens: u32,
}

/// Something that happened; only inferences are read.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub(super) struct Event {
    #[serde(default, deserialize_with = "or_default")]
    pub(super) event: String,
    /// What the model could call.
    #[serde(default, deserialize_with = "or_empty")]
    pub(super) tools: Vec<Value>,
    #[serde(default, deserialize_with = "or_default")]
    pub(super) output: Output,
}
