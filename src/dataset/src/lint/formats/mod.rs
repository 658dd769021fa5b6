//! The six formats of docs/spec.md#dataset-formats: which one a row is written in, and the row
//! in the common form.
//!
//! Accepts more than the loaders do, so that what they would refuse or skip can be
//! told instead of lost.

mod columns;
mod turns;

use std::path::Path;

use crate::Format;
use serde_json::{Map, Value};

pub(crate) use columns::Columns;

use crate::lint::{
    Example, Image, ImageSource, Part, Role, RowLocation, Turn, example::FormatWarning,
};

/// Whether `<image>` in a text stands for an image.
pub(crate) fn has_tags(format: Format) -> bool {
    !matches!(format, Format::Trl | Format::OpenAi)
}

/// What is understood, for messages.
pub(crate) const EXPECTED: &str = "rows with `conversations`, with `messages`, with `prompt` and `completion`, or with `chosen` and `rejected`, as a JSON list, JSONL or Parquet";

/// The format of a JSON row without a `dataset_info.json` beside it.
pub(crate) fn recognise(row: &Map<String, Value>) -> Option<Format> {
    if let Some(Value::Array(turns)) = row.get("conversations") {
        let factory_role = |turn: &Value| {
            matches!(
                turn.get("from").and_then(Value::as_str),
                Some("function_call" | "observation")
            ) || turn.get("role").is_some()
        };
        let factory = row.contains_key("tools")
            || row.contains_key("system")
            || turns.iter().any(factory_role);
        return Some(if factory && !row.contains_key("image") {
            Format::LlamaFactory
        } else {
            Format::QwenVl
        });
    }
    if let Some(Value::Array(turns)) = row.get("messages") {
        return Some(of_messages(row, turns));
    }
    let has = |keys: [&str; 2]| keys.iter().all(|key| row.contains_key(*key));
    (has(["prompt", "completion"]) || has(["chosen", "rejected"])).then_some(Format::Trl)
}

fn of_messages(row: &Map<String, Value>, turns: &[Value]) -> Format {
    let parts = || {
        turns
            .iter()
            .filter_map(|turn| turn.get("content")?.as_array())
            .flatten()
    };
    let url = parts().any(|part| {
        matches!(
            part.get("type").and_then(Value::as_str),
            Some("image_url" | "input_image")
        )
    });
    let role = |names: &[&str]| {
        turns.iter().any(|turn| {
            turn.get("role")
                .and_then(Value::as_str)
                .is_some_and(|it| names.contains(&it))
        })
    };
    // TRL has calls too, and images beside the turns.
    let calls =
        turns.iter().any(|turn| turn.get("tool_calls").is_some()) && !row.contains_key("images");
    if url || calls || role(&["developer"]) {
        return Format::OpenAi;
    }
    if parts().next().is_some() {
        return Format::Trl;
    }
    let tag = |turn: &Value| {
        turn.get("content")
            .and_then(Value::as_str)
            .is_some_and(|text| text.contains("<image>"))
    };
    let swift = role(&["tool_call", "tool_response"])
        || row.get("tools").is_some_and(Value::is_string)
        || turns.iter().any(tag);
    if swift { Format::MsSwift } else { Format::Trl }
}

/// Where a row comes from and how its paths are read.
pub(crate) struct Source<'a> {
    pub(crate) place: RowLocation,
    pub(crate) format: Format,
    pub(crate) columns: &'a Columns,
    /// Split by the names of file and folder.
    pub(crate) split: Option<&'a str>,
    /// Where a path of an image leads.
    pub(crate) resolve: &'a dyn Fn(&Path) -> ImageSource,
}

