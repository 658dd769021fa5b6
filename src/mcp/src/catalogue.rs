//! The tools that a policy session lists, with the schemas of what goes in and comes out.

use std::sync::Arc;

use reel_world::{Profile, ToolSpec};
use rmcp::model::{JsonObject, Tool, ToolAnnotations};
use serde_json::{Value, json};

/// Tools around an episode, which are no decisions of the policy: name, argument, description.
const LIFECYCLE: [(&str, Option<&str>, &str); 3] = [
    ("list_receptacles", None, "List the rooms and the furniture in them."),
    ("list_tasks", None, "List the ids of the tasks that are served here, as JSON."),
    ("finish_with_id", Some("task_id"), "Abort the episode that runs, if one does, and begin that of a certain task."),
];
/// What `finish` does here, where one episode follows another.
const FINISH: &str = "End the episode when the task is done, and begin the next one: the answer holds its task. The first call \
                      begins the first episode.";

/// The tools of a profile, in the order of the paper, then those around an episode.
pub fn tools(profile: Profile) -> Vec<Tool> {
    let policy = ToolSpec::POLICY.iter().map(|spec| {
        let arguments: Vec<(&str, &str, &str)> = match (profile, spec.paper_name) {
            (Profile::RealRepo, "ask") => vec![
                ("target_category", "string", "The category of the object that is asked about."),
                ("target_description", "string", "How it is described so far."),
            ],
            _ => spec.argument.iter().map(|it| (it.name, it.json_type, meaning(it.name))).collect(),
        };
        let description = if spec.paper_name == "finish" { FINISH } else { spec.description };
        tool(profile, spec.name(profile.names()), description, &arguments)
    });
    let lifecycle = LIFECYCLE.iter().map(|(name, argument, description)| {
        let arguments: Vec<(&str, &str, &str)> = argument.iter().map(|name| (*name, "string", meaning(name))).collect();
        tool(profile, name, description, &arguments)
    });
    policy.chain(lifecycle).collect()
}

fn tool(profile: Profile, name: &'static str, description: &'static str, arguments: &[(&str, &str, &str)]) -> Tool {
    let properties: JsonObject =
        arguments.iter().map(|(name, kind, text)| ((*name).to_owned(), json!({"type": kind, "description": text}))).collect();
    let required: Vec<&str> = arguments.iter().map(|(name, ..)| *name).collect();
    let input = object(json!({"type": "object", "properties": properties, "required": required}));
    let reads = matches!(name, "list_receptacles" | "list_tasks");
    let tool = Tool::new(name, description, Arc::new(input))
        .with_annotations(ToolAnnotations::new().read_only(reads).destructive(false).open_world(false));
    match profile {
        Profile::Paper => tool.with_raw_output_schema(Arc::new(output())),
        // The published server has none.
        Profile::RealRepo => tool,
    }
}

fn meaning(argument: &str) -> &'static str {
    match argument {
        "receptacle_name" => "Id of a receptacle, as list_receptacles gives it, e.g. table_1.",
        "target_category" => "What to look for, in plain words, e.g. alarm clock.",
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
