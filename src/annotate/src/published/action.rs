//! Actions of the published annotation: what an event means, and its text.

use reel_prompt::python::{self, Ascii};
use serde_json::{Map, Value, json};

/// The argument of each tool under its old name; tools that take none have none.
const PARAMETERS: &[(&str, Option<&str>)] = &[
    ("nav_to", Some("receptacle_name")),
    ("walk_around", None),
    ("show_object_by_category", Some("target_category")),
    ("show_receptacles", None),
    ("gaze_at", Some("marker_id")),
    ("pick", Some("marker_id")),
    ("place", Some("marker_id")),
    ("open", Some("receptacle_name")),
    ("close", Some("receptacle_name")),
    ("ask", Some("question")),
    ("finish", None),
];
/// Where the argument of a tool that is not known stands.
const UNNAMED: &str = "value";
/// Before a category, in events that say one in a sentence.
const CATEGORY: &str = "of category ";

/// An action as its name and its arguments.
pub(super) fn call(action: &Map<String, Value>) -> Option<Value> {
    let [(name, payload)] = action.iter().collect::<Vec<_>>()[..] else {
        return None;
    };
    let name = if name == "walkaround" {
        "walk_around"
    } else {
        name
    };
    let parameter = PARAMETERS
        .iter()
        .find(|(tool, _)| *tool == name)
        .map(|(_, parameter)| *parameter);
    let args = match (parameter, literal(payload)) {
        (Some(None), _) | (_, Value::Null) => Map::new(),
        (_, Value::Object(args)) => args,
        (parameter, value) => {
            Map::from_iter([(parameter.flatten().unwrap_or(UNNAMED).to_owned(), value)])
        }
    };
    Some(json!({ "tool_name": name, "args": args }))
}

/// The text of a normalised action, `{tool: payload}`: `{"tool_name": ..., "args": {...}}`; empty
/// if there is none. A mapping of several keys is written as it is.
pub fn action_text(action: &Map<String, Value>) -> String {
    match call(action) {
        Some(call) => python::dumps(&call, Ascii::Plain),
        None if action.is_empty() => String::new(),
        None => python::dumps(&Value::Object(action.clone()), Ascii::Plain),
    }
}

/// An event as `{tool: payload}`. `None` if it names no tool that moves, looks or acts.
pub fn normalise(event: &Map<String, Value>) -> Option<Map<String, Value>> {
    let one = |name: &str, payload: Value| Some(Map::from_iter([(name.to_owned(), payload)]));
    if let Some(name) = event.get("action").and_then(Value::as_str) {
        let payload = event.get("payload").cloned().unwrap_or_default();
        let is_place_name = name == "nav_to" && payload.is_string();
        return one(
            name,
            if is_place_name {
                json!({ "receptacle_name": payload })
            } else {
                payload
            },
        );
    }
    let [(name, payload)] = event.iter().collect::<Vec<_>>()[..] else {
        return None;
    };
    match (name.as_str(), payload) {
        ("nav_to", Value::Object(args)) => match args.get("name") {
            Some(receptacle) if !args.contains_key("receptacle_name") => {
                one(name, json!({ "receptacle_name": receptacle }))
            }
            _ => one(name, payload.clone()),
        },
        ("pick" | "gaze_at", Value::Number(marker)) => {
            one(name, json!({ "marker_id": marker.to_string() }))
        }
        ("show_objects", Value::String(sentence)) => match sentence.split_once(CATEGORY) {
            Some((_, category)) => one(
                "show_object_by_category",
                json!({ "target_category": python::strip(category) }),
            ),
            None => one(name, payload.clone()),
        },
        ("show_receptacles", _) => one(name, json!("")),
        ("walkaround" | "walk_around", Value::String(text)) => {
            one("walk_around", json!({ "text": text }))
        }
        ("walkaround" | "walk_around", _) => one("walk_around", payload.clone()),
        (
            "nav_to"
            | "pick"
            | "gaze_at"
            | "place"
            | "open"
            | "close"
            | "show_objects"
            | "show_object_by_category",
            _,
        ) => one(name, payload.clone()),
        _ => None,
    }
}

/// A payload whose texts that are mappings in Python's notation stand for what
/// they hold: `{'marker_id': '4'}`.
fn literal(payload: &Value) -> Value {
    let parse = |text: &str| match text.trim_start().starts_with('{') {
        true => python::loads(text)
            .or_else(|| python::loads(&text.replace('\'', "\"")))
            .filter(Value::is_object),
        false => None,
    };
    match payload {
        Value::String(text) => parse(text).unwrap_or_else(|| payload.clone()),
        Value::Object(args) => {
            let inner = |(name, value): (&String, &Value)| {
                let held = value
                    .as_str()
                    .and_then(parse)
                    .and_then(|mapping| mapping.get(name).cloned());
                (name.clone(), held.unwrap_or_else(|| value.clone()))
            };
            Value::Object(args.iter().map(inner).collect())
        }
        other => other.clone(),
    }
}
