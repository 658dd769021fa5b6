//! Where an agent leaves a recording: the first call that differs, and what differs in it.

use std::{
    fmt,
    sync::{Arc, LazyLock},
};

use reel_redact::{Redactor, Rules, Scope, is_recorded_as};
use reel_world::ToolCall;
use serde::Serialize;
use serde_json::{Map, Value, json};

/// What the first difference between a call and the recorded one is.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DeviationKind {
    /// Another tool was called.
    Tool,
    /// An argument has another value or type, is missing, or was added.
    Argument,
    /// A call was made after the recording's last.
    ExtraCall,
    /// The agent stopped before a recorded call.
    MissingCall,
}

/// One difference between a call and the recorded one.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Difference {
    /// `tool`, `arguments.NAME`, `arguments` where one of them is no object, or `call` where there
    /// is only one of the two calls.
    pub field: String,
    /// What the recording has there; `None` if nothing.
    pub expected: Option<Value>,
    /// What the agent sent there; `None` if nothing.
    pub actual: Option<Value>,
}

/// Where an agent left a recording.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Deviation {
    /// Index of the call, from 0.
    pub step: u32,
    /// What the first difference is.
    pub kind: DeviationKind,
    /// Name of the first argument that differs; `None` if something else differs.
    pub argument: Option<String>,
    /// The recorded call; `None` after the last one.
    pub expected: Option<ToolCall>,
    /// The call that was made; `None` if the agent stopped.
    pub actual: Option<ToolCall>,
    /// Index of the recorded call that the call equals and that was to come soon after; `None` where
    /// it equals no such call.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recorded_as: Option<u32>,
    /// All differences between the two, the first one first: the tool, then the recorded arguments
    /// in their order, then the added ones.
    pub differences: Vec<Difference>,
}

/// How a call deviates from the recorded one at this step; `None` if they are equal. The order of
/// the arguments does not count; types do: `1` is not `"1"`.
pub fn deviation(
    step: u32,
    expected: Option<&ToolCall>,
    actual: Option<&ToolCall>,
) -> Option<Deviation> {
    // What the agent says goes into reports, its secrets do not.
    let redacted = actual.map(without_secrets);
    let told = redacted.as_ref();
    let (kind, differences) = match (expected, actual) {
        (None, None) => return None,
        (Some(call), None) => (DeviationKind::MissingCall, vec![whole(Some(call), None)]),
        (None, Some(_)) => (DeviationKind::ExtraCall, vec![whole(None, told)]),
        (Some(expected), Some(actual)) => {
            let differences = differences(expected, actual);
            let kind = match differences.first()?.field.as_str() {
                "tool" => DeviationKind::Tool,
                _ => DeviationKind::Argument,
            };
            (kind, differences)
        }
    };
    let argument = differences
        .first()
        .filter(|_| kind == DeviationKind::Argument)
        .and_then(|first| first.field.strip_prefix(ARGUMENT))
        .map(str::to_owned);
    Some(Deviation {
        step,
        kind,
        argument,
        expected: expected.cloned(),
        actual: redacted,
        recorded_as: None,
        differences,
    })
}

/// A call with labels in the place of secrets.
fn without_secrets(call: &ToolCall) -> ToolCall {
    static RULES: LazyLock<Arc<Rules>> = LazyLock::new(|| Arc::new(Rules::built_in()));
    let mut redactor = Redactor::new(RULES.clone());
    let mut call = call.clone();
    redactor.value("arguments", &mut call.arguments, Scope::Data);
    call
}

/// What stands before the name of an argument in a field.
const ARGUMENT: &str = "arguments.";

fn whole(expected: Option<&ToolCall>, actual: Option<&ToolCall>) -> Difference {
    let value = |call: &ToolCall| json!(call);
    Difference {
        field: "call".to_owned(),
        expected: expected.map(value),
        actual: actual.map(value),
    }
}

