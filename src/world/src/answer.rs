//! What a model answered: reasoning, the summary, the call (docs/spec.md#answers). As
//! lenient as the published parser: what does not parse is absent. Owns no check of the
//! call: the tools do that.

use serde_json::{Deserializer, Map, Value};

use crate::record::PolicyOutput;

/// Places in a text that are tried as the beginning of a JSON object.
const TRIES_MAX: usize = 1000;

/// A call of a tool.
#[derive(Clone, PartialEq, Debug)]
pub struct Call {
    /// The tool, as named.
    pub name: String,
    /// The arguments: an object, or whatever was written instead.
    pub arguments: Value,
    /// The call's id, where the format has one.
    pub id: Option<String>,
}

/// An assistant's turn, read.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct AssistantTurn {
    /// The text up to `</think>`, and what stands before the JSON.
    pub reasoning: String,
    /// The `History` of the answer in words, or `None` if it has none.
    pub history: Option<String>,
    /// `New Schedule`, in words.
    pub schedule: Option<String>,
    /// `Current subtask`, in words.
    pub subtask: Option<String>,
    /// The next tool call that the answer names, or `None` if none parses.
    pub action: Option<Call>,
    /// The whole JSON object.
    pub object: Option<Map<String, Value>>,
}

impl AssistantTurn {
    /// Reads the message of a model that calls functions: its `content` is the answer,
    /// where it has one.
    pub fn of_message(message: &Value) -> Self {
        message
            .get("content")
            .map(|content| Self::parse(&plain(content)))
            .unwrap_or_default()
    }

    /// Reads an answer; what does not parse is absent.
    pub fn parse(text: &str) -> Self {
        let (thought, rest) = text.rsplit_once("</think>").unwrap_or(("", text));
        let (before, object) = first_object(rest);
        let thought = thought.trim();
        let spoken = [
            thought.strip_prefix("<think>").unwrap_or(thought).trim(),
            without_fence(before),
        ];
        let reasoning = spoken
            .into_iter()
            .filter(|part| !part.is_empty())
            .collect::<Vec<_>>()
            .join("\n");
        let Some(object) = object else {
            return Self {
                reasoning,
                ..Self::default()
            };
        };
        let summary = field(&object, &["summary"]);
        let inner = match summary {
            Some(Value::Object(inner)) => inner,
            _ => &object,
        };
        let words = |name: &str| field(inner, &[name]).map(plain);
        let history = words("history").or_else(|| summary.filter(|it| !it.is_object()).map(plain));
        Self {
            reasoning,
            history,
            schedule: words("new_schedule"),
            subtask: words("current_subtask"),
            action: action_of(&object),
            object: Some(object),
        }
    }
}

impl AssistantTurn {
    /// Reasoning, History and plan as a trace keeps them, without the raw text.
    pub fn output(&self) -> PolicyOutput {
        let plan = [
            ("New Schedule", &self.schedule),
            ("Current subtask", &self.subtask),
        ];
        let plan = plan
            .into_iter()
            .filter_map(|(key, words)| Some(format!("{key}: {}", words.as_ref()?)));
        PolicyOutput {
            reasoning: self.reasoning.clone(),
            history: self.history.clone().unwrap_or_default(),
            plan: plan.collect::<Vec<_>>().join(" "),
            ..PolicyOutput::default()
        }
    }
}

impl Call {
    /// Reads `{name | tool_name | function, args | arguments}`; arguments that are a JSON text
    /// are read as JSON.
    pub fn of_value(value: &Value) -> Option<Self> {
        let object = value.as_object()?;
        let id = object.get("id").and_then(Value::as_str).map(str::to_owned);
        let object = object
            .get("function")
            .and_then(Value::as_object)
            .unwrap_or(object);
        let name = field(object, &["tool_name", "name"])?.as_str()?.to_owned();
        let arguments = field(object, &["args", "arguments", "parameters"])
            .cloned()
            .unwrap_or_default();
        let arguments = match &arguments {
            Value::String(text) => serde_json::from_str(text).unwrap_or(arguments),
            _ => arguments,
        };
        Some(Self {
            name,
            arguments,
            id,
        })
    }

    /// The call in one line whose keys are in order, so that equal calls are equal texts.
    pub fn canonical(&self) -> String {
        let arguments = match &self.arguments {
            Value::Null => Value::Object(Map::new()),
            other => sorted(other),
        };
        format!("{}({arguments})", self.name)
    }
}

