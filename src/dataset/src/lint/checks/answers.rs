//! Answers: each turn of the model reads as an answer, calls a tool that exists, with the arguments
//! that its list demands.
//!
//! Why: the model learns to say what the environment refuses. Sure: yes, where the row
//! declares its tools; else by the eleven tools of the household, if it calls any of them. Applies
//! only where some answer calls a tool. Memory: constant.

use reel_world::{Tool as WorldTool, ToolCall};

use super::{
    Check, RowFacts,
    row_facts::{ModelTurn, Tool},
};
use crate::lint::{Call, Severity, report::Findings};

/// The key of rows of rollouts that says what the answer was worth.
const ADVANTAGE: &str = "advantage";

#[derive(Default)]
pub(super) struct Answers {
    calls: u64,
    answers: u64,
}

impl Check for Answers {
    fn about(&self) -> (&'static str, &'static str) {
        (
            "answers",
            "answers that do not read, tools that do not exist, arguments that the tool does not take",
        )
    }

    fn see(&mut self, seen: &RowFacts, found: &mut Findings) {
        let places = [seen.place()];
        if seen.answers.is_empty() {
            found.add("no answer", Severity::Error, &places, || {
                (
                    "no turn of the model: nothing to learn".to_owned(),
                    String::new(),
                )
            });
        }
        // A conversation may go on without a call.
        let is_conversation = seen.example.tools.is_some() || seen.has_native_calls();
        let tools = if seen.answers.iter().any(|said| !said.calls.is_empty()) {
            seen.tools()
        } else {
            None
        };
        // A rollout is rewarded for whatever was said, and learns from its mistakes.
        let severity = match seen.example.meta.contains_key(ADVANTAGE) {
            true => Severity::Warning,
            false => Severity::Error,
        };
        let undeclared = tools.is_none() && seen.has_own_tools();
        if undeclared {
            found.add("undeclared tools", Severity::Warning, &places, || {
                (
                    "the row declares no tools, and calls none of the household's: its calls were not checked".to_owned(),
                    String::new(),
                )
            });
        }
        for said in &seen.answers {
            self.answers += 1;
            self.calls += said.calls.len() as u64;
            let text = || seen.example.turns[said.turn].text();
            if said.calls.is_empty() && !is_conversation {
                found.add(kind_without_call(said), severity, &places, || {
                    (told_without_call(said).to_owned(), text())
                });
            }
            for call in said.calls.iter().filter(|_| !undeclared) {
                for (kind, told) in faults(call, tools.as_deref()) {
                    found.add(kind, severity, &places, || (told, call.canonical()));
                }
            }
        }
    }

    fn finish(&mut self, found: &mut Findings) {
        if self.calls == 0 {
            found.not_applicable("no answer calls a tool");
        } else {
            found.note(format!(
                "{} calls in {} turns of the model",
                self.calls, self.answers
            ));
        }
    }
}

fn kind_without_call(said: &ModelTurn) -> &'static str {
    if said.answer.object.is_some() {
        "no action"
    } else {
        "unread"
    }
}

fn told_without_call(said: &ModelTurn) -> &'static str {
    match said.answer.object {
        Some(_) => "the answer's JSON has no next_action with a tool_name",
        None => "the answer holds no JSON object",
    }
}

fn faults(call: &Call, tools: Option<&[Tool]>) -> Vec<(&'static str, String)> {
    let Some(tools) = tools else {
        // No list: what the environment would say.
        let call = ToolCall::new(call.name.clone(), call.arguments.clone());
        return WorldTool::parse(&call)
            .err()
            .map(|error| ("refused", error.to_string()))
            .into_iter()
            .collect();
    };
    match tools.iter().find(|tool| tool.name == call.name) {
        Some(tool) => tool.faults(&call.arguments),
        None => {
            let names: Vec<&str> = tools.iter().map(|tool| tool.name.as_str()).collect();
            vec![(
                "unknown tool",
                format!(
                    "{} is not among the declared tools: {}",
                    call.name,
                    names.join(", ")
                ),
            )]
        }
    }
}
