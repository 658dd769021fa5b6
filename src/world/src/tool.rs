//! The tools a policy calls, as a typed enum parsed from (name, JSON arguments) under
//! both name sets (docs/spec.md#tools).

use std::{borrow::Cow, fmt};

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::{ErrorCode, ReceptacleId, ToolText};

/// A call as the policy made it; kept as it came, valid or not.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct ToolCall {
    /// Tool name in either name set.
    pub name: String,
    /// The arguments: an object, or whatever the policy sent instead.
    #[serde(default)]
    pub arguments: Value,
}

impl ToolCall {
    /// A call by name and arguments.
    pub fn new(name: impl Into<String>, arguments: Value) -> Self {
        Self {
            name: name.into(),
            arguments,
        }
    }

    /// The value of the argument that the tool takes, as text: the column `argument` of tables.
    /// `None` if the tool is unknown, takes no argument or did not get it.
    pub fn argument(&self) -> Option<Cow<'_, str>> {
        let argument = ToolSpec::by_name(&self.name)?.argument?;
        self.arguments.get(argument.name).map(value_text)
    }

    /// The values of all arguments as texts, whatever their names: what people read of a call, and
    /// the only reading of a call that is none of the tools.
    pub fn values(&self) -> impl Iterator<Item = Cow<'_, str>> {
        let map = self.arguments.as_object();
        map.into_iter().flat_map(Map::values).map(value_text)
    }
}

/// A value as text: a string as it is, all else as JSON.
pub fn value_text(value: &Value) -> Cow<'_, str> {
    match value {
        Value::String(text) => Cow::Borrowed(text),
        other => Cow::Owned(other.to_string()),
    }
}

impl fmt::Display for ToolCall {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}(", self.name)?;
        match &self.arguments {
            Value::Object(map) => {
                for (index, (key, value)) in map.iter().enumerate() {
                    let comma = if index > 0 { ", " } else { "" };
                    write!(f, "{comma}{key}={value}")?;
                }
            }
            Value::Null => {}
            other => write!(f, "{other}")?,
        }
        f.write_str(")")
    }
}

/// Which names a tool goes by.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NameSet {
    /// As in the paper: `nav_to`, `walk_around`, ...
    #[default]
    Paper,
    /// As in the published repository: `navigate_to`, `explore_receptacle`, ...
    RealRepo,
}

/// A call of one of the eleven tools, or of a lifecycle tool.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Tool {
    /// Go to a viewpoint of a receptacle.
    NavTo {
        /// Id of the receptacle to go to.
        receptacle: ReceptacleId,
    },
    /// List what is on the current receptacle.
    WalkAround,
    /// Mark the objects in view that match a category.
    ShowObjectByCategory {
        /// Category to look for, in any words: the vocabulary is open.
        category: String,
    },
    /// Mark the receptacles in view.
    ShowReceptacles,
    /// Approach the marked thing and look at it.
    GazeAt {
        /// Number in the current marker map.
        marker: u32,
    },
    /// Take the marked object.
    Pick {
        /// Number in the current marker map.
        marker: u32,
    },
    /// Put the held object on the marked receptacle.
    Place {
        /// Number in the current marker map.
        marker: u32,
    },
    /// Open the marked receptacle's door.
    Open {
        /// Number in the current marker map.
        marker: u32,
    },
    /// Close the marked receptacle's door.
    Close {
        /// Number in the current marker map.
        marker: u32,
    },
    /// Ask the user a question in plain words.
    Ask {
        /// The question to the user, in plain words.
        question: String,
    },
    /// End the episode by the policy's own decision.
    Finish,
    /// A tool of the session rather than of the world.
    Lifecycle(Lifecycle),
}

/// Tools that clients of the published repository use around an episode; no decision of the policy.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Lifecycle {
    /// `list_receptacles`: rooms and furniture as text.
    ListReceptacles,
    /// `list_tasks`: the task ids of the session as a JSON list.
    ListTasks,
    /// `finish_with_id`: abort what runs and start the task of this id.
    FinishWithId {
        /// Id of the task to start.
        task_id: String,
    },
}

/// Why a call is not a tool; a severe error that costs a step and is told to the policy.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum CallError {
    /// No tool of this name.
    #[error("{}", ToolText::UnknownTool.text(&[name]))]
    UnknownTool { name: String },
    /// The arguments are no JSON object.
    #[error("{}", ToolText::NotAnObject.text(&[tool, found]))]
    NotAnObject {
        tool: &'static str,
        /// JSON type that the arguments have, e.g. `a list`.
        found: &'static str,
    },
    /// An argument is missing.
    #[error("{}", ToolText::MissingArgument.text(&[tool, argument]))]
    Missing {
        tool: &'static str,
        /// Name of the missing argument, e.g. `marker_id`.
        argument: &'static str,
    },
    /// An argument has the wrong type.
    #[error("{}", ToolText::WrongType.text(&[tool, argument, expected, found]))]
    WrongType {
        tool: &'static str,
        /// Name of the argument with the wrong type, e.g. `marker_id`.
        argument: &'static str,
        expected: &'static str,
        found: String,
    },
}

