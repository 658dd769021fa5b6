//! What the published annotation keeps of a model's answer.

use std::ops::Range;

use reel_prompt::python;
use serde_json::{Map, Value, json};

/// The text of the first JSON object of an answer, its special tokens (`<|...|>`) left out. An
/// object that does not end goes to the end of the text; empty if none begins.
pub fn json_text(answer: &str) -> String {
    let text = without_special_tokens(answer);
    let Some(start) = text.find('{') else {
        return String::new();
    };
    let text = &text[start..];
    let (mut depth, mut in_string, mut escaped) = (0, false, false);
    for (at, letter) in text.char_indices() {
        match letter {
            _ if escaped => escaped = false,
            '\\' if in_string => escaped = true,
            '"' => in_string = !in_string,
            '{' if !in_string => depth += 1,
            '}' if !in_string => {
                depth -= 1;
                if depth == 0 {
                    return text[..=at].to_owned();
                }
            }
            _ => {}
        }
    }
    python::strip(text).to_owned()
}

/// What an annotated step says.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Thought {
    /// `CoT`: why the action is taken.
    pub reasoning: String,
    /// `History`: in an answer the last result alone, in a sample the numbered list of all.
    pub history: String,
    /// `New Schedule`; `None` if the answer has none.
    pub schedule: Option<Vec<String>>,
    /// What the agent does now; key `Current subtask` of the answer.
    pub subtask: String,
    /// `Last Action`, as the answer has it.
    pub last_action: Option<Value>,
}

/// Reads an answer. `None` if its first object is no JSON, even when line breaks within
/// its texts are allowed.
pub fn thought(answer: &str) -> Option<Thought> {
    let text = json_text(answer);
    let Value::Object(object) =
        python::loads(&text).or_else(|| python::loads(&with_escaped_breaks(&text)))?
    else {
        return None;
    };
    let nothing = Map::new();
    let summary = object
        .get("Summary")
        .and_then(Value::as_object)
        .unwrap_or(&nothing);
    Some(Thought {
        reasoning: told(object.get("CoT")),
        history: told(summary.get("History")),
        schedule: summary.get("New Schedule").and_then(schedule),
        subtask: told(summary.get("Current subtask")),
        last_action: summary.get("Last Action").cloned(),
    })
}

impl Thought {
    /// In the published form, keys in its order.
    pub fn to_json(&self) -> Value {
        let Thought {
            reasoning,
            history,
            schedule,
            subtask,
            last_action,
        } = self;
        let mut summary =
            json!({ "History": history, "New Schedule": schedule, "Current subtask": subtask });
        if let Some(action) = last_action {
            summary["Last Action"] = action.clone();
        }
        json!({ "CoT": reasoning, "Summary": summary })
    }
}

/// A value as text; empty if it is absent or null.
fn told(value: Option<&Value>) -> String {
    value
        .filter(|value| !value.is_null())
        .map(python::str)
        .unwrap_or_default()
}

/// The items of a schedule: of a list those that are not empty, of a text what stands on lines,
/// after numbers (`1. `, `1) `), after bullets or between semicolons. `None` if there is none.
fn schedule(value: &Value) -> Option<Vec<String>> {
    let items: Vec<String> = match value {
        Value::Array(items) => items.iter().map(|item| told(Some(item))).collect(),
        Value::String(text) => {
            let parts = text
                .lines()
                .flat_map(numbered)
                .flat_map(|part| part.split(';'));
            parts
                .map(|part| {
                    python::strip(part)
                        .trim_start_matches(['-', '*', '•'])
                        .to_owned()
                })
                .collect()
        }
        _ => Vec::new(),
    };
    let items: Vec<String> = items
        .iter()
        .map(|item| python::strip(item).to_owned())
        .filter(|item| !item.is_empty())
        .collect();
    (!items.is_empty()).then_some(items)
}

/// The parts of a line between its numbers.
fn numbered(line: &str) -> Vec<&str> {
    let mut parts = Vec::new();
    let mut start = 0;
    for Range { start: from, end } in numbers(line) {
        parts.push(&line[start..from]);
        start = end;
    }
    parts.push(&line[start..]);
    parts
}

/// Where the numbers of a list stand: digits and `.` or `)`, with a blank or nothing on both sides.
fn numbers(line: &str) -> Vec<Range<usize>> {
    let mut found = Vec::new();
    let mut at = 0;
    for word in line.split_inclusive(char::is_whitespace) {
        let digits = word.trim_end().trim_end_matches(['.', ')']);
        let ends = word.trim_end().len() - digits.len() == 1;
        if ends && !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit()) {
            found.push(at..at + word.len());
        }
        at += word.len();
    }
    found
}

fn without_special_tokens(text: &str) -> String {
    let mut kept = String::with_capacity(text.len());
    let mut rest = text;
    while let Some((before, after)) = rest.split_once("<|") {
        kept.push_str(before);
        match after.split_once("|>") {
            Some((name, after)) if !name.contains(['{', '}', '"']) => rest = after,
            _ => {
                kept.push_str("<|");
                rest = after;
            }
        }
    }
    kept + rest
}

/// The text with line breaks within strings escaped.
fn with_escaped_breaks(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let (mut in_string, mut escaped) = (false, false);
    for letter in text.chars() {
        match letter {
            '\n' if in_string => out.push_str("\\n"),
            other => out.push(other),
        }
        match letter {
            _ if escaped => escaped = false,
            '\\' if in_string => escaped = true,
            '"' => in_string = !in_string,
            _ => {}
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schedules_in_all_their_forms() {
        let of = |text: &str| schedule(&json!(text)).unwrap_or_default().join("|");
        assert_eq!(
            of("1. take the key 2. open 3.5 doors"),
            "take the key|open 3.5 doors"
        );
        assert_eq!(of("1) look\n\n* wait; sleep"), "look|wait|sleep");
        assert_eq!(of(" ;\n1."), "");
        assert_eq!(
            schedule(&json!(["", null, 4, " x "])),
            Some(vec!["4".to_owned(), "x".to_owned()])
        );
    }

    #[test]
    fn an_object_is_found_among_tokens_and_braces_in_texts() {
        assert_eq!(
            json_text(r#"<|begin|>ok <|x {"a": "<|end|>}"} more"#),
            r#"<|x {"a": "}"} more"#[4..].trim_end_matches(" more")
        );
        assert_eq!(json_text("{\"a\": \"\\\"}\" \n"), "{\"a\": \"\\\"}\"");
        let broken = "{\"CoT\": \"one\n\\\"two\\\"\", \"Summary\": {}}";
        assert_eq!(thought(broken).unwrap().reasoning, "one\n\"two\"");
        assert_eq!(thought("[1]"), None);
    }
}
