//! The words of a training pair: what the policy is told before a decision, and what it should answer (SPEC section 8).
//! Reads only what a policy sees: instruction, receptacles, tools, its own calls and their outcomes.

use reel_trace::Trace;
use reel_world::{Digest, ToolCall, ToolSpec, record::StepRecord};
use serde_json::{Map, Value, json};

/// The system message.
pub const SYSTEM_PROMPT: &str = include_str!("system.txt");

/// Longest outcome in the history, in characters.
const OUTCOME_LENGTH_MAX: usize = 120;

/// Names the wording of the prompts in every row.
pub fn prompt_digest() -> Digest {
    Digest::of(SYSTEM_PROMPT.as_bytes())
}

/// The three messages of a decision: system, user, assistant.
pub(crate) fn messages(trace: &Trace, index: usize) -> Vec<(&'static str, String)> {
    vec![("system", SYSTEM_PROMPT.trim_end().to_owned()), ("user", user(trace, index)), ("assistant", assistant(trace, index))]
}

/// The first thing in the messages that a policy must not know: an instance.
pub(crate) fn secret(trace: &Trace, messages: &[(&'static str, String)]) -> Option<String> {
    let instances = trace.task.objects.iter().map(|object| object.instance.as_str());
    instances.into_iter().find(|instance| messages.iter().any(|(_, text)| text.contains(instance))).map(str::to_owned)
}

fn user(trace: &Trace, index: usize) -> String {
    let receptacles = trace.scene.receptacles.iter().map(|it| format!("- {} ({}, {})\n", it.id, it.category, it.room));
    let (last_action, last_outcome) = match index.checked_sub(1).map(|before| &trace.steps[before]) {
        Some(before) => (action(&before.input.call).to_string(), before.outcome.text.as_str()),
        None => ("none".to_owned(), "The episode begins."),
    };
    format!(
        "Task: {}\n\nTools:\n{}\n\nReceptacles:\n{}\nProgress:\n{}\n\nLast action: {last_action}\nLast outcome: {last_outcome}\n\nCurrent view: <image>",
        trace.task.instruction,
        tools(trace),
        receptacles.collect::<String>(),
        progress(trace, index),
    )
}

fn assistant(trace: &Trace, index: usize) -> String {
    let record = &trace.steps[index];
    let policy = record.input.policy.as_ref();
    let said = |text: Option<&String>| text.filter(|text| !text.is_empty()).cloned();
    let mut answer = Map::new();
    let history = said(policy.map(|policy| &policy.history)).unwrap_or_else(|| history(&trace.steps[..index]));
    answer.insert("History".into(), history.into());
    if let Some(plan) = said(policy.map(|policy| &policy.plan)) {
        answer.insert("New Schedule".into(), plan.into());
    }
    answer.insert("Current subtask".into(), subtask(record).into());
    answer.insert("next_action".into(), action(&record.input.call));
    let answer = Value::Object(answer).to_string();
    match said(policy.map(|policy| &policy.reasoning)) {
        Some(reasoning) => format!("<think>{reasoning}</think>\n{answer}"),
        None => answer,
    }
}

/// `h_{t-1}`: what the policy wrote before, or else what was called and told.
fn progress(trace: &Trace, index: usize) -> String {
    let written = index.checked_sub(1).and_then(|before| trace.steps[before].input.policy.as_ref());
    match written.filter(|policy| !policy.history.is_empty()) {
        Some(policy) => [policy.history.as_str(), policy.plan.as_str()].join("\n").trim_end().to_owned(),
        None => history(&trace.steps[..index.saturating_sub(1)]),
    }
}

fn history(steps: &[StepRecord]) -> String {
    if steps.is_empty() {
        return "Nothing done yet.".into();
    }
    let line = |record: &StepRecord| {
        let outcome = record.outcome.text.split_whitespace().collect::<Vec<_>>().join(" ");
        let short: String = outcome.chars().take(OUTCOME_LENGTH_MAX).collect();
        format!("{}. {}: {short}", record.step + 1, record.input.call)
    };
    steps.iter().map(line).collect::<Vec<_>>().join("\n")
}

fn subtask(record: &StepRecord) -> String {
    let what = ToolSpec::by_name(&record.input.call.name).map_or("", |spec| spec.description);
    let argument = match &record.input.call.arguments {
        Value::Object(map) => map.values().next().map(|value| value.as_str().map_or(value.to_string(), str::to_owned)),
        _ => None,
    };
    argument.map_or(what.to_owned(), |argument| format!("{what} ({argument})"))
}

fn action(call: &ToolCall) -> Value {
    let arguments = if call.arguments.is_null() { json!({}) } else { call.arguments.clone() };
    json!({ "tool_name": call.name, "args": arguments })
}

/// The tools as a JSON list, under the names of the episode's profile.
fn tools(trace: &Trace) -> Value {
    let names = trace.header.profile.names();
    let tool = |spec: &ToolSpec| {
        let (properties, required) = match spec.argument {
            Some(argument) => (json!({ argument.name: { "type": argument.json_type } }), json!([argument.name])),
            None => (json!({}), json!([])),
        };
        json!({
            "name": spec.name(names),
            "description": spec.description,
            "parameters": { "type": "object", "properties": properties, "required": required },
        })
    };
    ToolSpec::POLICY.iter().map(tool).collect()
}