impl CallError {
    /// The error code of the outcome.
    pub fn code(&self) -> ErrorCode {
        match self {
            CallError::UnknownTool { .. } => ErrorCode::UnknownTool,
            _ => ErrorCode::BadArguments,
        }
    }
}

/// What a tool is called, what it does, and what it takes: for prompts, tool lists and `--help`.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ToolSpec {
    /// Name in the paper.
    pub paper_name: &'static str,
    /// Name in the published repository.
    pub repo_name: &'static str,
    /// Its argument, if it has one.
    pub argument: Option<Argument>,
    /// One sentence for the policy.
    pub description: &'static str,
}

/// An argument of a tool.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Argument {
    /// Key of the argument in the JSON object, e.g. `marker_id`.
    pub name: &'static str,
    /// JSON Schema type: `string` or `integer`.
    pub json_type: &'static str,
}

const fn spec(
    paper_name: &'static str,
    repo_name: &'static str,
    argument: Option<Argument>,
    description: &'static str,
) -> ToolSpec {
    ToolSpec {
        paper_name,
        repo_name,
        argument,
        description,
    }
}

const RECEPTACLE: Option<Argument> = Some(Argument {
    name: "receptacle_name",
    json_type: "string",
});
const CATEGORY: Option<Argument> = Some(Argument {
    name: "target_category",
    json_type: "string",
});
const MARKER: Option<Argument> = Some(Argument {
    name: "marker_id",
    json_type: "integer",
});
const QUESTION: Option<Argument> = Some(Argument {
    name: "question",
    json_type: "string",
});

impl ToolSpec {
    /// The eleven policy-facing tools, in the order of docs/spec.md#tools.
    #[rustfmt::skip]
    pub const POLICY: [ToolSpec; 11] = [
        spec(
            "nav_to",
            "navigate_to",
            RECEPTACLE,
            "Go to a viewpoint of the named receptacle and look at it.",
        ),
        spec(
            "walk_around",
            "explore_receptacle",
            None,
            "Walk around the current receptacle and list the objects on it.",
        ),
        spec(
            "show_object_by_category",
            "find_objects",
            CATEGORY,
            "Mark the objects in view that match a category with numbers.",
        ),
        spec(
            "show_receptacles",
            "highlight_receptacles",
            None,
            "Mark the receptacles in view with numbers.",
        ),
        spec(
            "gaze_at",
            "focus_on",
            MARKER,
            "Approach the thing with this number and look at it closely.",
        ),
        spec("pick", "pick", MARKER, "Pick up the object with this number."),
        spec("place", "place", MARKER, "Place the held object on the receptacle with this number."),
        spec("open", "open", MARKER, "Open the door of the receptacle with this number."),
        spec("close", "close", MARKER, "Close the door of the receptacle with this number."),
        spec("ask", "ask", QUESTION, "Ask the user a question in plain words."),
        spec("finish", "finish", None, "End the episode when the task is done."),
    ];

    /// Finds a policy-facing tool by either of its names.
    pub fn by_name(name: &str) -> Option<&'static ToolSpec> {
        const ALL: &[ToolSpec] = &ToolSpec::POLICY;
        ALL.iter()
            .find(|spec| spec.paper_name == name || spec.repo_name == name)
    }

    /// The paper's name of a tool under either of its names; the name itself if it is no tool.
    pub fn paper_name_of(name: &str) -> &str {
        Self::by_name(name).map_or(name, |spec| spec.paper_name)
    }

    /// The name in a name set.
    pub fn name(&self, names: NameSet) -> &'static str {
        match names {
            NameSet::Paper => self.paper_name,
            NameSet::RealRepo => self.repo_name,
        }
    }
}

