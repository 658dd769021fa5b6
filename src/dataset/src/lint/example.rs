//! The common form of a training row: turns of text, images and calls,
//! whatever the file's format.

use std::path::PathBuf;

use serde::Serialize;
use serde_json::{Map, Value};

use crate::lint::{Call, Format};

/// Where a row stands.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default, Serialize)]
pub struct RowLocation {
    /// Number of the row in the dataset, from 0, unreadable rows counted.
    pub index: u64,
    /// Number of the file in [`crate::lint::Dataset::files`].
    pub file: u32,
    /// Line where the row begins, from 1; in Parquet the number of the row in its file, from 1.
    pub line: u32,
}

/// One training row in the form that all formats share.
#[derive(Clone, Debug)]
pub struct Example {
    /// Location of the row in the dataset.
    pub location: RowLocation,
    /// The format it was read as.
    pub format: Format,
    /// `train`, `validation`, `test`, or what the row says itself; from the row, or else from the
    /// names of file and folder.
    pub split: Option<String>,
    /// What is said, in order.
    pub turns: Vec<Turn>,
    /// In a preference pair, the answer that is to become less likely; the chosen one ends `turns`.
    pub rejected: Vec<Turn>,
    /// The tools that the row declares, as it does.
    pub tools: Option<Value>,
    /// The images, in the order of their tags.
    pub images: Vec<Image>,
    /// All other keys of the row; an object under `meta`, `metadata` or `provenance` is laid flat.
    pub meta: Map<String, Value>,
    /// What the reader saw and the format's loader would pass over in silence.
    pub warnings: Vec<FormatWarning>,
}

/// Something that the loader of the format ignores, skips or trips over.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct FormatWarning {
    /// Short name, for counting.
    pub kind: &'static str,
    /// Whether training on it is harmful.
    pub harmful: bool,
    /// What is wrong, in a message for people.
    pub message: String,
}

/// What one party says.
#[derive(Clone, PartialEq, Debug)]
pub struct Turn {
    /// The party that speaks in this turn.
    pub role: Role,
    /// Pieces of the turn, in order: text, images and calls.
    pub parts: Vec<Part>,
}

/// The party that speaks in a turn.
#[derive(Clone, PartialEq, Eq, Hash, Debug)]
pub enum Role {
    /// The system message, which holds the instructions.
    System,
    /// The user: task and observations.
    User,
    /// The model, whose turns hold the answers to be learned.
    Assistant,
    /// The model, calling a tool (a role of its own in ms-swift and LLaMA-Factory).
    ToolCall,
    /// The result that a tool returned for a call.
    ToolResult,
    /// A role that no loader knows, as written.
    Other(String),
}

/// A piece of a turn.
#[derive(Clone, PartialEq, Debug)]
pub enum Part {
    /// Text, without the tags of images.
    Text(String),
    /// An image: its number in [`Example::images`], which may be missing there.
    Image(usize),
    /// A call of function calling.
    Call(Call),
}

/// An image of a row.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Image {
    /// The path or name as written; empty where there is none.
    pub name: String,
    /// Where its bytes are.
    pub source: ImageSource,
}

/// Where the bytes of an image are.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum ImageSource {
    /// A file, which may be missing.
    File(PathBuf),
    /// Bytes of the image file, which the row itself holds.
    Bytes(Vec<u8>),
    /// Somewhere else (`https:` and the like); not read.
    Remote,
    /// Nothing that can be read, and why.
    Broken(String),
}

impl Role {
    /// Whether the model learns to say it.
    pub fn is_answer(&self) -> bool {
        matches!(self, Role::Assistant | Role::ToolCall)
    }

    /// Name of the role for messages, e.g. `tool call`.
    pub fn as_str(&self) -> &str {
        match self {
            Role::System => "system",
            Role::User => "user",
            Role::Assistant => "assistant",
            Role::ToolCall => "tool call",
            Role::ToolResult => "tool result",
            Role::Other(name) => name,
        }
    }
}

impl Turn {
    /// The text of a turn, its parts one after the other, images and calls left out.
    pub fn text(&self) -> String {
        let texts: Vec<&str> = self.texts().collect();
        texts.join("")
    }

    /// The texts of a turn.
    pub fn texts(&self) -> impl Iterator<Item = &str> {
        self.parts.iter().filter_map(|part| match part {
            Part::Text(text) => Some(text.as_str()),
            _ => None,
        })
    }

    /// The calls of a turn.
    pub fn calls(&self) -> impl Iterator<Item = &Call> {
        self.parts.iter().filter_map(|part| match part {
            Part::Call(call) => Some(call),
            _ => None,
        })
    }
}

impl Example {
    /// A text or number of [`Example::meta`] under the first of these keys that is there.
    pub fn meta_text(&self, keys: &[&str]) -> Option<String> {
        keys.iter().find_map(|key| match self.meta.get(*key)? {
            Value::String(text) if !text.is_empty() => Some(text.clone()),
            Value::Number(number) => Some(number.to_string()),
            _ => None,
        })
    }

    /// The episode that the row comes from.
    pub fn episode(&self) -> Option<String> {
        self.meta_text(&["episode_id", "episode", "trajectory_id"])
    }

    /// The number of the decision in its episode.
    pub fn call_number(&self) -> Option<u64> {
        ["call", "step", "step_id", "call_index"]
            .iter()
            .find_map(|key| self.meta.get(*key)?.as_u64())
    }
}
