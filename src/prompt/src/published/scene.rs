//! Rooms, receptacles and tools as the published clients write them.

use serde_json::{Map, Value, json};

use crate::{
    PromptWording,
    python::{self, Ascii},
};

/// The scene in a prompt of the trainer: a heading, then one line a room, names and
/// order as they come.
pub fn trainer_scene<'a, R>(
    rooms: impl IntoIterator<Item = (&'a str, R)>,
    wording: &PromptWording,
) -> String
where
    R: IntoIterator<Item = &'a str>,
{
    let mut text = wording.scene_heading.clone();
    for (number, (room, receptacles)) in (1..).zip(rooms) {
        let receptacles: Vec<&str> = receptacles.into_iter().collect();
        text.push_str(&format!(
            "{number}) In {room}: {}.\n",
            receptacles.join(", ")
        ));
    }
    text
}

/// The scene in a prompt of the evaluation agents: rooms and receptacles sorted, `/` and blanks in
/// a room's name as `_`.
pub fn agent_scene<'a, R>(rooms: impl IntoIterator<Item = (&'a str, R)>) -> String
where
    R: IntoIterator<Item = &'a str>,
{
    let sorted = |receptacles: R| {
        let mut receptacles: Vec<&str> = receptacles.into_iter().collect();
        receptacles.sort_unstable();
        receptacles.join(", ")
    };
    let mut rooms: Vec<(&str, String)> = rooms
        .into_iter()
        .map(|(room, receptacles)| (room, sorted(receptacles)))
        .collect();
    rooms.sort_unstable();
    let line = |(number, (room, receptacles)): (usize, (&str, String))| {
        format!(
            "{number}) In {}: {receptacles}.",
            room.replace(['/', ' '], "_")
        )
    };
    (1..).zip(rooms).map(line).collect::<Vec<_>>().join("\n")
}

/// The tools of a server as the Qwen agent lists them: a line each, keys sorted.
/// `tools` are MCP tools.
pub fn prompt_tools(tools: &[Value]) -> String {
    let line = |tool: &Value| {
        let shown = json!({"description": tool["description"], "name": tool["name"], "parameters": sorted(&tool["inputSchema"])});
        format!("- {}", python::dumps(&shown, Ascii::Plain))
    };
    tools.iter().map(line).collect::<Vec<_>>().join("\n")
}

/// MCP tools as functions of an OpenAI-compatible endpoint.
pub fn openai_tools(tools: &[Value]) -> Vec<Value> {
    let function = |tool: &Value| json!({"name": tool["name"], "description": tool["description"], "parameters": tool["inputSchema"]});
    tools
        .iter()
        .map(|tool| json!({"type": "function", "function": function(tool)}))
        .collect()
}

/// MCP tools as the trainer describes them: a line each, optional arguments in brackets,
/// descriptions cut at 80 characters.
pub fn tools_description(tools: &[Value], wording: &PromptWording) -> String {
    if tools.is_empty() {
        return wording.no_tools.clone();
    }
    let line = |tool: &Value| {
        let schema = &tool["inputSchema"];
        let required = |name: &str| {
            schema["required"]
                .as_array()
                .is_some_and(|names| names.iter().any(|it| it == name))
        };
        let arguments = schema["properties"]
            .as_object()
            .into_iter()
            .flat_map(Map::keys);
        let arguments = arguments.map(|name| {
            if required(name) {
                name.clone()
            } else {
                format!("[{name}]")
            }
        });
        let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
        let description = text(&tool["description"]);
        let arguments = arguments.collect::<Vec<_>>().join(", ");
        format!(
            "- {}({arguments}): {}",
            text(&tool["name"]),
            python::prefix(&description, 80)
        )
    };
    tools.iter().map(line).collect::<Vec<_>>().join("\n")
}

fn sorted(value: &Value) -> Value {
    match value {
        Value::Object(object) => {
            let mut entries: Vec<(String, Value)> = object
                .iter()
                .map(|(key, value)| (key.clone(), sorted(value)))
                .collect();
            entries.sort_by(|one, other| one.0.cmp(&other.0));
            Value::Object(entries.into_iter().collect())
        }
        Value::Array(items) => items.iter().map(sorted).collect(),
        other => other.clone(),
    }
}
