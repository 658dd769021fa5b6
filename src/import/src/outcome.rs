//! What the texts of the published server mean (docs/spec.md#published-texts): error codes, and the
//! answer to an `ask`.

use reel_world::{ErrorCode, Outcome, Tool, ToolCall, ask_reply, record::UserReply};

/// Tools whose success is told in words; all others answer with a picture alone.
const WORDS: &[&str] = &["walk_around", "ask", "finish", "list_receptacles"];
/// Tools that find nothing where they leave an empty marker map.
const SEARCHES: &[&str] = &["show_object_by_category", "show_receptacles"];

/// The outcome of a call: `text` is none where the result was a picture alone, `marked` how many
/// markers there are after it.
pub fn outcome(call: &ToolCall, text: Option<&str>, marked: Option<usize>) -> Outcome {
    let tool = Tool::parse(call).ok().map(|tool| tool.paper_name());
    let error = match text {
        None if tool.is_some_and(|tool| SEARCHES.contains(&tool)) && marked == Some(0) => {
            Some(ErrorCode::NothingFound)
        }
        None => None,
        Some(text) => error(call, tool, text),
    };
    Outcome {
        text: text.unwrap_or_default().to_owned(),
        error,
    }
}

/// The answer to an `ask`, in words; none where nobody answered.
pub fn reply(call: &ToolCall, outcome: &Outcome) -> Option<UserReply> {
    if Tool::parse(call).ok()?.paper_name() != "ask" || !outcome.is_ok() {
        return None;
    }
    ask_reply(&outcome.text)
}

fn error(call: &ToolCall, tool: Option<&str>, text: &str) -> Option<ErrorCode> {
    if call.name.is_empty() {
        return Some(ErrorCode::UnparsableOutput);
    }
    if let Some(trace) = text.strip_prefix("Error executing ") {
        // The server reads arguments without looking whether they are there.
        let asked_wrongly = Tool::parse(call).is_err() || trace.contains("KeyError: ");
        return Some(if asked_wrongly {
            ErrorCode::BadArguments
        } else {
            ErrorCode::BackendError
        });
    }
    if tool == Some("ask") {
        // An answer that names an error is an answer like any other to the published server.
        return None;
    }
    let known = ErrorCode::from_message(text);
    match tool {
        None => Some(known.unwrap_or(ErrorCode::BackendError)),
        Some("finish" | "list_receptacles") => None,
        Some(tool) if WORDS.contains(&tool) => known,
        Some(_) => Some(known.unwrap_or(ErrorCode::BackendError)),
    }
}

#[cfg(test)]
mod tests {
    use reel_world::record::UserSource;
    use serde_json::{Value, json};

    use super::*;

    fn code(name: &str, arguments: Value, text: &str) -> Option<ErrorCode> {
        outcome(&ToolCall::new(name, arguments), Some(text), None).error
    }

    #[test]
    fn every_published_text_has_its_code() {
        let marker = || json!({"marker_id": "1"});
        let receptacle = || json!({"receptacle_name": "x"});
        let cases = [
            (
                "navigate_to",
                receptacle(),
                "Receptacle x not found in the scene.",
                ErrorCode::UnknownReceptacle,
            ),
            (
                "navigate_to",
                receptacle(),
                "Object x has no valid navigable component.",
                ErrorCode::NoViewpoint,
            ),
            (
                "navigate_to",
                receptacle(),
                "Cannot compute bounding box for x.",
                ErrorCode::NoViewpoint,
            ),
            (
                "navigate_to",
                receptacle(),
                "Cannot find a non-occluded position to navigate to x.",
                ErrorCode::NoViewpoint,
            ),
            (
                "explore_receptacle",
                json!({}),
                "No landmark selected. Use 'navigate_to' first.",
                ErrorCode::NoLandmark,
            ),
            (
                "explore_receptacle",
                json!({}),
                "Seems there is no object on the x's top shelf to observe.",
                ErrorCode::NothingFound,
            ),
            (
                "focus_on",
                marker(),
                "No marker map available. Use 'find_objects' or 'explore_receptacle' first.",
                ErrorCode::NoMarkerMap,
            ),
            (
                "focus_on",
                marker(),
                "Marker ID 1 not found in the marker map.",
                ErrorCode::UnknownMarker,
            ),
            (
                "focus_on",
                marker(),
                "Object x is not available. Cannot focus on it.",
                ErrorCode::MarkerNotInView,
            ),
            (
                "focus_on",
                marker(),
                "Object x has no graspable component. Cannot focus on it.",
                ErrorCode::NotGraspable,
            ),
            (
                "focus_on",
                marker(),
                "No camera position available. Use 'navigate_to' first.",
                ErrorCode::NoLandmark,
            ),
            (
                "pick",
                marker(),
                "You are already holding 'x'. Place it before picking another object.",
                ErrorCode::AlreadyHolding,
            ),
            (
                "pick",
                marker(),
                "Object x is not graspable. Cannot pick it up.",
                ErrorCode::NotGraspable,
            ),
            (
                "place",
                marker(),
                "No object in the inventory to place.",
                ErrorCode::NothingHeld,
            ),
            (
                "place",
                marker(),
                "'x' is not a valid placement surface.",
                ErrorCode::NotASurface,
            ),
            (
                "place",
                marker(),
                "Furniture x has no top_shelf component.",
                ErrorCode::NotASurface,
            ),
            (
                "place",
                marker(),
                "The door of 'x' is closed. Use 'open' first.",
                ErrorCode::DoorClosed,
            ),
            (
                "open",
                marker(),
                "No marker map available.",
                ErrorCode::NoMarkerMap,
            ),
            (
                "grab",
                json!({}),
                "Action 'grab' not recognized.",
                ErrorCode::UnknownTool,
            ),
            (
                "pick",
                json!({}),
                "Error executing pick: Traceback ...\nKeyError: 'marker_id'\n",
                ErrorCode::BadArguments,
            ),
            (
                "find_objects",
                json!({"target_category": "a"}),
                "Error executing find_objects: Traceback ...",
                ErrorCode::BackendError,
            ),
            (
                "pick",
                marker(),
                "The gripper is on strike.",
                ErrorCode::BackendError,
            ),
            (
                "",
                Value::Null,
                "No tool selected.",
                ErrorCode::UnparsableOutput,
            ),
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
        assert_eq!(
            code("finish", json!({}), "Episode finished. Success: False"),
            None
        );
    }

    #[test]
    fn a_search_that_marks_nothing_found_nothing() {
        let find = ToolCall::new("find_objects", json!({"target_category": "apple"}));
        assert_eq!(
            outcome(&find, None, Some(0)).error,
            Some(ErrorCode::NothingFound)
        );
        assert!(outcome(&find, None, Some(2)).is_ok() && outcome(&find, None, None).is_ok());
        assert!(
            outcome(
                &ToolCall::new("pick", json!({"marker_id": 1})),
                None,
                Some(0)
            )
            .is_ok()
        );
    }

    #[test]
    fn an_answer_in_words_and_its_source() {
        let ask = ToolCall::new(
            "ask",
            json!({"target_category": "clock", "target_description": "red"}),
        );
        let said = |text: &str| reply(&ask, &outcome(&ask, Some(text), None));
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
        let pick = ToolCall::new("pick", json!({"marker_id": 1}));
        assert_eq!(reply(&pick, &Outcome::ok("The red one.")), None);
    }
}
