//! A conversation with native tool calls: what the model is told at its start. For trainers and
//! agents other than REAL's.

use std::fmt::Write as _;

use reel_world::{NameSet, ToolSpec};
use serde_json::{Value, json};

/// How to behave in a conversation with native tool calls.
pub const SYSTEM_MULTI_TURN: &str = include_str!("../texts/conversation.txt");

/// What stands before an image in a conversation.
pub const VIEW: &str = "\nCurrent view: ";

/// The tools as native tool calling names them: a list of `{type: function, function: {...}}`.
pub fn functions(names: NameSet) -> Value {
    ToolSpec::POLICY
        .iter()
        .map(|spec| json!({ "type": "function", "function": function(spec, names) }))
        .collect()
}

/// The first user message, before the image. `receptacles` are ids with category and room.
pub fn briefing<'a>(
    instruction: &str,
    receptacles: impl IntoIterator<Item = (&'a str, &'a str, &'a str)>,
) -> String {
    let mut text = format!("Task: {instruction}\n\nReceptacles:\n");
    for (id, category, room) in receptacles {
        let _ = writeln!(text, "- {id} ({category}, {room})");
    }
    text
}

/// `<think>...</think>` and a line's end; empty without reasoning.
pub fn thought(reasoning: &str) -> String {
    if reasoning.is_empty() {
        String::new()
    } else {
        format!("<think>{reasoning}</think>\n")
    }
}

/// The arguments of a call as a JSON object.
pub fn arguments(arguments: &Value) -> String {
    if arguments.is_null() {
        "{}".to_owned()
    } else {
        arguments.to_string()
    }
}

fn function(spec: &ToolSpec, names: NameSet) -> Value {
    let (properties, required) = match spec.argument {
        Some(argument) => (
            json!({ argument.name: { "type": argument.json_type } }),
            json!([argument.name]),
        ),
        None => (json!({}), json!([])),
    };
    json!({
        "name": spec.name(names),
        "description": spec.description,
        "parameters": { "type": "object", "properties": properties, "required": required },
    })
}
