//! What a client of OpenEnv gets of what the profile says, and the schemas of it.

use reel_mcp::tools as profile_tools;
use reel_world::{MarkerBox, Profile};
use rmcp::model::CallToolResult;
use serde_json::{Map, Value, json};

/// What observations say of an episode, besides what the profile says.
#[derive(Clone, Debug)]
pub(super) struct EpisodeFacts {
    /// Name of the trace that the episode becomes.
    pub trace: Option<String>,
    /// Id of the episode in its trace and in the tables.
    pub episode_id: Option<String>,
    /// What the agent is told to do.
    pub instruction: Option<String>,
    /// The trace and call that it starts from, if it starts from one.
    pub parent: Option<(String, u32)>,
    /// Where the numbers are in the image, for those who read; `None` without an image.
    pub marker_boxes: Option<Vec<MarkerBox>>,
}

/// Fields of structured content that are fields of an observation.
const FIELDS: [&str; 6] = reel_world::words! { ok error markers decision decisions_left ended };

/// The observation of a call in Reel's form. Every field is in every observation; what an answer
/// does not have is null.
pub(super) fn of_call(
    said: &CallToolResult,
    image: bool,
    facts: Option<&EpisodeFacts>,
    label: &Option<String>,
) -> Map<String, Value> {
    let structured = said.structured_content.as_ref();
    let field = |name: &str| structured.and_then(|it| it.get(name)).cloned();
    let blocks = blocks(said);
    let texts: Vec<&str> = blocks.iter().filter_map(|it| it["text"].as_str()).collect();
    let text = field("text").unwrap_or_else(|| json!(texts.join("\n")));
    let shown = blocks
        .iter()
        .find_map(|it| it.get("data"))
        .filter(|_| image);
    let mut observation = Map::new();
    observation.insert("text".to_owned(), text);
    for name in FIELDS {
        observation.insert(name.to_owned(), field(name).unwrap_or_default());
    }
    let told = structured.is_some();
    let instruction = facts.filter(|_| told).and_then(|it| it.instruction.clone());
    observation.insert("instruction".to_owned(), json!(instruction));
    observation.insert("image".to_owned(), json!(shown));
    observation.insert("receptacles".to_owned(), Value::Null);
    observation.insert("available_tools".to_owned(), Value::Null);
    observation.insert("metadata".to_owned(), metadata(facts, label));
    observation
}

/// The observation of a call in the form of `MCPToolClient`, whose `call_tool` gives `data`. A call
/// that the tool refuses is a result: the contract's `error` is for what did not reach the tool.
pub(super) fn of_tool(
    tool: &str,
    said: &CallToolResult,
    image: bool,
    facts: Option<&EpisodeFacts>,
    label: &Option<String>,
) -> Map<String, Value> {
    let mut result = result(said, image);
    result["data"] = of_call(said, image, facts, label)["text"].clone();
    let mut observation = Map::new();
    observation.insert("tool_name".to_owned(), json!(tool));
    observation.insert("result".to_owned(), result);
    observation.insert("error".to_owned(), Value::Null);
    observation.insert("metadata".to_owned(), metadata(facts, label));
    observation
}

/// What a tool said, as a result of MCP.
pub(super) fn result(said: &CallToolResult, image: bool) -> Value {
    let mut content = blocks(said);
    content.retain(|it| image || it.get("data").is_none());
    json!({
        "content": content,
        "structured_content": said.structured_content,
        "is_error": said.is_error.unwrap_or(false),
    })
}

fn blocks(said: &CallToolResult) -> Vec<Value> {
    let block = |block| serde_json::to_value(block).unwrap_or_default();
    said.content.iter().map(block).collect()
}

fn metadata(facts: Option<&EpisodeFacts>, label: &Option<String>) -> Value {
    let Some(facts) = facts else {
        return json!({});
    };
    let mut metadata = json!({
        "trace": facts.trace,
        "episode_id": label.as_ref().or(facts.episode_id.as_ref()),
        "reel_episode_id": facts.episode_id,
    });
    if let Some((trace, call)) = &facts.parent {
        metadata["parent"] = json!({"trace": trace, "call": call});
    }
    if let Some(boxes) = &facts.marker_boxes {
        metadata["marker_boxes"] = json!(boxes);
    }
    metadata
}

/// Tools that `reset` stands for.
const NOT_ACTIONS: [&str; 1] = ["finish_with_id"];
/// What `finish` does here, where `reset` begins the next episode.
const FINISH: &str = "End the episode when the task is done.";

/// The tools that are actions, in the contract's form.
pub(super) fn tools(profile: Profile) -> Vec<Value> {
    let tools = profile_tools(profile);
    let actions = tools
        .iter()
        .filter(|tool| !NOT_ACTIONS.contains(&&*tool.name));
    actions
        .map(|tool| {
            let description = match &*tool.name {
                "finish" => FINISH,
                _ => tool.description.as_deref().unwrap_or_default(),
            };
            json!({"name": tool.name, "description": description, "input_schema": tool.input_schema})
        })
        .collect()
}

/// Schemas of actions, observations and state.
pub(super) fn schemas(profile: Profile) -> Value {
    let names: Vec<Value> = tools(profile)
        .iter()
        .map(|tool| tool["name"].clone())
        .collect();
    let nullable = |kind: &str| json!({"type": [kind, "null"]});
    json!({
        "action": {
            "title": "ToolCall",
            "description": "A call of a tool. Also understood: the actions call_tool and list_tools of MCPToolClient.",
            "type": "object",
            "properties": {
                "name": {"type": "string", "description": "The tool.", "examples": names},
                "arguments": {"type": "object", "description": "Its arguments, by name.", "default": {}},
                "metadata": {"type": "object", "description": "What came with the decision, under reel/policy: reasoning, history, plan, raw, tokens, latency_ns, logprobs.", "default": {}},
            },
            "required": ["name"],
            "additionalProperties": false,
        },
        "observation": {
            "title": "ToolOutcome",
            "type": "object",
            "properties": {
                "text": {"type": "string", "description": "What the tool says; of a reset, the task."},
                "ok": {"type": ["boolean", "null"], "description": "Whether the call did what it says."},
                "error": {"type": ["object", "null"], "description": "Code and class of a failed call."},
                "image": {"type": ["string", "null"], "description": "Base64 of a PNG, if the reset asked for images and the tool returns one."},
                "instruction": {"type": ["string", "null"], "description": "The task in words."},
                "markers": {"type": ["array", "null"], "items": {"type": "integer"}, "description": "The numbers of the current marker map."},
                "decision": nullable("integer"),
                "decisions_left": nullable("integer"),
                "ended": {"type": ["string", "null"], "description": "Why the episode ended with this call."},
                "receptacles": {"type": ["array", "null"], "items": {"type": "object"}, "description": "The receptacles of the scene; of a reset only."},
                "available_tools": {"type": ["array", "null"], "items": {"type": "object"}, "description": "The tools; of a reset only."},
                "metadata": {"type": "object", "description": "Name of the trace, and the id of the episode."},
                "reward": nullable("number"),
                "done": {"type": "boolean"},
            },
            "required": ["text", "metadata"],
        },
        "state": {
            "title": "EpisodeState",
            "type": "object",
            "properties": {
                "episode_id": nullable("string"),
                "step_count": {"type": "integer", "minimum": 0},
                "status": {"type": "string", "enum": ["empty", "playing", "suspended", "ended", "failed"]},
                "task_id": nullable("string"),
                "trace": nullable("string"),
            },
            "required": ["step_count"],
        },
    })
}
