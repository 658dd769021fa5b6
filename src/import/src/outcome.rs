//! What the texts of the published server mean (docs/spec.md#published-texts): error codes, and the
//! answer to an `ask`.

use reel_world::{
    CallError, ErrorCode, Lifecycle, Outcome, Tool, ToolCall, ToolText, ask_reply,
    record::UserReply,
};

/// The outcome of a call of a tool (`None` for an unknown one): `text` is none, or empty, where the
/// result was an image alone, also one that is not there any more; `marked` is how many markers
/// there are after it.
pub fn outcome(
    call: &ToolCall,
    tool: Option<&Tool>,
    text: Option<&str>,
    marked: Option<usize>,
) -> Outcome {
    let error = match (text.filter(|text| !text.is_empty()), tool) {
        (None, Some(Tool::ShowObjectByCategory { .. } | Tool::ShowReceptacles))
            if marked == Some(0) =>
        {
            Some(ErrorCode::NothingFound)
        }
        (None, _) => None,
        (Some(text), _) => error(call, tool, text),
    };
    Outcome {
        text: text.unwrap_or_default().to_owned(),
        error,
    }
}

/// The answer to an `ask`, in words; none where nobody answered.
pub fn reply(tool: Option<&Tool>, outcome: &Outcome) -> Option<UserReply> {
    let asked = matches!(tool, Some(Tool::Ask { .. }));
    (asked && outcome.is_ok())
        .then(|| ask_reply(&outcome.text))
        .flatten()
}

fn error(call: &ToolCall, tool: Option<&Tool>, text: &str) -> Option<ErrorCode> {
    if call.name.is_empty() {
        return Some(ErrorCode::UnparsableOutput);
    }
    if ToolText::Exception.begins(text) {
        // The server reads arguments without looking whether they are there.
        let is_foreign = matches!(Tool::parse(call), Err(CallError::UnknownTool { .. }));
        let asked_wrongly = (tool.is_none() && !is_foreign) || text.contains("KeyError: ");
        return Some(if asked_wrongly {
            ErrorCode::BadArguments
        } else if ToolText::failure(text) == Some(ToolText::SkillFailed) {
            ErrorCode::SkillFailed
        } else {
            ErrorCode::BackendError
        });
    }
    match tool {
        // The server of branch `gspo` has no `ask`.
        Some(Tool::Ask { .. }) if text == ToolText::UnknownTool.text(&[&call.name]) => {
            Some(ErrorCode::UnknownTool)
        }
        // An answer that names an error is an answer like any other to the published server.
        Some(
            Tool::Ask { .. }
            | Tool::Finish
            | Tool::Lifecycle(Lifecycle::ListReceptacles | Lifecycle::ListTasks),
        ) => None,
        Some(Tool::WalkAround) => ErrorCode::from_message(text),
        // Reel's profile `paper` tells of success in words.
        Some(tool)
            if ToolText::success(tool.paper_name()).is_some_and(|success| success.begins(text)) =>
        {
            None
        }
        // All others tell of success by an image alone.
        _ => ErrorCode::from_message(text).or(Some(ErrorCode::BackendError)),
    }
}

#[cfg(test)]
mod tests {
    use reel_world::record::UserSource;
    use serde_json::{Value, json};

    use super::*;

    fn made(name: &str, arguments: Value, text: Option<&str>, marked: Option<usize>) -> Outcome {
        let call = ToolCall::new(name, arguments);
        outcome(&call, Tool::parse(&call).ok().as_ref(), text, marked)
    }

    fn code(name: &str, arguments: Value, text: &str) -> Option<ErrorCode> {
        made(name, arguments, Some(text), None).error
    }

    #[test]
    fn exceptions_of_third_party_tools_are_of_the_backend() {
        let text = "Error executing tool save: disk is full";
        let code = |name: &str| code(name, json!({}), text);
        assert_eq!(code("save"), Some(ErrorCode::BackendError));
        // A tool of the household without the arguments that it needs.
        assert_eq!(code("pick"), Some(ErrorCode::BadArguments));
    }

