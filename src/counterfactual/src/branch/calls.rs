//! Calls as people write them, in JSON. Never judges whether a tool would take them: an invalid
//! call is one that a policy could have made, too.

use reel_world::ToolCall;
use serde_json::Value;

use crate::branch::BranchError;

/// A call from `{"name": "pick", "arguments": {"marker_id": 1}}`; `tool_name` and `args` are
/// understood as well, and a missing `arguments` is none. Tools go by either name set.
///
/// # Errors
/// When it is no JSON, no object, or has no name.
pub fn parse_call(text: &str) -> Result<ToolCall, BranchError> {
    let refused = |what: String| BranchError::Call {
        text: text.trim().to_owned(),
        reason: what,
    };
    let value: Value = serde_json::from_str(text).map_err(|error| refused(error.to_string()))?;
    let Value::Object(mut fields) = value else {
        return Err(refused("it is no JSON object".to_owned()));
    };
    let mut take = |names: [&str; 2]| names.into_iter().find_map(|name| fields.shift_remove(name));
    let name = match take(["name", "tool_name"]) {
        Some(Value::String(name)) => name,
        Some(_) => return Err(refused("its name is no text".to_owned())),
        None => return Err(refused("it has no name".to_owned())),
    };
    let arguments =
        take(["arguments", "args"]).unwrap_or_else(|| Value::Object(serde_json::Map::new()));
    match fields.keys().next() {
        Some(unknown) => Err(refused(format!(
            "it has a field '{unknown}', which is neither name nor arguments"
        ))),
        None => Ok(ToolCall { name, arguments }),
    }
}

/// Calls, one a line; empty lines are passed over.
///
/// # Errors
/// The first line that is no call, by its number.
pub fn parse_calls(text: &str) -> Result<Vec<ToolCall>, BranchError> {
    let lines = text
        .lines()
        .enumerate()
        .filter(|(_, line)| !line.trim().is_empty());
    let at = |(index, line): (usize, &str)| {
        parse_call(line).map_err(|error| BranchError::Line {
            line: index + 1,
            source: Box::new(error),
        })
    };
    lines.map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_ways_to_write_a_call_are_read() {
        let call = parse_call(r#"{"name": "pick", "arguments": {"marker_id": 1}}"#).unwrap();
        assert_eq!(
            call,
            parse_call(r#" {"tool_name": "pick", "args": {"marker_id": 1}} "#).unwrap()
        );
        assert_eq!(
            parse_call(r#"{"name": "walk_around"}"#)
                .unwrap()
                .to_string(),
            "walk_around()"
        );
    }

    #[test]
    fn what_is_no_call_is_refused_by_line_and_reason() {
        let refused = |text: &str| parse_calls(text).unwrap_err().to_string();
        assert!(
            refused("{\"name\": \"finish\"}\n\npick(1)").starts_with("line 3: "),
            "{}",
            refused("\n\npick(1)")
        );
        assert!(refused(r#"{"arguments": {}}"#).contains("has no name"));
        assert!(refused(r#"["pick"]"#).contains("no JSON object"));
        assert!(refused(r#"{"name": "pick", "marker_id": 1}"#).contains("'marker_id'"));
        assert!(refused(r#"{"name": 3}"#).contains("no text"));
        assert_eq!(parse_calls("\n \n").unwrap(), []);
    }
}
