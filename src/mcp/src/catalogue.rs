//! The tools that a policy session lists, with the schemas of what goes in and comes out.

use std::sync::Arc;

use reel_world::{Profile, ToolSpec};
use rmcp::model::{JsonObject, Tool, ToolAnnotations};
use serde_json::{Value, json};

/// Tools around an episode, which are no decisions of the policy: name, argument, description.
#[rustfmt::skip]
const LIFECYCLE: [(&str, Option<&'static str>, &str); 3] = [
    ("list_receptacles", None, "List the rooms and the furniture in them."),
    ("list_tasks", None, "List the ids of the tasks that are served here, as JSON."),
    (
        "finish_with_id",
        Some("task_id"),
        "Abort the episode that runs, if one does, and begin that of a certain task.",
    ),
];
/// What `finish` does here, where one episode follows another.
const FINISH: &str = "End the episode when the task is done, and begin the next one: the answer holds its task. The first call \
                      begins the first episode.";

/// The published servers' tools in their order. Branch `gspo` lists the first ten only, and
/// takes lifecycle tools unlisted.
const PUBLISHED: [&str; 12] = reel_world::words! {
    list_receptacles navigate_to explore_receptacle focus_on find_objects highlight_receptacles pick
    place open close finish ask
};
const LISTED_BY_GSPO: usize = 10;

/// The tools of a profile: those of the paper in its order, then those around an episode; those of
/// a published server in its own.
pub fn tools(profile: Profile) -> Vec<Tool> {
    match profile {
        Profile::Paper => {
            let policy = ToolSpec::POLICY.iter().map(|spec| {
                let description = if spec.paper_name == "finish" {
                    FINISH
                } else {
                    spec.description
                };
                let arguments: Vec<Property> = spec
                    .argument
                    .iter()
                    .map(|argument| property(argument.name, argument.json_type))
                    .collect();
                tool(spec.paper_name, description, arguments)
            });
            let lifecycle = LIFECYCLE.iter().map(|(name, argument, description)| {
                tool(
                    name,
                    description,
                    argument
                        .iter()
                        .map(|argument| property(argument, "string"))
                        .collect(),
                )
            });
            policy
                .chain(lifecycle)
                .map(|tool| tool.with_raw_output_schema(Arc::new(output())))
                .collect()
        }
        Profile::RealRepo => PUBLISHED.iter().map(|name| published(name)).collect(),
        Profile::RealGspo => PUBLISHED[..LISTED_BY_GSPO]
            .iter()
            .map(|name| published(name))
            .collect(),
    }
}

/// A tool of a published server. All its arguments are texts.
fn published(name: &'static str) -> Tool {
    let spec = ToolSpec::by_name(name);
    let arguments = match name {
        "ask" => vec![
            filled(property("target_category", "string")),
            filled(property("target_description", "string")),
        ],
        _ => spec
            .and_then(|spec| spec.argument)
            .iter()
            .map(|argument| property(argument.name, "string"))
            .collect(),
    };
    let description = match (name, spec) {
        ("finish", _) => FINISH,
        (_, Some(spec)) => spec.description,
        (_, None) => LIFECYCLE[0].2,
    };
    tool(name, description, arguments)
}

/// An argument and its schema.
type Property = (&'static str, Value);

fn property(name: &'static str, json_type: &str) -> Property {
    (
        name,
        json!({"type": json_type, "description": meaning(name)}),
    )
}

/// An argument that must not be empty.
fn filled((name, mut schema): Property) -> Property {
    schema["minLength"] = json!(1);
    (name, schema)
}

fn tool(name: &'static str, description: &'static str, arguments: Vec<Property>) -> Tool {
    let required: Vec<&str> = arguments.iter().map(|(name, _)| *name).collect();
    let properties: JsonObject = arguments
        .iter()
        .map(|(name, schema)| ((*name).to_owned(), schema.clone()))
        .collect();
    let input = object(json!({"type": "object", "properties": properties, "required": required}));
    let reads = matches!(name, "list_receptacles" | "list_tasks");
    Tool::new(name, description, Arc::new(input)).with_annotations(
        ToolAnnotations::new()
            .read_only(reads)
            .destructive(false)
            .open_world(false),
    )
}

fn meaning(argument: &str) -> &'static str {
    match argument {
        "receptacle_name" => "Id of a receptacle, as list_receptacles gives it, e.g. table_1.",
        "target_category" => "What to look for, in plain words, e.g. alarm clock.",
        "target_description" => "How the object is described so far.",
        "marker_id" => "A number of the current marker map.",
        "question" => "The question, in plain words.",
        "task_id" => "Id of a task, as list_tasks gives it.",
        _ => "",
    }
}

/// What every tool of profile `paper` gives back as structured content.
fn output() -> JsonObject {
    object(json!({
        "type": "object",
        "properties": {
            "ok": {"type": "boolean", "description": "Whether the call did what it says."},
            "text": {"type": "string", "description": "What the tool says."},
            "error": {
                "type": "object",
                "description": "Why the call failed.",
                "properties": {
                    "code": {"type": "string"},
                    "class": {"type": "string", "enum": ["severe", "moderate"]},
                },
                "required": ["code"],
            },
            "markers": {"type": "array", "items": {"type": "integer"}, "description": "The numbers of the current marker map."},
            "decision": {"type": "integer", "description": "How many decisions of the episode were made."},
            "decisions_left": {"type": "integer", "description": "How many may follow."},
            "ended": {"type": "string", "description": "Why the episode ended with this call."},
            "episode": {
                "type": "object",
                "description": "The episode that has begun.",
                "properties": {
                    "task_id": {"type": "string"},
                    "instruction": {"type": "string"},
                    "receptacles": {"type": "array", "items": {"type": "object"}},
                },
                "required": ["task_id", "instruction", "receptacles"],
            },
        },
        "required": ["ok", "text"],
    }))
}

fn object(value: Value) -> JsonObject {
    match value {
        Value::Object(map) => map,
        _ => unreachable!("every caller gives an object"),
    }
}