fn differences(expected: &ToolCall, actual: &ToolCall) -> Vec<Difference> {
    let mut found = Vec::new();
    if expected.name != actual.name {
        found.push(Difference {
            field: "tool".to_owned(),
            expected: Some(json!(expected.name)),
            actual: Some(json!(actual.name)),
        });
    }
    match (object(&expected.arguments), object(&actual.arguments)) {
        (Some(expected), Some(arguments)) => {
            let told = without_secrets(actual).arguments;
            compare_arguments(&expected, &arguments, &told, &mut found);
        }
        _ if expected.arguments != actual.arguments => found.push(Difference {
            field: "arguments".to_owned(),
            expected: Some(expected.arguments.clone()),
            actual: Some(without_secrets(actual).arguments),
        }),
        _ => {}
    }
    found
}

/// The arguments by name: a call without any has none.
fn object(arguments: &Value) -> Option<Map<String, Value>> {
    match arguments {
        Value::Null => Some(Map::new()),
        Value::Object(map) => Some(map.clone()),
        _ => None,
    }
}

fn compare_arguments(
    expected: &Map<String, Value>,
    actual: &Map<String, Value>,
    told: &Value,
    found: &mut Vec<Difference>,
) {
    let names = expected.keys();
    let added = actual.keys().filter(|name| !expected.contains_key(*name));
    for name in names.chain(added) {
        let (expected, actual) = (expected.get(name), actual.get(name));
        // A recording of another server holds labels where the agent said secrets, and 0 where these were numbers.
        let same = match (expected, actual) {
            (Some(expected), Some(actual)) => {
                let as_told = || {
                    told.get(name)
                        .is_some_and(|it| is_recorded_as(it, expected))
                };
                is_recorded_as(actual, expected) || as_told()
            }
            _ => expected == actual,
        };
        if !same {
            found.push(Difference {
                field: format!("{ARGUMENT}{name}"),
                expected: expected.cloned(),
                actual: actual.map(|actual| told.get(name).unwrap_or(actual).clone()),
            });
        }
    }
}

