//! The documents of the Agent Trajectory Interchange Format, version 1.7 (RFC 0001 of Harbor).
//! Read leniently: unknown fields are ignored, so that versions 1.0 to 1.8 are read alike.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::lenient::{or_default, or_empty};

/// Version of the format that is written.
pub const VERSION: &str = "ATIF-v1.7";
/// How every version of the format begins that is read.
pub(super) const VERSIONS: &str = "ATIF-v1.";
/// Number after [`VERSIONS`] of the last version that is known.
pub(super) const NEWEST_KNOWN: u32 = 8;
/// What a file begins its version with that may be a trajectory.
pub(super) const FORMAT: &str = "ATIF-v";

/// One trajectory: who acted, and everything that was said, called and answered.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Trajectory {
    /// Version of the format, e.g. `ATIF-v1.7`.
    pub schema_version: String,
    /// The run of the agent; several documents of one run share it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session_id: Option<String>,
    /// Names this document alone, other than the run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trajectory_id: Option<String>,
    /// The agent that acted, with its tools.
    pub agent: Agent,
    /// The turns of system, user and agent, in their order.
    pub steps: Vec<Step>,
    /// Remarks that people wrote or read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub notes: Option<String>,
    /// Tokens and other sums over the whole trajectory.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub final_metrics: Option<FinalMetrics>,
    /// Where the trajectory goes on, if it does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub continued_trajectory_ref: Option<String>,
    /// Further fields, by the producer's own names.
    #[serde(
        default,
        skip_serializing_if = "Map::is_empty",
        deserialize_with = "or_empty"
    )]
    pub extra: Map<String, Value>,
    /// Trajectories of agents to which this one delegated.
    #[serde(
        default,
        skip_serializing_if = "Vec::is_empty",
        deserialize_with = "or_empty"
    )]
    pub subagent_trajectories: Vec<Trajectory>,
}

/// The agent of a trajectory.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Agent {
    /// Name of the agent system.
    pub name: String,
    /// Version of the agent system.
    pub version: String,
    /// The model behind it, where it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model_name: Option<String>,
    /// The tools that it could call, in OpenAI's function calling schema.
    #[serde(
        default,
        skip_serializing_if = "Vec::is_empty",
        deserialize_with = "or_empty"
    )]
    pub tool_definitions: Vec<Value>,
    /// Further fields, by the producer's own names.
    #[serde(
        default,
        skip_serializing_if = "Map::is_empty",
        deserialize_with = "or_empty"
    )]
    pub extra: Map<String, Value>,
}

/// Who a step comes from.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Source {
    /// The system prompt, or an operation of the system.
    System,
    /// The person or program that gave the task.
    User,
    /// The agent itself spoke or acted.
    Agent,
}

/// One turn of a trajectory.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Step {
    /// Number of the step, from 1.
    #[serde(default, deserialize_with = "or_default")]
    pub step_id: u32,
    /// When it was, in ISO 8601.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub timestamp: Option<String>,
    /// Whether system, user or agent is the author.
    pub source: Source,
    /// The model of this step, where it is not the agent's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model_name: Option<String>,
    /// The words of the turn, without calls.
    pub message: Content,
    /// The agent's reasoning, where it is apart from what it said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reasoning_content: Option<String>,
    /// The calls that the agent made.
    #[serde(
        default,
        skip_serializing_if = "Vec::is_empty",
        deserialize_with = "or_empty"
    )]
    pub tool_calls: Vec<Call>,
    /// The results of these calls, with texts and images.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub observation: Option<Observation>,
    /// Tokens, log-probabilities and cost of the step.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub metrics: Option<StepMetrics>,
    /// Whether the step was copied from an earlier trajectory to give context.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub is_copied_context: Option<bool>,
    /// How many inferences of a model the step is; 0 for an agent without a model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub llm_call_count: Option<u32>,
    /// Further fields, by the producer's own names.
    #[serde(
        default,
        skip_serializing_if = "Map::is_empty",
        deserialize_with = "or_empty"
    )]
    pub extra: Map<String, Value>,
}

impl Step {
    /// A turn without a number, of which nothing is said yet.
    pub(crate) fn of(source: Source) -> Step {
        Step {
            step_id: 0,
            timestamp: None,
            source,
            model_name: None,
            message: Content::Text(String::new()),
            reasoning_content: None,
            tool_calls: Vec::new(),
            observation: None,
            metrics: None,
            is_copied_context: None,
            llm_call_count: None,
            extra: Map::new(),
        }
    }
}

/// A text, or parts of which some are images.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(
    untagged,
    expecting = "a text, or a list of parts of type text, image or audio"
)]
pub enum Content {
    /// A text without any image.
    Text(String),
    /// Texts, images and sounds in order.
    Parts(Vec<Part>),
}

impl Content {
    /// The words, without images and sounds.
    pub fn text(&self) -> String {
        match self {
            Self::Text(text) => text.clone(),
            Self::Parts(parts) => words_of(parts),
        }
    }
}

/// The texts among parts, each on lines of its own.
pub(crate) fn words_of(parts: &[Part]) -> String {
    let words = parts.iter().filter_map(|part| match part {
        Part::Text { text } => Some(text.as_str()),
        Part::Image { .. } | Part::Audio { .. } => None,
    });
    words.collect::<Vec<_>>().join("\n")
}

/// A part of a content.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "lowercase")]
pub enum Part {
    /// A text between other parts.
    Text {
        /// The words of the part.
        text: String,
    },
    /// An image in a file.
    Image {
        /// Kind and place of the file.
        source: Media,
    },
    /// A sound in a file.
    Audio {
        /// Kind and place of the file.
        source: Media,
    },
}

/// A file beside a trajectory.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct Media {
    /// MIME type of the file.
    pub media_type: String,
    /// Where it lies: relative to the document, absolute, or a URL.
    pub path: String,
}

/// A call of a tool.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Call {
    /// What results name it by.
    pub tool_call_id: String,
    /// Name of the tool that the agent called.
    pub function_name: String,
    /// Arguments of the call, by name, as a JSON object.
    pub arguments: Value,
}

/// What came of the calls of a step.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Observation {
    /// One result for each call, or results of no call.
    pub results: Vec<CallResult>,
}

/// What came of one call.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct CallResult {
    /// The call, where it is the result of one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source_call_id: Option<String>,
    /// The result as the agent read it: texts and images.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub content: Option<Content>,
}

/// Tokens and log-probabilities of one turn of the agent.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct StepMetrics {
    /// Tokens that the model read.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "or_default"
    )]
    pub prompt_tokens: Option<u32>,
    /// Tokens that the model wrote.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "or_default"
    )]
    pub completion_tokens: Option<u32>,
    /// Log-probability of each token that was written.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "or_default"
    )]
    pub logprobs: Option<Vec<f64>>,
    /// Further fields, by the producer's own names.
    #[serde(
        default,
        skip_serializing_if = "Map::is_empty",
        deserialize_with = "or_empty"
    )]
    pub extra: Map<String, Value>,
}

/// Tokens and other sums over all turns of a trajectory.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct FinalMetrics {
    /// Tokens read in all steps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub total_prompt_tokens: Option<u64>,
    /// Tokens written in all steps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub total_completion_tokens: Option<u64>,
    /// How many steps the document has.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub total_steps: Option<u64>,
    /// Further fields, by the producer's own names.
    #[serde(
        default,
        skip_serializing_if = "Map::is_empty",
        deserialize_with = "or_empty"
    )]
    pub extra: Map<String, Value>,
}