/// A row in the common form. `inside` are images that the file itself holds.
///
/// # Errors
/// What is missing and what was expected.
pub(crate) fn example(
    mut row: Map<String, Value>,
    inside: Option<Vec<Image>>,
    source: &Source,
) -> Result<Example, String> {
    let mut reader = turns::Reader::new(source);
    let columns = source.columns;
    let mut rejected = Vec::new();
    let mut turns = match row.remove(columns.messages.as_str()) {
        Some(messages) => reader.turns(&columns.messages, &messages)?,
        None => {
            let mut side = |key: &str, role: &str| match row.remove(key) {
                Some(said) => reader.side(key, &said, role).map(Some),
                None => Ok(None),
            };
            let prompt = side("prompt", "user")?;
            let answer = match side("completion", "assistant")? {
                Some(completion) => prompt.is_some().then_some(completion),
                // A pair without a prompt has it in both of its sides.
                None => match (side("chosen", "assistant")?, side("rejected", "assistant")?) {
                    (Some(chosen), Some(other)) => {
                        rejected = other;
                        Some(chosen)
                    }
                    _ => None,
                },
            };
            let key = &columns.messages;
            let answer =
                answer.ok_or_else(|| format!("no turns: expected a list under `{key}`"))?;
            [prompt.unwrap_or_default(), answer].concat()
        }
    };
    if let Some(system) = columns
        .system
        .as_ref()
        .and_then(|key| row.remove(key.as_str()))
    {
        let text = system.as_str().unwrap_or_default();
        if !text.is_empty() && turns.first().is_none_or(|turn| turn.role != Role::System) {
            turns.insert(
                0,
                Turn {
                    role: Role::System,
                    parts: vec![Part::Text(text.to_owned())],
                },
            );
        }
    }
    let listed = columns
        .images
        .as_ref()
        .and_then(|key| row.remove(key.as_str()));
    let mut images = match (inside, listed) {
        (Some(images), _) => images,
        (None, Some(listed)) => reader.images(&listed),
        (None, None) => Vec::new(),
    };
    let tagged = turns
        .iter()
        .flat_map(|turn| &turn.parts)
        .any(|part| matches!(part, Part::Image(_)));
    if source.format == Format::Trl && !tagged && !images.is_empty() {
        // The trainer puts them before the first text of the user.
        if let Some(turn) = turns.iter_mut().find(|turn| turn.role == Role::User) {
            turn.parts.splice(0..0, (0..images.len()).map(Part::Image));
        }
    }
    let (own, mut warnings) = reader.finish();
    if !rejected.is_empty() && turns.ends_with(&rejected) {
        let message = "`chosen` and `rejected` are the same: nothing can be learned from the pair";
        warnings.push(format_warning("pair", true, message));
    }
    if !own.is_empty() {
        images = own;
    }
    let tools = columns
        .tools
        .as_ref()
        .and_then(|key| row.remove(key.as_str()))
        .filter(|tools| !tools.is_null());
    let tools = tools.map(|tools| match &tools {
        Value::String(text) => serde_json::from_str(text).unwrap_or(tools),
        _ => tools,
    });
    let meta = flat(row);
    let split = meta
        .get("split")
        .and_then(Value::as_str)
        .map(split_name)
        .or_else(|| source.split.map(str::to_owned));
    Ok(Example {
        location: source.place,
        format: source.format,
        split,
        turns,
        rejected,
        tools,
        images,
        meta,
        warnings,
    })
}

/// One name for a split, however it is spelled.
pub(crate) fn split_name(name: &str) -> String {
    let lower = name.to_lowercase();
    match lower.as_str() {
        "training" => "train".into(),
        "val" | "valid" | "dev" | "eval" => "validation".into(),
        "testing" | "heldout" | "held_out" => "test".into(),
        _ => lower,
    }
}

/// The row with the entries of its notes laid flat; keys of the row itself go first.
fn flat(mut row: Map<String, Value>) -> Map<String, Value> {
    for key in ["meta", "metadata", "provenance", "extra_info"] {
        let notes = match row.get(key) {
            Some(Value::Object(notes)) => Some(notes.clone()),
            Some(Value::String(text)) => serde_json::from_str(text).ok(),
            _ => None,
        };
        if let Some(notes) = notes {
            row.remove(key);
            for (key, value) in notes {
                row.entry(key).or_insert(value);
            }
        }
    }
    row
}

/// An image by the path, the URL or the data URL that is written.
pub(crate) fn image(written: &str, resolve: &dyn Fn(&Path) -> ImageSource) -> Image {
    if let Some(data) = written.strip_prefix("data:") {
        let name = data.split([';', ',']).next().unwrap_or_default();
        return Image {
            name: format!("data:{name}"),
            source: columns::data_url(data),
        };
    }
    let remote = ["http://", "https://", "s3://", "oss://", "hf://"]
        .iter()
        .any(|scheme| written.starts_with(scheme));
    let path = Path::new(written.strip_prefix("file://").unwrap_or(written));
    Image {
        name: written.to_owned(),
        source: if remote {
            ImageSource::Remote
        } else {
            resolve(path)
        },
    }
}

pub(crate) fn format_warning(
    kind: &'static str,
    harmful: bool,
    message: impl Into<String>,
) -> FormatWarning {
    FormatWarning {
        kind,
        harmful,
        message: message.into(),
    }
}
