//! The words of an example: what a policy is told before a decision, and what it should answer (SPEC sections 4 and 8).
//! Owns the wording; knows no format.

use std::{
    fmt::Write as _,
    sync::{Arc, LazyLock},
};

use reel_world::{Digest, NameSet, ToolSpec};
use serde_json::{Value, json};

use crate::{Episode, Step, Style, Text};

/// How to behave, one user turn a decision; the answer is text.
pub const SYSTEM_SINGLE_TURN: &str = include_str!("prompt-single-turn.txt");
/// How to behave in a conversation with native tool calls.
pub const SYSTEM_MULTI_TURN: &str = include_str!("prompt-multi-turn.txt");

/// Longest outcome in a log that stands in for a History, in characters.
const OUTCOME_LENGTH_MAX: usize = 120;

/// Names the wording of the system messages in every row.
pub fn prompt_digest() -> Digest {
    static DIGEST: LazyLock<Digest> = LazyLock::new(|| Digest::of([SYSTEM_SINGLE_TURN, SYSTEM_MULTI_TURN].concat().as_bytes()));
    *DIGEST
}

/// The system message.
pub(crate) fn system(style: Style) -> Arc<Text> {
    static SINGLE_TURN: LazyLock<Arc<Text>> = LazyLock::new(|| Arc::new(Text::new(SYSTEM_SINGLE_TURN.trim_end())));
    static MULTI_TURN: LazyLock<Arc<Text>> = LazyLock::new(|| Arc::new(Text::new(SYSTEM_MULTI_TURN.trim_end())));
    Arc::clone(if style == Style::SingleTurn { &SINGLE_TURN } else { &MULTI_TURN })
}

/// The eleven tools as a JSON list of `{name, description, parameters}`.
pub fn tool_list(names: NameSet) -> Value {
    ToolSpec::POLICY.iter().map(|spec| function(spec, names)).collect()
}

/// [`tool_list`] as text.
fn tool_list_text(names: NameSet) -> &'static str {
    static PAPER: LazyLock<String> = LazyLock::new(|| tool_list(NameSet::Paper).to_string());
    static REAL_REPO: LazyLock<String> = LazyLock::new(|| tool_list(NameSet::RealRepo).to_string());
    match names {
        NameSet::Paper => &PAPER,
        NameSet::RealRepo => &REAL_REPO,
    }
}

/// The tools as native tool calling names them: `{type: function, function: {...}}`.
pub(crate) fn functions(names: NameSet) -> Arc<Text> {
    static PAPER: LazyLock<Arc<Text>> = LazyLock::new(|| native(NameSet::Paper));
    static REAL_REPO: LazyLock<Arc<Text>> = LazyLock::new(|| native(NameSet::RealRepo));
    fn native(names: NameSet) -> Arc<Text> {
        let functions = ToolSpec::POLICY.iter().map(|spec| json!({ "type": "function", "function": function(spec, names) }));
        Arc::new(Text::new(functions.collect::<Value>().to_string()))
    }
    Arc::clone(match names {
        NameSet::Paper => &PAPER,
        NameSet::RealRepo => &REAL_REPO,
    })
}

/// The part of the user's turn that is the same at every decision of an episode.
pub(crate) fn setting(episode: &Episode, with_tools: bool) -> String {
    let mut text = format!("Task: {}\n\n", episode.instruction);
    if with_tools {
        let _ = write!(text, "Tools:\n{}\n\n", tool_list_text(episode.names));
    }
    text.push_str("Receptacles:\n");
    for it in &episode.receptacles {
        let _ = writeln!(text, "- {} ({}, {})", it.id, it.category, it.room);
    }
    text
}

/// The rest of it, before the picture. `outcomes` are the steps' outcomes without what is privileged.
pub(crate) fn situation(episode: &Episode, outcomes: &[String], index: usize) -> String {
    let mut text = String::from("\nProgress:\n");
    let Some(before) = index.checked_sub(1) else {
        text.push_str("Nothing done yet.\n\nLast action: none\nLast outcome: The episode begins.\n");
        return text;
    };
    let step = &episode.steps[before];
    if step.history.is_empty() && step.schedule.is_empty() {
        log(&mut text, &episode.steps[..before], outcomes);
    } else {
        for (title, said) in [("History", &step.history), ("New Schedule", &step.schedule), ("Current subtask", &step.subtask)] {
            if !said.is_empty() {
                let _ = writeln!(text, "{title}: {said}");
            }
        }
    }
    let _ = write!(text, "\nLast action: {}\nLast outcome: {}\n", action(step), outcomes[before]);
    text
}

/// What the model shall say: reasoning, then one JSON object.
pub(crate) fn answer(step: &Step) -> String {
    let mut answer = thought(step);
    answer.push_str("{\"History\":");
    push_json(&mut answer, &step.history);
    if !step.schedule.is_empty() {
        answer.push_str(",\"New Schedule\":");
        push_json(&mut answer, &step.schedule);
    }
    answer.push_str(",\"Current subtask\":");
    push_json(&mut answer, &step.subtask);
    let _ = write!(answer, ",\"next_action\":{}}}", action(step));
    answer
}

/// `<think>...</think>` and a line's end; empty without reasoning.
pub(crate) fn thought(step: &Step) -> String {
    if step.reasoning.is_empty() { String::new() } else { format!("<think>{}</think>\n", step.reasoning) }
}

/// The call's arguments as a JSON object.
pub(crate) fn arguments(step: &Step) -> String {
    if step.arguments.is_null() { "{}".to_owned() } else { step.arguments.to_string() }
}

fn action(step: &Step) -> String {
    let mut action = String::from("{\"tool_name\":");
    push_json(&mut action, &step.call_name);
    let _ = write!(action, ",\"args\":{}}}", arguments(step));
    action
}

/// What was called and told, where nobody wrote a History.
fn log(text: &mut String, steps: &[Step], outcomes: &[String]) {
    if steps.is_empty() {
        text.push_str("Nothing done yet.\n");
    }
    for (step, outcome) in steps.iter().zip(outcomes) {
        let words = outcome.split_whitespace().collect::<Vec<_>>().join(" ");
        let short: String = words.chars().take(OUTCOME_LENGTH_MAX).collect();
        let _ = writeln!(text, "{}. {}: {short}", step.call + 1, action(step));
    }
}

fn function(spec: &ToolSpec, names: NameSet) -> Value {
    let (properties, required) = match spec.argument {
        Some(argument) => (json!({ argument.name: { "type": argument.json_type } }), json!([argument.name])),
        None => (json!({}), json!([])),
    };
    json!({
        "name": spec.name(names),
        "description": spec.description,
        "parameters": { "type": "object", "properties": properties, "required": required },
    })
}

fn push_json(text: &mut String, value: &str) {
    text.push_str(&crate::json::quoted(value));
}
