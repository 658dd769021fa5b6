//! What each published parser takes out of a model's answer, and how it fails.

use std::borrow::Cow;

use reel_world::{NameSet, ToolSpec};
use serde_json::{Map, Value};
use thiserror::Error;

use crate::python;

/// Tool names of earlier versions that the agent and the trainer still read, with the
/// names that they mean.
pub const LEGACY_TOOLS: [(&str, &str); 6] = [
    ("nav_to", "navigate_to"),
    ("walk_around", "explore_receptacle"),
    ("gaze_at", "focus_on"),
    ("show_object_by_category", "find_objects"),
    ("show_receptacles", "highlight_receptacles"),
    ("place_on_top", "place"),
];

/// The name that a tool goes by in the published code; unknown names stay.
pub fn canonical_tool(name: &str) -> &str {
    LEGACY_TOOLS
        .iter()
        .find(|(legacy, _)| *legacy == name)
        .map_or(name, |(_, canonical)| canonical)
}

/// What the evaluation agent keeps of an answer.
#[derive(Clone, PartialEq, Debug)]
pub struct AgentAnswer {
    /// Its memory: the object under `summary`, `{"history": text}` for any other value
    /// there, `{}` without one.
    pub summary: Map<String, Value>,
    /// The tool by its canonical name.
    pub tool_name: String,
    /// Arguments of the call, by name; empty if the answer gives none.
    pub arguments: Map<String, Value>,
}

/// Why the evaluation agent cannot read an answer; it ends the episode with `inference_error`.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Error)]
pub enum AgentError {
    /// Nothing in the text decodes as a JSON object.
    #[error("no JSON object")]
    NoJson,
    /// The first object has no action that is an object.
    #[error("the first JSON object has no action under `next_action`, `next action` or `action`")]
    NoActionObject,
    /// The action names no tool.
    #[error("the action has no `tool_name` or `name`")]
    NoToolName,
    /// The arguments are no object.
    #[error("`args` is no JSON object")]
    ArgumentsNotObject,
}

/// Reads an answer as the evaluation agent does: after the last `</think>`, without an opening
/// fence, the first JSON object that decodes.
///
/// # Errors
/// Fails if the object holds no usable action.
pub fn agent_answer(text: &str) -> Result<AgentAnswer, AgentError> {
    let text = python::strip(after_think(python::strip(text)));
    let mut body = text;
    if text.starts_with("```") {
        body = text.split_once('\n').map_or(text, |(_, rest)| rest);
        let trimmed = body.trim_end_matches(python::is_space);
        body = trimmed.strip_suffix("```").unwrap_or(body);
    }
    let object = python::first_object(body).ok_or(AgentError::NoJson)?;
    let summary = match object.get("summary") {
        None => Map::new(),
        Some(Value::Object(summary)) => summary.clone(),
        Some(other) => Map::from_iter([("history".to_owned(), python::str(other).into())]),
    };
    let action = ["next_action", "next action", "action"]
        .iter()
        .find_map(|key| object.get(*key));
    let action = action
        .and_then(Value::as_object)
        .ok_or(AgentError::NoActionObject)?;
    let name = action
        .get("tool_name")
        .or_else(|| action.get("name"))
        .and_then(Value::as_str)
        .unwrap_or_default();
    if name.is_empty() {
        return Err(AgentError::NoToolName);
    }
    let arguments = match action.get("args").or_else(|| action.get("arguments")) {
        None => Map::new(),
        Some(Value::Object(arguments)) => arguments.clone(),
        Some(_) => return Err(AgentError::ArgumentsNotObject),
    };
    Ok(AgentAnswer {
        summary,
        tool_name: canonical_tool(name).to_owned(),
        arguments,
    })
}

/// The action that the trainer executes.
#[derive(Clone, PartialEq, Debug)]
pub struct TrainerAction {
    /// The tool as the answer names it.
    pub requested_tool_name: String,
    /// The tool by its canonical name.
    pub tool_name: String,
    /// Arguments of the call, by name; empty if the answer gives none.
    pub arguments: Map<String, Value>,
}