impl fmt::Display for Deviation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "call {}: ", self.step)?;
        match (&self.expected, &self.actual) {
            (Some(expected), None) => {
                return write!(f, "the agent stopped before {expected}");
            }
            (None, Some(actual)) => {
                return write!(f, "{actual} after the last recorded call");
            }
            _ => {}
        }
        let Some(first) = self.differences.first() else {
            return write!(f, "no difference");
        };
        let told = |value: &Option<Value>| value.as_ref().map_or("none".into(), Value::to_string);
        let (expected, actual) = (told(&first.expected), told(&first.actual));
        let tool = self.expected.as_ref().map_or("", |call| &call.name);
        match (self.kind, &self.argument) {
            (DeviationKind::Tool, _) => {
                let [expected, actual] = [&self.expected, &self.actual]
                    .map(|call| call.as_ref().map_or_else(String::new, ToString::to_string));
                write!(f, "tool: expected {expected}, actual {actual}")?;
            }
            (_, Some(name)) => write!(
                f,
                "{tool}, argument {name}: expected {expected}, actual {actual}"
            )?,
            _ => write!(f, "{tool}, arguments: expected {expected}, actual {actual}")?,
        }
        match self.recorded_as {
            Some(later) => write!(
                f,
                "; the call is recorded as call {later}: calls made at once come in any order"
            ),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn call(name: &str, arguments: Value) -> ToolCall {
        ToolCall::new(name, arguments)
    }

    #[test]
    fn secrets_are_neither_a_difference_nor_told() {
        let recorded = call(
            "login",
            json!({"password": "[redacted:password#1]", "line": "run --token=[redacted:token#1] now"}),
        );
        let said =
            |password: &str, line: &str| call("login", json!({"password": password, "line": line}));
        let line = "run --token=sk-abcdefghijklmnop now";
        assert_eq!(
            deviation(0, Some(&recorded), Some(&said("hunter2", line))),
            None
        );
        let found = deviation(0, Some(&recorded), Some(&said("hunter2", "run"))).unwrap();
        assert_eq!(found.argument.as_deref(), Some("line"));
        assert!(!format!("{found:?}").contains("hunter2"), "{found:?}");
        let found = deviation(1, None, Some(&said("hunter2", line))).unwrap();
        assert!(!format!("{found:?}{found}").contains("hunter2"), "{found}");
    }

    #[test]
    fn numbers_that_are_secrets_are_no_difference() {
        let said = |token: u32, side: u32| {
            let text = json!({"next_token": token}).to_string();
            call("next", json!({"token": token, "text": text, "side": side}))
        };
        let recorded = said(0, 1);
        assert_eq!(deviation(0, Some(&recorded), Some(&said(424_242, 1))), None);
        let found = deviation(0, Some(&recorded), Some(&said(424_242, 2))).unwrap();
        assert_eq!(found.argument.as_deref(), Some("side"));
        assert!(!format!("{found:?}{found}").contains("424242"), "{found:?}");
    }

    #[test]
    fn the_first_difference_is_the_tool_then_recorded_arguments_then_added_ones() {
        let recorded = call("place", json!({"receptacle_name": "a", "side": 1}));
        let at = |actual: &ToolCall| deviation(3, Some(&recorded), Some(actual));
        assert_eq!(
            at(&call("place", json!({"side": 1, "receptacle_name": "a"}))),
            None
        );
        let found = at(&call("put", json!({"receptacle_name": "b", "side": 1}))).unwrap();
        assert_eq!(
            (found.kind, found.argument.clone()),
            (DeviationKind::Tool, None)
        );
        assert_eq!(found.differences.len(), 2, "{found}");
        let found = at(&call(
            "place",
            json!({"fast": true, "receptacle_name": "a", "side": "1"}),
        ));
        let found = found.unwrap();
        assert_eq!(found.argument.as_deref(), Some("side"), "{found}");
        assert_eq!(
            found.to_string(),
            "call 3: place, argument side: expected 1, actual \"1\""
        );
        let fields: Vec<&str> = found
            .differences
            .iter()
            .map(|it| it.field.as_str())
            .collect();
        assert_eq!(fields, ["arguments.side", "arguments.fast"]);
        let found = at(&call("place", json!({"receptacle_name": "a"}))).unwrap();
        assert!(
            found.to_string().ends_with("expected 1, actual none"),
            "{found}"
        );
    }

    #[test]
    fn a_call_that_came_early_is_told_where_it_is_recorded() {
        let recorded = call("read", json!({"name": "a"}));
        let left = deviation(
            0,
            Some(&recorded),
            Some(&call("read", json!({"name": "b"}))),
        )
        .unwrap();
        assert_eq!(
            left.to_string(),
            "call 0: read, argument name: expected \"a\", actual \"b\""
        );
        let early = Deviation {
            recorded_as: Some(2),
            ..left
        };
        assert!(
            early.to_string().ends_with(
                "; the call is recorded as call 2: calls made at once come in any order"
            ),
            "{early}"
        );
    }

    #[test]
    fn calls_that_only_one_of_the_two_made() {
        let finish = call("finish", json!({}));
        let extra = deviation(2, None, Some(&finish)).unwrap();
        assert_eq!(extra.kind, DeviationKind::ExtraCall);
        assert_eq!(
            extra.to_string(),
            "call 2: finish() after the last recorded call"
        );
        let missing = deviation(1, Some(&finish), None).unwrap();
        assert_eq!(missing.kind, DeviationKind::MissingCall);
        assert_eq!(
            missing.to_string(),
            "call 1: the agent stopped before finish()"
        );
        assert_eq!(deviation(0, None, None), None);
        assert_eq!(
            deviation(0, Some(&call("finish", Value::Null)), Some(&finish)),
            None
        );
        let text = call("finish", json!("now"));
        let found = deviation(0, Some(&finish), Some(&text)).unwrap();
        assert_eq!(
            (found.kind, found.argument),
            (DeviationKind::Argument, None)
        );
    }
}