impl Tool {
    /// Parses a call under both name sets.
    ///
    /// Unknown extra arguments are ignored; a marker may be an integer or a string of digits, as
    /// policies send both. `ask` takes `question`, or `target_category` with `target_description`
    /// as in the published repository.
    ///
    /// # Errors
    /// A [`CallError`], whose text is meant for the policy.
    pub fn parse(call: &ToolCall) -> Result<Tool, CallError> {
        let name = call.name.as_str();
        let empty = Map::new();
        let arguments = |tool| match &call.arguments {
            Value::Object(map) => Ok(map),
            Value::Null => Ok(&empty),
            other => Err(CallError::NotAnObject {
                tool,
                found: type_of(other),
            }),
        };
        if let Some(lifecycle) = Self::parse_lifecycle(name, &arguments)? {
            return Ok(Tool::Lifecycle(lifecycle));
        }
        let Some(spec) = ToolSpec::by_name(name) else {
            return Err(CallError::UnknownTool {
                name: name.to_owned(),
            });
        };
        let tool = spec.name(if name == spec.repo_name {
            NameSet::RealRepo
        } else {
            NameSet::Paper
        });
        let map = arguments(tool)?;
        let marker = || marker_argument(tool, map);
        Ok(match spec.paper_name {
            "nav_to" => Tool::NavTo {
                receptacle: text_argument(tool, map, "receptacle_name")?.into(),
            },
            "walk_around" => Tool::WalkAround,
            "show_object_by_category" => Tool::ShowObjectByCategory {
                category: text_argument(tool, map, "target_category")?,
            },
            "show_receptacles" => Tool::ShowReceptacles,
            "gaze_at" => Tool::GazeAt { marker: marker()? },
            "pick" => Tool::Pick { marker: marker()? },
            "place" => Tool::Place { marker: marker()? },
            "open" => Tool::Open { marker: marker()? },
            "close" => Tool::Close { marker: marker()? },
            "ask" => Tool::Ask {
                question: question_argument(tool, map)?,
            },
            "finish" => Tool::Finish,
            other => unreachable!("tool {other} stands in ToolSpec::POLICY but not here"),
        })
    }

    fn parse_lifecycle<'a>(
        name: &str,
        arguments: &impl Fn(&'static str) -> Result<&'a Map<String, Value>, CallError>,
    ) -> Result<Option<Lifecycle>, CallError> {
        Ok(match name {
            "list_receptacles" => Some(Lifecycle::ListReceptacles),
            "list_tasks" => Some(Lifecycle::ListTasks),
            "finish_with_id" => {
                let task_id =
                    text_argument("finish_with_id", arguments("finish_with_id")?, "task_id")?;
                Some(Lifecycle::FinishWithId { task_id })
            }
            _ => None,
        })
    }

    /// The tool's name in the paper; lifecycle tools have one name.
    pub fn paper_name(&self) -> &'static str {
        match self {
            Tool::NavTo { .. } => "nav_to",
            Tool::WalkAround => "walk_around",
            Tool::ShowObjectByCategory { .. } => "show_object_by_category",
            Tool::ShowReceptacles => "show_receptacles",
            Tool::GazeAt { .. } => "gaze_at",
            Tool::Pick { .. } => "pick",
            Tool::Place { .. } => "place",
            Tool::Open { .. } => "open",
            Tool::Close { .. } => "close",
            Tool::Ask { .. } => "ask",
            Tool::Finish => "finish",
            Tool::Lifecycle(Lifecycle::ListReceptacles) => "list_receptacles",
            Tool::Lifecycle(Lifecycle::ListTasks) => "list_tasks",
            Tool::Lifecycle(Lifecycle::FinishWithId { .. }) => "finish_with_id",
        }
    }

    /// The number in the marker map that the tool names; `None` where it names none.
    pub fn marker(&self) -> Option<u32> {
        match self {
            Tool::GazeAt { marker }
            | Tool::Pick { marker }
            | Tool::Place { marker }
            | Tool::Open { marker }
            | Tool::Close { marker } => Some(*marker),
            _ => None,
        }
    }

    /// The same tool with another number; one that names none stays as it is.
    #[must_use]
    pub fn with_marker(mut self, number: u32) -> Self {
        if let Tool::GazeAt { marker }
        | Tool::Pick { marker }
        | Tool::Place { marker }
        | Tool::Open { marker }
        | Tool::Close { marker } = &mut self
        {
            *marker = number;
        }
        self
    }

    /// The call that parses to this tool, with the paper's names.
    pub fn to_call(&self) -> ToolCall {
        let arguments = match self {
            Tool::NavTo { receptacle } => serde_json::json!({ "receptacle_name": receptacle }),
            Tool::ShowObjectByCategory { category } => {
                serde_json::json!({ "target_category": category })
            }
            Tool::GazeAt { marker }
            | Tool::Pick { marker }
            | Tool::Place { marker }
            | Tool::Open { marker }
            | Tool::Close { marker } => {
                serde_json::json!({ "marker_id": marker })
            }
            Tool::Ask { question } => serde_json::json!({ "question": question }),
            Tool::Lifecycle(Lifecycle::FinishWithId { task_id }) => {
                serde_json::json!({ "task_id": task_id })
            }
            Tool::WalkAround | Tool::ShowReceptacles | Tool::Finish | Tool::Lifecycle(_) => {
                serde_json::json!({})
            }
        };
        ToolCall::new(self.paper_name(), arguments)
    }
}

