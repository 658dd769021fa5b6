//! What REAL's published parsers lose of answers in text: the evaluation agent, the trainer, the
//! gym and the scheduler each read another part of the forms that models write.
//!
//! Why: a student learns the form of its training set. An answer whose memory the agent
//! does not find makes an agent without memory; one that only some parsers read behaves
//! otherwise in evaluation than in training. Sure: yes, the parsers agree with the
//! published code (`reel_prompt::published`). Answers by function calling are not theirs
//! to read. Memory: constant.

use reel_prompt::published::{
    ActionError, TrainerAction, agent_answer, canonical_tool, gym_answer, scheduler_action,
    trainer_action,
};
use reel_world::{NameSet, ToolSpec};
use serde_json::{Map, Value};

use super::{Check, RowFacts};
use crate::lint::{Severity, report::Findings};

#[derive(Default)]
pub(super) struct Published {
    answers: u64,
    /// Answers in which the trainer finds a call.
    acting: u64,
    whole: u64,
}

impl Check for Published {
    fn about(&self) -> (&'static str, &'static str) {
        (
            "published parsers",
            "what REAL's agent, trainer, gym and scheduler lose of the answers",
        )
    }

    fn see(&mut self, seen: &RowFacts, found: &mut Findings) {
        let places = [seen.place()];
        for said in seen.answers.iter().filter(|said| !said.by_function) {
            let text = seen.example.turns[said.turn].text();
            if text.contains(TOOL_CALL_TAG) {
                continue;
            }
            let lost = losses(&text);
            self.answers += 1;
            self.acting += u64::from(lost.iter().all(|loss| loss.kind != NO_ACTION));
            self.whole += u64::from(lost.is_empty());
            for ParserLoss { kind, message } in lost {
                found.add(kind, Severity::Warning, &places, || (message, text.clone()));
            }
        }
    }

    fn finish(&mut self, found: &mut Findings) {
        if self.acting == 0 {
            found.not_applicable(
                "no answer in text calls a tool; REAL's parsers read no native tool calls",
            );
        } else {
            found.note(format!(
                "{} of {} answers reach all four parsers whole",
                self.whole, self.answers
            ));
        }
    }
}

/// What opens a native tool call that is written into the text.
pub(super) const TOOL_CALL_TAG: &str = "<tool_call>";

/// The kind of an answer without a call.
const NO_ACTION: &str = "trainer: no action";

/// Something that a parser loses.
struct ParserLoss {
    kind: &'static str,
    message: String,
}

/// An action as the parsers compare: canonical name and arguments.
type Action = (String, Map<String, Value>);

fn losses(text: &str) -> Vec<ParserLoss> {
    let mut lost = Vec::new();
    let mut lose = |kind, message: String| lost.push(ParserLoss { kind, message });
    let trained = match trainer_action(text) {
        Ok(TrainerAction {
            requested_tool_name,
            tool_name,
            arguments,
        }) => {
            if requested_tool_name != tool_name {
                lose(
                    "former tool name",
                    format!(
                        "`{requested_tool_name}` is now `{tool_name}`: gym and scheduler show it as it is"
                    ),
                );
            } else if !is_tool(&tool_name) {
                lose(
                    "unknown tool name",
                    format!("`{tool_name}` is not a tool of the published servers"),
                );
            }
            Some((tool_name, arguments))
        }
        Err(error @ (ActionError::Empty | ActionError::NoAction { .. })) => {
            lose(
                NO_ACTION,
                format!("{error}: -0.5, and the call is not made"),
            );
            None
        }
    };
    match agent_answer(text) {
        Err(error) => lose(
            "agent: no action",
            format!("{error}: the episode ends with inference_error"),
        ),
        Ok(read) => {
            if read.summary.is_empty() {
                lose(
                    "agent: empty memory",
                    "no `summary` object: the next prompt holds `{}` as progress".to_owned(),
                );
            }
            let action = (read.tool_name, read.arguments);
            if trained.as_ref().is_some_and(|trained| *trained != action) {
                lose(
                    "agent: other action",
                    format!("it calls `{}`, the trainer something else", action.0),
                );
            }
        }
    }
    let gym = gym_answer(text);
    if gym.task_progress.as_ref().is_none_or(is_empty) {
        lose(
            "gym: empty memory",
            "no `summary` between the first `{` and the last `}`: the former one stays".to_owned(),
        );
    }
    compare(
        gym.last_action.as_ref(),
        trained.as_ref(),
        ["gym: no action", "gym: other action"],
        &mut lose,
    );
    match scheduler_action(text) {
        None => lose(
            "scheduler: not strict JSON",
            "after </think> stands something else than one JSON object with a History in text: the memory gets a fixed line"
                .to_owned(),
        ),
        Some((history, action)) => {
            if history.is_none_or(|history| history.trim().is_empty()) {
                lose("scheduler: empty memory", "no `summary` with a `History`: the memory gets no line".to_owned());
            }
            compare(action.as_ref(), trained.as_ref(), ["scheduler: no action", "scheduler: other action"], &mut lose);
        }
    }
    lost
}

