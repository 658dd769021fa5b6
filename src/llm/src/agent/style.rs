//! The two ways in which a model is asked for its decisions, and what they have in common.

use std::{collections::BTreeMap, sync::Arc};

use crate::client::{Client, Part, Reply};
use reel_agents::{Policy, PolicyContext};
use reel_prompt::Prompt;
use reel_trace::encode_png;
use reel_world::{
    Digest, FRAME_HEIGHT, FRAME_WIDTH, NameSet, ToolCall,
    answer::AssistantTurn,
    record::{PolicyInfo, PolicyOutput},
};
use serde_json::json;

use crate::agent::{FunctionCalling, SingleTurn};

/// How a model is asked for its decisions.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum AgentStyle {
    /// The paper's agent: one user turn a decision with everything in it, the answer as text.
    SingleTurn,
    /// The zero-shot baseline: one conversation an episode, tools as functions.
    Functions,
}

impl AgentStyle {
    /// All of them, and what they are in one line.
    pub const ALL: [(AgentStyle, &'static str); 2] = [
        (
            AgentStyle::SingleTurn,
            "a model, asked anew for every decision; it answers <think>...</think> and JSON (REAL-Agent)",
        ),
        (
            AgentStyle::Functions,
            "a model in one conversation an episode, with native function calls (zero-shot baseline)",
        ),
    ];

    /// As it stands on the command line and in traces.
    pub fn as_str(self) -> &'static str {
        match self {
            AgentStyle::SingleTurn => "real-agent",
            AgentStyle::Functions => "function-calling",
        }
    }

    /// Reads what [`AgentStyle::as_str`] wrote.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .map(|(style, _)| style)
            .find(|style| style.as_str() == text)
    }
}

/// A model as an agent. Single turns are put by `prompt`, which names the tools itself; `names` are
/// those of functions. `seed` is the episode's.
pub fn agent(
    style: AgentStyle,
    client: Arc<Client>,
    prompt: &Arc<Prompt>,
    names: NameSet,
    seed: u64,
) -> Box<dyn Policy + Send> {
    match style {
        AgentStyle::SingleTurn => Box::new(SingleTurn::new(client, Arc::clone(prompt), seed)),
        AgentStyle::Functions => Box::new(FunctionCalling::new(client, names, seed)),
    }
}

/// Who decides: the model and everything its answers depend on, but not the endpoint's address.
pub(crate) fn info(style: AgentStyle, client: &Client, seed: u64, prompt: Digest) -> PolicyInfo {
    let endpoint = client.endpoint();
    let mut parameters = BTreeMap::from([
        ("model".to_owned(), json!(endpoint.model)),
        ("prompt".to_owned(), json!(prompt.to_string())),
        ("temperature".to_owned(), json!(endpoint.temperature)),
        ("max_tokens".to_owned(), json!(endpoint.max_tokens)),
        ("seed".to_owned(), json!(seed)),
    ]);
    parameters.extend(
        endpoint
            .extra
            .iter()
            .map(|(name, value)| (name.clone(), value.clone())),
    );
    PolicyInfo {
        name: format!("{}:{}", style.as_str(), endpoint.model),
        checkpoint: None,
        parameters,
    }
}

/// The seed of a decision's draws: another one for each seed of an episode and each decision of it. Servers take 31 bits.
pub(crate) fn decision_seed(episode: u64, step: u32) -> u64 {
    episode.wrapping_mul(4_099).wrapping_add(step.into()) & 0x7fff_ffff
}

/// A call that says nothing: the tools answer that no call could be read.
pub(crate) fn no_call() -> ToolCall {
    ToolCall::new("", serde_json::Value::Null)
}

/// What came with a decision. `raw` is the reply as it came.
pub(crate) fn output(answer: &AssistantTurn, raw: String, reply: &Reply) -> PolicyOutput {
    let tokens = reply
        .tokens_read
        .zip(reply.tokens_written)
        .map(|(read, written)| [read, written]);
    let logprobs = reply.logprobs.clone();
    PolicyOutput {
        raw,
        tokens,
        latency_ns: Some(reply.latency_ns),
        logprobs,
        ..answer.output()
    }
}

/// The newest image, where the last call gave one.
pub(crate) fn image_part(context: &PolicyContext<'_>) -> Option<Vec<u8>> {
    let frame = context.observation.frame.as_ref()?;
    Some(encode_png(
        &frame.rgb,
        FRAME_WIDTH as u32,
        FRAME_HEIGHT as u32,
    ))
}

/// An image as a part of a message.
pub(crate) fn image(png: Vec<u8>) -> Part {
    Part::Image {
        media_type: "image/png".to_owned(),
        bytes: png,
    }
}

/// The furniture that an agent is told of.
pub(crate) fn receptacles<'a>(
    context: &PolicyContext<'a>,
) -> impl Iterator<Item = (&'a str, &'a str, &'a str)> {
    context
        .briefing
        .receptacles
        .iter()
        .map(|(id, category, room)| (id.as_str(), category.as_str(), room.as_str()))
}