    #[test]
    fn a_published_text_has_its_code() {
        let marker = || json!({"marker_id": "1"});
        let handler = "Error executing pick: Traceback ...";
        let asked_wrongly = format!("{handler}\nKeyError: 'marker_id'\n");
        #[rustfmt::skip]
        let cases = [
            (
                "pick",
                marker(),
                "Object x is not graspable. Cannot pick it up.",
                ErrorCode::NotGraspable,
            ),
            (
                "explore_receptacle",
                json!({}),
                "No landmark selected. Use 'navigate_to' first.",
                ErrorCode::NoLandmark,
            ),
            ("grab", json!({}), "Action 'grab' not recognized.", ErrorCode::UnknownTool),
            ("pick", json!({}), asked_wrongly.as_str(), ErrorCode::BadArguments),
            ("pick", marker(), handler, ErrorCode::BackendError),
            (
                "open",
                marker(),
                "Error executing open: the gripper slipped off the handle.",
                ErrorCode::SkillFailed,
            ),
            (
                "finish_with_id",
                json!({"task_id": "FDP/a"}),
                "Task FDP/a can only be started by a session; this episode plays one task.",
                ErrorCode::BadArguments,
            ),
            ("pick", marker(), "The gripper is on strike.", ErrorCode::BackendError),
            ("", Value::Null, "No tool selected.", ErrorCode::UnparsableOutput),
        ];
        for (name, arguments, text, expected) in cases {
            assert_eq!(
                code(name, arguments, text),
                Some(expected),
                "{name}: {text}"
            );
        }
        assert_eq!(
            code(
                "explore_receptacle",
                json!({}),
                "I found the following object(s): \n\t1: a(an) apple.\n"
            ),
            None
        );
        assert_eq!(
            code(
                "list_receptacles",
                json!({}),
                "Room: kitchen/0\n  - Receptacle \n"
            ),
            None
        );
        assert_eq!(code("list_tasks", json!({}), r#"["FDP/a"]"#), None);
        let picked_up = "Picked up the object with marker 1.";
        assert_eq!(code("pick", marker(), picked_up), None);
        let question = json!({"target_category": "clock", "target_description": "red"});
        assert_eq!(
            code("ask", question, "Action 'ask' not recognized."),
            Some(ErrorCode::UnknownTool)
        );
        assert_eq!(
            code("finish", json!({}), "Episode finished. Success: False"),
            None
        );
    }

    #[test]
    fn a_search_that_marks_nothing_found_nothing() {
        let find = |marked| {
            made(
                "find_objects",
                json!({"target_category": "apple"}),
                None,
                marked,
            )
        };
        assert_eq!(find(Some(0)).error, Some(ErrorCode::NothingFound));
        assert!(find(Some(2)).is_ok() && find(None).is_ok());
        assert!(made("pick", json!({"marker_id": 1}), None, Some(0)).is_ok());
    }

    #[test]
    fn an_answer_in_words_and_its_source() {
        let ask = ToolCall::new(
            "ask",
            json!({"target_category": "clock", "target_description": "red"}),
        );
        let tool = Tool::parse(&ask).ok();
        let said = |text: &str| {
            reply(
                tool.as_ref(),
                &outcome(&ask, tool.as_ref(), Some(text), None),
            )
        };
        let canonical = r#"{"target_category": "clock", "target_description": "A red clock.", "source": "task_metadata"}"#;
        assert_eq!(
            said(canonical),
            Some(UserReply {
                text: "clock - A red clock.".into(),
                source: UserSource::RuleBased
            })
        );
        assert_eq!(
            said("The red one."),
            Some(UserReply {
                text: "The red one.".into(),
                source: UserSource::Model
            })
        );
        assert_eq!(
            said(r#"{"error": "simulated_user_context_unavailable"}"#),
            None
        );
        let pick = Tool::Pick { marker: 1 };
        assert_eq!(reply(Some(&pick), &Outcome::ok("The red one.")), None);
    }
}
