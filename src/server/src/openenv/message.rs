//! Messages of clients: what they may hold, and what is wrong with them. Never what is done then.

use reel_mcp::policy_output;
use reel_world::{ToolCall, record::PolicyOutput};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;

use super::refusal::Refusal;

/// A message of the WebSocket.
#[derive(Debug)]
pub(super) enum Message {
    Reset(ResetBody),
    Step(Action),
    State,
    Close,
    /// A request of JSON-RPC, for the tools without rewards.
    Rpc(Value),
}

/// What an episode is to be. Without parameters: the next task of the server, at the server's seed.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct ResetBody {
    /// Seed of everything random in the episode; without `task` it also chooses the task.
    #[schema(format = "uint64")]
    pub seed: Option<u64>,
    /// What the client calls the episode.
    #[schema(pattern = "^[A-Za-z0-9][A-Za-z0-9_.-]{0,47}$")]
    pub episode_id: Option<String>,
    /// Id of the task, or its part after the family.
    pub task: Option<String>,
    /// Name of a recorded episode to start from; its task and seed are that episode's.
    #[schema(pattern = "^[A-Za-z0-9][A-Za-z0-9_.-]{0,199}$")]
    pub trace: Option<String>,
    /// How many calls of the recorded episode come before; 0 without it.
    #[schema(format = "uint32")]
    pub call: Option<u32>,
    /// Whether observations hold the image as base64 of a PNG.
    pub image: Option<bool>,
    /// Name of who decides, for the trace; without it that of the configuration, or `openenv`.
    #[schema(pattern = "^[A-Za-z0-9][A-Za-z0-9_.-]{0,47}$")]
    pub policy: Option<String>,
    /// The parameters besides seed and episode_id once more, for clients that send them as
    /// Gymnasium does.
    pub options: Option<ResetOptions>,
}

/// Parameters of a reset that are Reel's own.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct ResetOptions {
    /// Id of the task, or its part after the family.
    pub task: Option<String>,
    /// Name of a recorded episode to start from.
    pub trace: Option<String>,
    /// How many calls of the recorded episode come before.
    #[schema(format = "uint32")]
    pub call: Option<u32>,
    /// Whether observations hold the image.
    pub image: Option<bool>,
    /// Name of who decides, for the trace.
    #[schema(pattern = "^[A-Za-z0-9][A-Za-z0-9_.-]{0,47}$")]
    pub policy: Option<String>,
}

/// A decision of the agent, or a question that is none.
#[derive(Clone, Debug)]
pub(super) enum Action {
    /// Which tools there are.
    ListTools,
    /// A call of a tool.
    Call {
        call: ToolCall,
        policy: Option<Box<PolicyOutput>>,
        form: Form,
    },
}

/// In which of the contract's forms the observation of a call comes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Form {
    /// `{"name", "arguments"}`: Reel's own.
    Call,
    /// `{"type": "call_tool", "tool_name", "arguments"}`: that of `MCPToolClient`.
    Tool,
}

/// Longest name that a client gives an episode or a policy, in characters.
const NAME_MAX: usize = 48;

impl ResetBody {
    /// Puts the nested options beside the others and checks what belongs together.
    pub(super) fn merged(mut self) -> Result<Self, Refusal> {
        let twice = |name: &str| {
            Refusal::invalid("value_error", &["data", "options", name], "is given twice")
        };
        let nested = self.options.take().unwrap_or_default();
        self.task = one(self.task, nested.task).ok_or_else(|| twice("task"))?;
        self.trace = one(self.trace, nested.trace).ok_or_else(|| twice("trace"))?;
        self.call = one(self.call, nested.call).ok_or_else(|| twice("call"))?;
        self.image = one(self.image, nested.image).ok_or_else(|| twice("image"))?;
        self.policy = one(self.policy, nested.policy).ok_or_else(|| twice("policy"))?;
        let wrong =
            |field: &str, why: &str| Err(Refusal::invalid("value_error", &["data", field], why));
        if self.call.is_some() && self.trace.is_none() {
            return wrong(
                "call",
                "needs `trace`, the recorded episode that it is a call of",
            );
        }
        if self.trace.is_some() && (self.task.is_some() || self.seed.is_some()) {
            return wrong(
                "trace",
                "has its own task and seed; leave out `task` and `seed`",
            );
        }
        for (field, name) in [("episode_id", &self.episode_id), ("policy", &self.policy)] {
            if let Some(name) = name
                && (reel_live::check_name(name).is_err() || name.len() > NAME_MAX)
            {
                return wrong(
                    field,
                    "1 to 48 letters, digits, '-', '_' and '.', the first a letter or digit",
                );
            }
        }
        Ok(self)
    }
}

