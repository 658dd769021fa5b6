//! The words in which a decision is put to a model, and the answer that is wanted (SPEC sections 4 and 8): one wording for
//! training sets and for the agents that are driven by a model, so that a model is asked as it was taught.
//!
//! Knows no file, no endpoint and no format of a trainer.

use std::{borrow::Cow, fmt::Write as _, sync::LazyLock};

use reel_world::{Digest, NameSet, ToolSpec};
use serde_json::{Value, json};

/// How to behave, one user turn a decision; the answer is text.
pub const SYSTEM_SINGLE_TURN: &str = include_str!("../texts/agent-single-turn.txt");
/// How to behave in a conversation with native tool calls.
pub const SYSTEM_MULTI_TURN: &str = include_str!("../texts/agent-multi-turn.txt");
/// What stands before the latest picture, where there is one.
pub const VIEW: &str = "\nCurrent view: ";

/// Longest outcome in a log that stands in for a History, in characters.
const OUTCOME_LENGTH_MAX: usize = 120;

/// A decision that was made: what was said, called and told.
#[derive(Clone, PartialEq, Debug)]
pub struct Decision<'a> {
    /// Its number in the episode, from 0.
    pub call: u32,
    /// What was called, as [`action`] writes it.
    pub action: Cow<'a, str>,
    /// What the tool told, without what is privileged.
    pub outcome: &'a str,
    /// Why; empty where nobody said.
    pub reasoning: &'a str,
    /// `History`: what was done and learned so far.
    pub history: &'a str,
    /// `New Schedule`: what is left to do.
    pub schedule: &'a str,
    /// `Current subtask`
    pub subtask: &'a str,
}

/// Names the wording of the system messages in every row and trace.
pub fn digest() -> Digest {
    static DIGEST: LazyLock<Digest> = LazyLock::new(|| Digest::of([SYSTEM_SINGLE_TURN, SYSTEM_MULTI_TURN].concat().as_bytes()));
    *DIGEST
}

/// The eleven tools as a JSON list of `{name, description, parameters}`.
pub fn tool_list(names: NameSet) -> Value {
    ToolSpec::POLICY.iter().map(|spec| function(spec, names)).collect()
}

/// The tools as native tool calling names them: a list of `{type: function, function: {...}}`.
pub fn functions(names: NameSet) -> Value {
    ToolSpec::POLICY.iter().map(|spec| json!({ "type": "function", "function": function(spec, names) })).collect()
}

/// The part of the user's turn that is the same at every decision of an episode. `receptacles` are ids with category and room;
/// `tools` are told by these names, or not at all where they go another way.
pub fn setting<'a>(
    instruction: &str,
    tools: Option<NameSet>,
    receptacles: impl IntoIterator<Item = (&'a str, &'a str, &'a str)>,
) -> String {
    let mut text = format!("Task: {instruction}\n\n");
    if let Some(names) = tools {
        let _ = write!(text, "Tools:\n{}\n\n", tool_list_text(names));
    }
    text.push_str("Receptacles:\n");
    for (id, category, room) in receptacles {
        let _ = writeln!(text, "- {id} ({category}, {room})");
    }
    text
}

/// The rest of it, before the picture, after these decisions.
pub fn situation(decisions: &[Decision<'_>]) -> String {
    let mut text = String::from("\nProgress:\n");
    let Some((last, before)) = decisions.split_last() else {
        text.push_str("Nothing done yet.\n\nLast action: none\nLast outcome: The episode begins.\n");
        return text;
    };
    if last.history.is_empty() && last.schedule.is_empty() {
        log(&mut text, before);
    } else {
        for (title, said) in [("History", last.history), ("New Schedule", last.schedule), ("Current subtask", last.subtask)] {
            if !said.is_empty() {
                let _ = writeln!(text, "{title}: {said}");
            }
        }
    }
    let _ = write!(text, "\nLast action: {}\nLast outcome: {}\n", last.action, last.outcome);
    text
}

/// What the model shall say: reasoning, then one JSON object.
pub fn answer(decision: &Decision<'_>) -> String {
    let mut answer = thought(decision.reasoning);
    let _ = write!(answer, "{{\"History\":{}", quoted(decision.history));
    if !decision.schedule.is_empty() {
        let _ = write!(answer, ",\"New Schedule\":{}", quoted(decision.schedule));
    }
    let _ = write!(answer, ",\"Current subtask\":{},\"next_action\":{}}}", quoted(decision.subtask), decision.action);
    answer
}

/// `<think>...</think>` and a line's end; empty without reasoning.
pub fn thought(reasoning: &str) -> String {
    if reasoning.is_empty() { String::new() } else { format!("<think>{reasoning}</think>\n") }
}

/// The arguments of a call as a JSON object.
pub fn arguments(arguments: &Value) -> String {
    if arguments.is_null() { "{}".to_owned() } else { arguments.to_string() }
}

/// A call as JSON: the tool as it was called, and [`arguments`].
pub fn action(name: &str, arguments: &str) -> String {
    format!("{{\"tool_name\":{},\"args\":{arguments}}}", quoted(name))
}

/// What was called and told, where nobody wrote a History.
fn log(text: &mut String, decisions: &[Decision<'_>]) {
    if decisions.is_empty() {
        text.push_str("Nothing done yet.\n");
    }
    for decision in decisions {
        let _ = write!(text, "{}. {}: ", decision.call + 1, decision.action);
        let words = decision.outcome.split_whitespace().flat_map(|word| [" ", word]).skip(1);
        text.extend(words.flat_map(str::chars).take(OUTCOME_LENGTH_MAX));
        text.push('\n');
    }
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

fn quoted(text: &str) -> String {
    Value::from(text).to_string()
}