/// The action of an answer's object, or the object itself where it is a bare call.
fn action_of(object: &Map<String, Value>) -> Option<Call> {
    let named = field(object, &["next_action", "action"]).and_then(Call::of_value);
    named.or_else(|| {
        let bare = field(object, &["args", "arguments"]).is_some();
        bare.then(|| Call::of_value(&Value::Object(object.clone())))
            .flatten()
    })
}

/// The first JSON object of a text, and what stands before it; all of the text where there is none.
fn first_object(text: &str) -> (&str, Option<Map<String, Value>>) {
    for (at, _) in text.match_indices('{').take(TRIES_MAX) {
        if let Some(Ok(object)) = Deserializer::from_str(&text[at..])
            .into_iter::<Map<String, Value>>()
            .next()
        {
            return (&text[..at], Some(object));
        }
    }
    (text, None)
}

/// `New Schedule` and `new_schedule` are the same key.
fn field<'m>(object: &'m Map<String, Value>, names: &[&str]) -> Option<&'m Value> {
    let same = |key: &str, name: &str| {
        key == name || key.trim().to_lowercase().replace([' ', '-'], "_") == name
    };
    names.iter().find_map(|name| {
        object
            .iter()
            .find(|(key, _)| same(key, name))
            .map(|(_, value)| value)
    })
}

fn without_fence(text: &str) -> &str {
    let text = text.trim();
    text.strip_suffix("json")
        .unwrap_or(text)
        .trim_end_matches('`')
        .trim()
}

/// A value in words: strings as they are, the items of a list one after the other, of the parts of
/// a message (`{"type": "text", "text": ...}`) their texts.
fn plain(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        Value::Array(items) => items
            .iter()
            .map(plain)
            .filter(|text| !text.is_empty())
            .collect::<Vec<_>>()
            .join("; "),
        Value::Object(part) if part.get("text").is_some_and(Value::is_string) => {
            plain(&part["text"])
        }
        other => other.to_string(),
    }
}

fn sorted(value: &Value) -> Value {
    match value {
        Value::Object(map) => {
            let mut entries: Vec<(String, Value)> = map
                .iter()
                .map(|(key, value)| (key.clone(), sorted(value)))
                .collect();
            entries.sort_by(|a, b| a.0.cmp(&b.0));
            Value::Object(entries.into_iter().collect())
        }
        Value::Array(items) => items.iter().map(sorted).collect(),
        other => other.clone(),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde_json::json;

    use super::*;

    #[test]
    fn what_the_published_parser_takes() {
        let fenced = r#"<think>it is red</think>
```json
{"summary": {"History": "went", "New Schedule": ["pick", "place"], "Current subtask": "pick it"},
 "next action": {"name": "pick", "arguments": "{\"marker_id\": 1}"}}
```"#;
        let answer = AssistantTurn::parse(fenced);
        assert_eq!(answer.reasoning, "it is red");
        assert_eq!(answer.history.as_deref(), Some("went"));
        assert_eq!(answer.schedule.as_deref(), Some("pick; place"));
        assert_eq!(answer.subtask.as_deref(), Some("pick it"));
        let action = answer.action.expect("it has one");
        assert_eq!(
            (action.name.as_str(), &action.arguments),
            ("pick", &json!({"marker_id": 1}))
        );
        let plain = AssistantTurn::parse(
            r#"so {"summary": "went", "action": {"tool_name": "finish", "args": {}}}"#,
        );
        assert_eq!(
            (plain.reasoning.as_str(), plain.history.as_deref()),
            ("so", Some("went"))
        );
        assert_eq!(plain.action.expect("it has one").canonical(), "finish({})");
        assert_eq!(AssistantTurn::parse("I {do not} know").action, None);
    }

    #[test]
    fn the_order_of_keys_is_no_difference() {
        let one = AssistantTurn::parse(
            r#"{"next_action": {"tool_name": "ask", "args": {"b": 1, "a": {"d": 1, "c": 2}}}}"#,
        );
        let other = AssistantTurn::parse(
            r#"{"next_action": {"tool_name": "ask", "args": {"a": {"c": 2, "d": 1}, "b": 1}}}"#,
        );
        assert_eq!(
            one.action.map(|it| it.canonical()),
            other.action.map(|it| it.canonical())
        );
    }

    proptest! {
        #[test]
        fn nothing_panics(text in "(\\PC|[{}\"\\[\\]:,]|</think>|```|summary|next_action){0,200}") {
            let _ = AssistantTurn::parse(&text);
        }
    }
}