/// Why the trainer finds no action in an answer: it pays -0.5 and goes on. The texts reach the
/// model as an observation.
#[derive(Clone, PartialEq, Eq, Debug, Error)]
pub enum ActionError {
    /// The answer is empty or blank.
    #[error("completion is empty")]
    Empty,
    /// No object of the answer is a usable action.
    #[error("no valid JSON tool action found{}{}", if reasons.is_empty() { "" } else { ": " }, reasons.join("; "))]
    NoAction {
        /// Why each JSON object of the answer is none, in order.
        reasons: Vec<Cow<'static, str>>,
    },
}

/// Reads an answer as the trainer does: every JSON object after the last `</think>` in turn, nested
/// ones too, until one is a usable action.
///
/// # Errors
/// Fails if no object is one.
pub fn trainer_action(text: &str) -> Result<TrainerAction, ActionError> {
    if python::strip(text).is_empty() {
        return Err(ActionError::Empty);
    }
    let mut reasons = Vec::new();
    for object in python::objects(after_think(text)) {
        match action_of(object) {
            Ok(action) => return Ok(action),
            Err(reason) => reasons.push(reason),
        }
    }
    Err(ActionError::NoAction { reasons })
}

fn action_of(object: Map<String, Value>) -> Result<TrainerAction, Cow<'static, str>> {
    let action = ["next action", "next_action"]
        .iter()
        .find_map(|key| object.get(*key))
        .cloned();
    let (name, arguments) = match action.unwrap_or(Value::Object(object)) {
        Value::String(text) => shorthand(&text)?,
        Value::Object(action) => {
            let name = ["tool_name", "tool", "name"]
                .iter()
                .filter_map(|key| action.get(*key))
                .find(|name| is_true(name));
            let arguments = action
                .get("args")
                .or_else(|| action.get("arguments"))
                .cloned();
            (
                name.cloned().unwrap_or_default(),
                arguments.unwrap_or_else(|| Map::new().into()),
            )
        }
        _ => return Err("action must be an object or function shorthand".into()),
    };
    let name = name
        .as_str()
        .map(python::strip)
        .filter(|name| !name.is_empty())
        .ok_or("tool_name is missing")?;
    let arguments = match arguments {
        Value::Null => Map::new(),
        Value::Object(arguments) => arguments,
        _ => return Err("args must be a JSON object".into()),
    };
    Ok(TrainerAction {
        requested_tool_name: name.to_owned(),
        tool_name: canonical_tool(name).to_owned(),
        arguments,
    })
}

/// `tool`, `tool()` or `tool(x)`, where `x` goes to the tool's only required argument.
fn shorthand(text: &str) -> Result<(Value, Value), Cow<'static, str>> {
    let invalid = || {
        Cow::Owned(format!(
            "invalid action shorthand: {}",
            python::str(&Value::Array(vec![text.into()]))
        ))
    };
    let trimmed = python::strip(text);
    let is_word = |c: char| c == '_' || c.is_alphanumeric();
    let end = trimmed.find(|c| !is_word(c)).unwrap_or(trimmed.len());
    let (name, rest) = trimmed.split_at(end);
    if !name.starts_with(|c: char| c == '_' || c.is_ascii_alphabetic()) {
        return Err(invalid());
    }
    let rest = python::strip(rest);
    let argument = match rest {
        "" => "",
        _ => rest
            .strip_prefix('(')
            .and_then(|rest| rest.strip_suffix(')'))
            .map(python::strip)
            .ok_or_else(invalid)?,
    };
    if argument.is_empty() {
        return Ok((name.into(), Map::new().into()));
    }
    let spec = ToolSpec::by_name(canonical_tool(name)).and_then(|spec| spec.argument);
    let key = spec
        .ok_or_else(|| {
            Cow::Owned(format!(
                "{name} shorthand is ambiguous; emit JSON arguments"
            ))
        })?
        .name;
    let value =
        python::loads(argument).unwrap_or_else(|| argument.trim_matches(['"', '\'']).into());
    Ok((
        name.into(),
        Map::from_iter([(key.to_owned(), value)]).into(),
    ))
}

/// What the gym environment keeps of an answer for its next prompt; the trainer's parser reads the
/// action that it executes.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct GymAnswer {
    /// The new memory, of any type; `None` if the former one stays.
    pub task_progress: Option<Value>,
    /// The new last action; `None` if the former one stays.
    pub last_action: Option<Value>,
}