/// Whether a last action is the one that the trainer executes.
fn compare(
    shown: Option<&Value>,
    trained: Option<&Action>,
    kinds: [&'static str; 2],
    lose: &mut impl FnMut(&'static str, String),
) {
    let Some(shown) = shown else {
        lose(
            kinds[0],
            "no action under `next action`: the next prompt shows the one before".to_owned(),
        );
        return;
    };
    let name = shown
        .get("tool_name")
        .and_then(Value::as_str)
        .map(canonical_tool);
    let same = |(tool, arguments): &Action| {
        name == Some(tool)
            && shown
                .get("args")
                .and_then(Value::as_object)
                .is_some_and(|shown| shown == arguments)
    };
    if trained.is_some_and(|trained| !same(trained)) {
        lose(
            kinds[1],
            format!("the next prompt shows {shown} as the last action"),
        );
    }
}

fn is_tool(name: &str) -> bool {
    name == "list_receptacles"
        || ToolSpec::POLICY
            .iter()
            .any(|spec| spec.name(NameSet::RealRepo) == name)
}

fn is_empty(value: &Value) -> bool {
    match value {
        Value::Object(object) => object.is_empty(),
        Value::String(text) => text.is_empty(),
        Value::Array(items) => items.is_empty(),
        other => other.is_null(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kinds(text: &str) -> Vec<&'static str> {
        losses(text).into_iter().map(|loss| loss.kind).collect()
    }

    const SUMMARY: &str =
        r#""summary": {"History": "0) a", "New Schedule": "b", "Current subtask": "c"}"#;

    #[test]
    fn each_parser_by_what_it_loses() {
        let action = r#"{"tool_name": "pick", "args": {"marker_id": "1"}}"#;
        assert_eq!(
            kinds(&format!(
                "<think>t</think>\n{{{SUMMARY}, \"next action\": {action}}}"
            )),
            [""; 0]
        );
        let flat =
            format!(r#"{{"History": "a", "Current subtask": "c", "next_action": {action}}}"#);
        let lost = [
            "agent: empty memory",
            "gym: empty memory",
            "gym: no action",
            "scheduler: empty memory",
            "scheduler: no action",
        ];
        assert_eq!(kinds(&flat), lost);
        let prose = format!("{{{SUMMARY}, \"next action\": {action}}} Done.");
        assert_eq!(kinds(&prose), ["scheduler: not strict JSON"]);
        let two = format!(
            "{{{SUMMARY}, \"next action\": {action}, \"next_action\": {{\"tool_name\": \"finish\", \"args\": {{}}}}}}"
        );
        assert_eq!(kinds(&two), ["agent: other action"]);
        let former = format!(
            "{{{SUMMARY}, \"next action\": {{\"tool_name\": \"gaze_at\", \"args\": {{\"marker_id\": \"1\"}}}}}}"
        );
        assert_eq!(kinds(&former), ["former tool name"]);
        assert_eq!(
            kinds(&former.replace("gaze_at", "fly")),
            ["unknown tool name"]
        );
        let shorthand = format!("{{{SUMMARY}, \"next action\": \"finish\"}}");
        assert_eq!(
            kinds(&shorthand),
            [
                "agent: no action",
                "gym: other action",
                "scheduler: other action"
            ]
        );
        let nothing = [
            "trainer: no action",
            "agent: no action",
            "gym: empty memory",
            "gym: no action",
            "scheduler: not strict JSON",
        ];
        assert_eq!(kinds("I do not know."), nothing);
    }
}
