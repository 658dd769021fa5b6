//! What a dataset is made from: an episode as plain text, as its store tells it. Owns the input's
//! shape; reads no store.

use std::sync::Arc;

use reel_world::{Digest, NameSet};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::{Rollout, Split, TaskBriefing};

/// An image by the digest of its recorded pixels (8-bit RGB, row by row).
pub type ImageId = Digest;

/// An episode as its agent lived it.
#[derive(Clone, Debug)]
pub struct Episode {
    /// As in the trace.
    pub episode_id: String,
    /// Id of the episode's task, e.g. `FDP/verify_task_10`.
    pub task_id: String,
    /// Family of the episode's task, e.g. `FDP`.
    pub family: String,
    /// The scene it played in.
    pub scene_id: String,
    /// Who decided, e.g. `oracle`.
    pub policy: String,
    /// The part of the dataset that it belongs to; whole tasks or scenes
    /// share one (see [`Split`]).
    pub split: Split,
    /// What the agent was told, as all of its task.
    pub briefing: Arc<TaskBriefing>,
    /// The names its tools went by.
    pub names: NameSet,
    /// Of an agent whose tools are others than REAL's: what it was told. Conversations alone hold it.
    pub agent: Option<AgentSetup>,
    /// Its decisions, in order.
    pub steps: Vec<Step>,
    /// Where all this comes from.
    pub source: Source,
}

/// What an agent with tools of its own was told before its task, as its trace says.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct AgentSetup {
    /// The system message; `None` if none was recorded.
    pub system: Option<String>,
    /// The tools as a JSON list of `{type: function, function: {...}}`; `None` if none were recorded.
    pub tools: Option<String>,
}

/// One decision and what came of it.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Step {
    /// Its number in the episode, from 0.
    pub call: u32,
    /// The tool by its name in the paper; empty where the call names none of the eleven.
    pub tool: String,
    /// The name as it was called.
    pub call_name: String,
    /// The arguments as they were sent; null for none.
    pub arguments: Value,
    /// What the tool told.
    pub outcome: String,
    /// The class and code of the error, where the call failed.
    pub error: Option<String>,
    /// Why the agent did so; empty where it did not say.
    pub reasoning: String,
    /// `History`: what was done and learned so far.
    pub history: String,
    /// `New Schedule`: what is left to do.
    pub schedule: String,
    /// `Current subtask`: what the agent is doing now.
    pub subtask: String,
    /// The answer as it came, where rows teach or reward exactly that; else one is written of the fields above. Not in
    /// conversations, whose calls stand in fields of their own.
    pub answer: Option<String>,
    /// What an agent with tools of its own said beside its call.
    pub message: String,
    /// The category of what the gripper holds after the call; `None` if nothing.
    pub held: Option<String>,
    /// What it saw before the decision: the images of the latest observation, often one.
    pub images: Vec<ImageId>,
    /// Whether a model shall learn this decision; the others are context.
    pub learn: bool,
    /// What it was worth, where the rows are for reinforcement learning.
    pub rollout: Option<Rollout>,
}

/// Where an episode comes from: every row carries it.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
pub struct Source {
    /// BLAKE3 of the trace file.
    pub trace_digest: String,
    /// Where it lies, as the table names it.
    pub trace_uri: String,
    /// `exact` where the trace replayed to the same digests, `exact_without_rgb` where all but colours
    /// was compared (datasets without images), else `unverified`.
    pub verdict: String,
    /// The simulator that replayed it; empty where none did.
    pub verdict_sim_version: String,
    /// Reward preset, e.g. `paper`.
    pub preset: String,
    /// Digest of the reward preset; empty where the preset is unknown.
    pub preset_digest: String,
    /// Version of the failure rules; empty where none ran.
    pub rules_version: String,
    /// Version of the table the episode was read at.
    pub table_version: u64,
    /// Who wrote reasoning, History, schedule and subtask, e.g. `rules-1` or a model's name.
    pub annotator: String,
}
