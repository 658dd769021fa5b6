//! What the policy said: `raw_response.txt` (reasoning, then JSON) or `raw_response.json` (a
//! message of function calling) as reasoning, history and plan; what does not parse stays raw.

use reel_world::{answer::AssistantTurn, record::PolicyOutput};

/// The two forms of a raw response.
pub(crate) enum Raw {
    /// Text as in `raw_response.txt`: reasoning, then the decision as JSON.
    Text(String),
    /// Text as in `raw_response.json`: a message of function calling.
    Json(String),
}

/// Reads what can be read of a raw response; the raw text is kept as it came.
pub(crate) fn parse(raw: Raw) -> PolicyOutput {
    match raw {
        Raw::Text(text) => PolicyOutput {
            raw: text.clone(),
            ..AssistantTurn::parse(&text).output()
        },
        Raw::Json(text) => {
            let message = serde_json::from_str(&text).unwrap_or_default();
            PolicyOutput {
                raw: text,
                ..AssistantTurn::of_message(&message).output()
            }
        }
    }
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
        let expected = [
            "it is red",
            "went",
            "New Schedule: pick; place Current subtask: pick it",
        ]
        .map(str::to_owned);
        assert_eq!(
            text(&format!("<think>it is red</think>\n```json\n{json}\n```\n")),
            expected
        );
        assert_eq!(text(&format!("it is red\n```json\n{json}\n```")), expected);
        assert_eq!(text(&format!("it is red {json}")), expected);
        let lower = r#"it is red</think>{"summary":{"history":"went"},"action":{"name":"finish"}}"#;
        assert_eq!(text(lower), ["it is red", "went", ""].map(str::to_owned));
        assert_eq!(
            text(r#"{"summary": "went there", "next_action": {}}"#),
            ["", "went there", ""].map(str::to_owned)
        );
        assert_eq!(
            text("I {do not} know"),
            ["I {do not} know", "", ""].map(str::to_owned)
        );
    }

    #[test]
    fn a_message_of_function_calling() {
        let message = r#"{"role": "assistant", "content": "I look.", "tool_calls": []}"#;
        let output = parse(Raw::Json(message.to_owned()));
        assert_eq!(
            (output.raw.as_str(), output.reasoning.as_str()),
            (message, "I look.")
        );
        let parts =
            r#"{"content": [{"type": "text", "text": "I"}, {"type": "text", "text": "look."}]}"#;
        assert_eq!(parse(Raw::Json(parts.to_owned())).reasoning, "I; look.");
        assert_eq!(
            parse(Raw::Json("{\"content\": nul".to_owned())).reasoning,
            ""
        );
    }

    proptest! {
        #[test]
        fn nothing_panics(text in "(\\PC|[{}\"\\[\\]:,]|</think>|```|summary){0,200}") {
            let _ = parse(Raw::Json(text.clone()));
            prop_assert_eq!(&parse(Raw::Text(text.clone())).raw, &text);
        }
    }
}