fn type_of(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "a boolean",
        Value::Number(_) => "a number",
        Value::String(_) => "a string",
        Value::Array(_) => "a list",
        Value::Object(_) => "an object",
    }
}

fn shorten(value: &Value) -> String {
    let text = value.to_string();
    match text.char_indices().nth(60) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text,
    }
}

fn text_argument(
    tool: &'static str,
    map: &Map<String, Value>,
    argument: &'static str,
) -> Result<String, CallError> {
    match map.get(argument) {
        None | Some(Value::Null) => Err(CallError::Missing { tool, argument }),
        Some(Value::String(text)) => Ok(text.clone()),
        Some(other) => Err(CallError::WrongType {
            tool,
            argument,
            expected: "a string",
            found: shorten(other),
        }),
    }
}

fn marker_argument(tool: &'static str, map: &Map<String, Value>) -> Result<u32, CallError> {
    let argument = "marker_id";
    let Some(value) = map.get(argument).filter(|value| !value.is_null()) else {
        return Err(CallError::Missing { tool, argument });
    };
    let number = match value {
        Value::Number(number) => number.as_u64(),
        Value::String(text) => text.trim().parse().ok(),
        _ => None,
    };
    number
        .and_then(|number| u32::try_from(number).ok())
        .ok_or_else(|| CallError::WrongType {
            tool,
            argument,
            expected: "a marker number",
            found: shorten(value),
        })
}

fn question_argument(tool: &'static str, map: &Map<String, Value>) -> Result<String, CallError> {
    if map.contains_key("question") || !map.contains_key("target_category") {
        return text_argument(tool, map, "question");
    }
    let category = text_argument(tool, map, "target_category")?;
    Ok(
        match map.get("target_description").and_then(Value::as_str) {
            Some(description) if !description.trim().is_empty() => {
                format!("Which {category} do you mean: {description}?")
            }
            _ => format!("Which {category} do you mean?"),
        },
    )
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde_json::json;

    use super::*;

    #[test]
    fn both_name_sets_parse_to_the_same_tool() {
        for spec in &ToolSpec::POLICY {
            let arguments = match spec.argument {
                Some(argument) if argument.json_type == "integer" => json!({ argument.name: 3 }),
                Some(argument) => json!({ argument.name: "table_1" }),
                None => json!({}),
            };
            let paper = Tool::parse(&ToolCall::new(spec.paper_name, arguments.clone())).unwrap();
            let repo = Tool::parse(&ToolCall::new(spec.repo_name, arguments)).unwrap();
            assert_eq!(paper, repo);
            assert_eq!(paper.paper_name(), spec.paper_name);
            assert_eq!(Tool::parse(&paper.to_call()).unwrap(), paper);
        }
    }

    #[test]
    fn errors_say_what_and_where() {
        let error = |name: &str, arguments: Value| {
            Tool::parse(&ToolCall::new(name, arguments))
                .unwrap_err()
                .to_string()
        };
        assert_eq!(error("grab", json!({})), "Action 'grab' not recognized.");
        assert_eq!(
            error("pick", json!({})),
            "pick: missing argument 'marker_id'"
        );
        assert_eq!(
            error("focus_on", json!({"marker_id": 1.5})),
            "focus_on: argument 'marker_id' must be a marker number, found 1.5"
        );
        assert_eq!(
            error("nav_to", json!({"receptacle_name": 4})),
            "nav_to: argument 'receptacle_name' must be a string, found 4"
        );
        assert_eq!(
            error("nav_to", json!(["table_1"])),
            "nav_to: arguments must be a JSON object, found a list"
        );
        assert_eq!(error("ask", json!({})), "ask: missing argument 'question'");
    }

    #[test]
    fn lenient_where_policies_are() {
        let pick = Tool::parse(&ToolCall::new(
            "pick",
            json!({"marker_id": " 2 ", "why": "it is red"}),
        ))
        .unwrap();
        assert_eq!(pick, Tool::Pick { marker: 2 });
        let ask = Tool::parse(&ToolCall::new(
            "ask",
            json!({"target_category": "pen", "target_description": "red"}),
        ))
        .unwrap();
        assert_eq!(
            ask,
            Tool::Ask {
                question: "Which pen do you mean: red?".into()
            }
        );
        assert_eq!(
            Tool::parse(&ToolCall::new("finish", Value::Null)).unwrap(),
            Tool::Finish
        );
    }

    proptest! {
        #[test]
        fn gibberish_never_panics(name in ".{0,20}", key in "[a-z_]{0,15}", text in ".{0,200}") {
            let _ = Tool::parse(&ToolCall::new(name, json!({ key.clone(): text.clone() })));
            let _ = Tool::parse(&ToolCall::new("pick", json!({ "marker_id": text })));
            let _ = Tool::parse(&ToolCall::new("pick", json!({ "marker_id": [key] })));
        }
    }
}