/// The one of two values that is there; `None` if both are.
#[expect(
    clippy::option_option,
    reason = "the outer one says whether there is an answer"
)]
fn one<T>(left: Option<T>, right: Option<T>) -> Option<Option<T>> {
    match (left, right) {
        (Some(_), Some(_)) => None,
        (left, right) => Some(left.or(right)),
    }
}

/// Reads a message of the WebSocket.
pub(super) fn parse(text: &str) -> Result<Message, Refusal> {
    let value: Value =
        serde_json::from_str(text).map_err(|error| Refusal::Json(error.to_string()))?;
    let Value::Object(mut fields) = value else {
        return Err(Refusal::invalid(
            "model_type",
            &[],
            "a message is an object",
        ));
    };
    let kind = fields.remove("type").unwrap_or_default();
    let kind = match kind.as_str() {
        Some(kind @ ("reset" | "step" | "state" | "close" | "mcp")) => kind.to_owned(),
        other => {
            let name = other.unwrap_or_default().chars().take(80).collect();
            return Err(Refusal::UnknownType(name));
        }
    };
    let takes_data = matches!(&*kind, "reset" | "step" | "mcp");
    let data = takes_data.then(|| fields.remove("data")).flatten();
    refuse_others(&fields, &[])?;
    let needed = || Refusal::invalid("missing", &["data"], "Field required");
    match &*kind {
        "reset" => reset(data.unwrap_or_else(|| Map::new().into())).map(Message::Reset),
        "step" => action(data.ok_or_else(needed)?, "data").map(Message::Step),
        "state" => Ok(Message::State),
        "close" => Ok(Message::Close),
        _ => Ok(Message::Rpc(data.ok_or_else(needed)?)),
    }
}

fn reset(data: Value) -> Result<ResetBody, Refusal> {
    let wrong = |why: String| Refusal::invalid("value_error", &["data"], why);
    // A struct could be read from a list, too, which the contract does not know.
    if !data.is_object() {
        return Err(wrong("must be an object".to_owned()));
    }
    serde_json::from_value::<ResetBody>(data)
        .map_err(|error| wrong(error.to_string()))?
        .merged()
}

/// Reads an action, in each of its forms. `place` is its field.
pub(super) fn action(data: Value, place: &str) -> Result<Action, Refusal> {
    let Value::Object(mut fields) = data else {
        return Err(Refusal::invalid("dict_type", &[place], "must be an object"));
    };
    let metadata = match fields.remove("metadata") {
        None | Some(Value::Null) => Map::new(),
        Some(Value::Object(metadata)) => metadata,
        Some(_) => {
            let why = "must be an object";
            return Err(Refusal::invalid("dict_type", &[place, "metadata"], why));
        }
    };
    let (form, key) = match fields.remove("type") {
        None => (Form::Call, "name"),
        Some(Value::String(kind)) if kind == "call_tool" => (Form::Tool, "tool_name"),
        Some(Value::String(kind)) if kind == "list_tools" => {
            return refuse_others(&fields, &[place]).map(|()| Action::ListTools);
        }
        Some(_) => {
            let why = "is 'call_tool', 'list_tools' or absent";
            return Err(Refusal::invalid("literal_error", &[place, "type"], why));
        }
    };
    let name = match fields.remove(key) {
        Some(Value::String(name)) => name,
        Some(_) => {
            return Err(Refusal::invalid(
                "string_type",
                &[place, key],
                "must be a text",
            ));
        }
        None => return Err(Refusal::invalid("missing", &[place, key], "Field required")),
    };
    let arguments = match fields.remove("arguments") {
        None | Some(Value::Null) => Map::new(),
        Some(Value::Object(arguments)) => arguments,
        Some(_) => {
            let why = "must be an object";
            return Err(Refusal::invalid("dict_type", &[place, "arguments"], why));
        }
    };
    refuse_others(&fields, &[place])?;
    let policy = policy_output(&metadata)
        .map_err(|why| Refusal::invalid("value_error", &[place, "metadata"], why))?;
    Ok(Action::Call {
        call: ToolCall::new(name, Value::Object(arguments)),
        policy: policy.map(Box::new),
        form,
    })
}

fn refuse_others(fields: &Map<String, Value>, place: &[&str]) -> Result<(), Refusal> {
    let Some(name) = fields.keys().next() else {
        return Ok(());
    };
    let name: String = name.chars().take(80).collect();
    let place = [place, &[&*name]].concat();
    let why = "Extra inputs are not permitted";
    Err(Refusal::invalid("extra_forbidden", &place, why))
}
