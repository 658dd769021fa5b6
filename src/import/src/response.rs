//! What the policy said: `raw_response.txt` (reasoning, then JSON) or `raw_response.json` (a message of function calling)
//! as reasoning, history and plan. As lenient as REAL's own parser (SPEC section 4); what does not parse stays raw.

use reel_world::record::PolicyOutput;
use serde_json::{Deserializer, Map, Value};

/// Places in a text that are tried as the beginning of a JSON object.
const TRIES_MAX: usize = 1000;

/// The two forms of a raw response.
pub(crate) enum Raw {
    /// `raw_response.txt`
    Text(String),
    /// `raw_response.json`
    Json(String),
}

/// Reads what can be read of a raw response; the raw text is kept as it came.
pub(crate) fn parse(raw: Raw) -> PolicyOutput {
    match raw {
        Raw::Text(text) => PolicyOutput { raw: text.clone(), ..of_text(&text) },
        Raw::Json(text) => {
            let message: Option<Value> = serde_json::from_str(&text).ok();
            let content = message.as_ref().and_then(|message| message.get("content")).map(plain).unwrap_or_default();
            PolicyOutput { raw: text, ..of_text(&content) }
        }
    }
}

fn of_text(text: &str) -> PolicyOutput {
    let (thought, answer) = text.rsplit_once("</think>").unwrap_or(("", text));
    let (before, object) = first_object(answer);
    let thought = thought.trim();
    let spoken = without_fence(before);
    let reasoning = [thought.strip_prefix("<think>").unwrap_or(thought).trim(), spoken];
    let reasoning = reasoning.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("\n");
    let mut output = PolicyOutput { reasoning, ..PolicyOutput::default() };
    match object.as_ref().and_then(|object| object.get("summary")) {
        Some(Value::Object(summary)) => {
            let of = |wanted: &str| summary.iter().find(|(key, _)| key_of(key) == wanted).map(|(_, value)| plain(value));
            output.history = of("history").unwrap_or_default();
            output.plan = match (of("new_schedule"), of("current_subtask")) {
                (None, None) => String::new(),
                (Some(schedule), None) => format!("New Schedule: {schedule}"),
                (None, Some(subtask)) => format!("Current subtask: {subtask}"),
                (Some(schedule), Some(subtask)) => format!("New Schedule: {schedule} Current subtask: {subtask}"),
            };
        }
        Some(other) => output.history = plain(other),
        None => {}
    }
    output
}

/// The first JSON object of a text, and what stands before it; all of the text where there is none.
fn first_object(text: &str) -> (&str, Option<Map<String, Value>>) {
    for (at, _) in text.match_indices('{').take(TRIES_MAX) {
        if let Some(Ok(object)) = Deserializer::from_str(&text[at..]).into_iter::<Map<String, Value>>().next() {
            return (&text[..at], Some(object));
        }
    }
    (text, None)
}

/// `New Schedule` and `new_schedule` are the same key.
fn key_of(key: &str) -> String {
    key.trim().to_lowercase().replace([' ', '-'], "_")
}

fn without_fence(text: &str) -> &str {
    let text = text.trim();
    text.strip_suffix("json").unwrap_or(text).trim_end_matches('`').trim()
}

/// A value in words: strings as they are, the items of a list one after the other.
fn plain(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        Value::Array(items) => items.iter().map(item).filter(|text| !text.is_empty()).collect::<Vec<_>>().join("; "),
        other => other.to_string(),
    }
}

/// An item of a list; of a part of a message (`{"type": "text", "text": ...}`) its text.
fn item(value: &Value) -> String {
    value.get("text").and_then(Value::as_str).map_or_else(|| plain_leaf(value), str::to_owned)
}

fn plain_leaf(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn text(text: &str) -> [String; 3] {
        let output = parse(Raw::Text(text.to_owned()));
        assert_eq!(output.raw, text);
        [output.reasoning, output.history, output.plan]
    }

    #[test]
    fn what_reals_parser_takes() {
        let json = r#"{"summary": {"History": "went", "New Schedule": ["pick", "place"], "Current subtask": "pick it"},
            "next action": {"tool_name": "pick", "args": {"marker_id": "1"}}}"#;
        let expected = ["it is red", "went", "New Schedule: pick; place Current subtask: pick it"].map(str::to_owned);
        assert_eq!(text(&format!("<think>it is red</think>\n```json\n{json}\n```\n")), expected);
        assert_eq!(text(&format!("it is red\n```json\n{json}\n```")), expected);
        assert_eq!(text(&format!("it is red {json}")), expected);
        let lower = r#"it is red</think>{"summary":{"history":"went"},"action":{"name":"finish"}}"#;
        assert_eq!(text(lower), ["it is red", "went", ""].map(str::to_owned));
        assert_eq!(text(r#"{"summary": "went there", "next_action": {}}"#), ["", "went there", ""].map(str::to_owned));
        assert_eq!(text("I {do not} know"), ["I {do not} know", "", ""].map(str::to_owned));
    }

    #[test]
    fn a_message_of_function_calling() {
        let message = r#"{"role": "assistant", "content": "I look.", "tool_calls": []}"#;
        let output = parse(Raw::Json(message.to_owned()));
        assert_eq!((output.raw.as_str(), output.reasoning.as_str()), (message, "I look."));
        let parts = r#"{"content": [{"type": "text", "text": "I"}, {"type": "text", "text": "look."}]}"#;
        assert_eq!(parse(Raw::Json(parts.to_owned())).reasoning, "I; look.");
        assert_eq!(parse(Raw::Json("{\"content\": nul".to_owned())).reasoning, "");
    }

    proptest! {
        #[test]
        fn nothing_panics(text in "(\\PC|[{}\"\\[\\]:,]|</think>|```|summary){0,200}") {
            let _ = parse(Raw::Json(text.clone()));
            prop_assert_eq!(&parse(Raw::Text(text.clone())).raw, &text);
        }
    }
}