/// Reads an answer as the gym environment does: from the first `{` to the last `}`
/// after the last `</think>`.
pub fn gym_answer(text: &str) -> GymAnswer {
    let body = after_think(text);
    let span = body
        .find('{')
        .zip(body.rfind('}'))
        .filter(|(first, last)| first < last);
    let object = span.and_then(|(first, last)| python::loads(&body[first..=last]));
    let Some(Value::Object(object)) = object else {
        return GymAnswer::default();
    };
    let last_action = match object.get("next action") {
        Some(Value::Object(action)) => Some(action.clone().into()),
        Some(Value::String(text)) => {
            Some(Map::from_iter([("action_str".to_owned(), text.clone().into())]).into())
        }
        Some(_) => None,
        None => object
            .contains_key("tool_name")
            .then(|| object.clone().into()),
    };
    GymAnswer {
        task_progress: object
            .get("summary")
            .or_else(|| object.get("Summary"))
            .cloned(),
        last_action,
    }
}

/// What the scheduler's memory takes out of an answer: strict JSON after the last `</think>`,
/// `summary.History` as it stands and `next action` of any type. `None` where its parser raises,
/// also for a summary or a History of a wrong type.
pub fn scheduler_action(text: &str) -> Option<(Option<String>, Option<Value>)> {
    let body = if text.contains(THINK_END) {
        python::strip(after_think(text))
    } else {
        text
    };
    let value = python::loads(body)?;
    // Python's `in`: keys of an object, items of a list, parts of a text; a `TypeError` for
    // anything else, and for what is taken by such a key out of a list or a text.
    let holds = |value: &Value, key: &str| match value {
        Value::Object(object) => Some(object.contains_key(key)),
        Value::Array(items) => Some(items.iter().any(|item| item == key)),
        Value::String(text) => Some(text.contains(key)),
        _ => None,
    };
    let mut history = None;
    if holds(&value, "summary")? {
        let summary = value.as_object()?.get("summary")?;
        if holds(summary, "History")? {
            history = match summary.as_object()?.get("History")? {
                Value::String(text) => Some(text.clone()),
                other if is_true(other) => return None,
                _ => None,
            };
        }
    }
    let action = if holds(&value, "next action")? {
        Some(value.as_object()?.get("next action")?.clone())
    } else {
        None
    };
    Some((history, action))
}

/// The text of an answer in any of the forms that the gym environment is given: a conversation (its
/// last assistant message, else its last message), a message, anything else.
pub fn answer_text(action: &Value) -> String {
    let content = |message: &Value| match message.get("content") {
        Some(content) => python::str(content),
        None => python::str(message),
    };
    match action {
        Value::Array(messages) => {
            let assistant = messages
                .iter()
                .rev()
                .find(|message| message["role"] == "assistant");
            match (assistant, messages.last()) {
                (Some(message), _) => message.get("content").map(python::str).unwrap_or_default(),
                (None, Some(message)) => content(message),
                (None, None) => String::new(),
            }
        }
        Value::Object(_) => content(action),
        other => python::str(other),
    }
}

const THINK_END: &str = "</think>";

fn after_think(text: &str) -> &str {
    text.rsplit_once(THINK_END).map_or(text, |(_, rest)| rest)
}

/// Whether Python's `bool(value)` is true: empty, zero and null values are false.
fn is_true(value: &Value) -> bool {
    match value {
        Value::Null => false,
        Value::Bool(value) => *value,
        Value::Number(number) => number.as_f64() != Some(0.0),
        Value::String(text) => !text.is_empty(),
        Value::Array(items) => !items.is_empty(),
        Value::Object(object) => !object.is_empty(),
    }
}

/// A call as the published clients are shown it: the tool by its canonical name, marker ids as
/// texts (their schema says `string`). A name that is no tool's stays, and so do arguments
/// that are no object.
pub(crate) fn published_call(name: &str, arguments: &Value) -> (String, Value) {
    let name = ToolSpec::by_name(name)
        .map_or_else(|| canonical_tool(name), |spec| spec.name(NameSet::RealRepo));
    let mut arguments = arguments.clone();
    if arguments.is_null() {
        arguments = Map::new().into();
    }
    if let Some(marker) = arguments
        .get_mut("marker_id")
        .filter(|marker| marker.is_number())
    {
        *marker = marker.to_string().into();
    }
    (name.to_owned(), arguments)
}
