//! The records of an episode: what a trace stores, replay compares, rewards read
//! and tables spread out.
//!
//! Inputs (header, calls, policy outputs, replies) are what an episode is a function of; everything
//! else is an output and can be made again.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::{
    AssetId, Digest, ErrorCode, Family, FrameDigests, GraphEvent, InstanceId, Outcome, Profile,
    ReceptacleId, Skills, Task, TokenLogprobs, Tool, ToolCall, ToolSpec, WorldGraph,
};

/// Where an episode ran.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Backend {
    /// Reel's own simulator: the episode can be re-executed.
    #[default]
    Sim,
    /// A physical robot: the episode cannot be re-executed.
    Robot,
    /// Another simulator behind the recording proxy.
    Proxy,
    /// Another program, whose own log was imported: nothing of it can be re-executed.
    Imported,
}

impl Backend {
    /// How an episode was recorded that cannot be executed again, in words; none for our simulator.
    pub fn not_replayable_reason(self) -> Option<&'static str> {
        match self {
            Backend::Sim => None,
            Backend::Robot => Some("on a robot"),
            Backend::Proxy => Some("through a proxy"),
            Backend::Imported => Some("by another program"),
        }
    }
}

/// The policy that made the decisions, with its settings.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct PolicyInfo {
    /// Name of the policy, e.g. `oracle`.
    pub name: String,
    /// Digest of a model's checkpoint.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub checkpoint: Option<String>,
    /// Sampling parameters and the policy's own settings.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub parameters: BTreeMap<String, Value>,
}

/// The inputs of an episode that are known before its first call.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct EpisodeHeader {
    /// Digest of the other inputs here, shortened: equal inputs give equal ids.
    pub episode_id: String,
    /// The run (one command) it belongs to.
    pub run_id: String,
    /// The prompt group of a rollout, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub group_id: Option<String>,
    /// Its index in that group.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rollout_index: Option<u32>,
    /// Id of the task that the episode plays.
    pub task_id: String,
    /// Task family of the episode, e.g. `FDP`.
    pub family: Family,
    /// Id of the scene that the episode plays in.
    pub scene_id: String,
    /// Of the task's canonical JSON.
    pub task_digest: Digest,
    /// Of the scene's canonical JSON.
    pub scene_digest: Digest,
    /// Seed of everything random.
    pub seed: u64,
    /// The simulator's version; another one may give other bits.
    pub sim_version: u32,
    /// Version of Reel that recorded the episode, e.g. `0.2.0`.
    pub build: String,
    /// Behaviour where paper and published code differ.
    pub profile: Profile,
    /// Reward preset whose terms the steps hold.
    pub reward_preset: String,
    /// The policy that made the decisions.
    pub policy: PolicyInfo,
    /// Where the episode ran: in the simulator, on a robot or behind a proxy.
    #[serde(default)]
    pub backend: Backend,
    /// How reliable the robot's skills were.
    #[serde(default, skip_serializing_if = "Skills::are_perfect")]
    pub skills: Skills,
    /// Digests of the meshes that stood in for primitives, by asset.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub meshes: BTreeMap<AssetId, Digest>,
    /// The trace and call this one branches from, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parent: Option<Parent>,
}

impl EpisodeHeader {
    /// With the id that follows from the other inputs.
    #[must_use]
    pub fn identified(mut self) -> Self {
        let build = std::mem::take(&mut self.build);
        self.episode_id.clear();
        self.episode_id = Digest::of_json(&self).to_string()[..16].to_owned();
        self.build = build;
        self
    }
}

/// Where a branched episode came from.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct Parent {
    /// Chain digest of the parent trace.
    pub trace: Digest,
    /// First call that differs.
    pub call: u32,
}

/// What came with a decision besides the call (docs/spec.md#policy-context). Inputs,
/// kept as they came.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct PolicyOutput {
    /// The policy's output as raw text; empty if there is none.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub raw: String,
    /// `c_t`: the reasoning that came with the call; empty if there is none.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reasoning: String,
    /// `sigma_t`: the History, which reaches the next decision; empty if there is none.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub history: String,
    /// `q_t`: schedule and subtask.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub plan: String,
    /// Tokens read and written, where a model counts them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tokens: Option<[u32; 2]>,
    /// How long the policy took, in nanoseconds; outside every digest.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub latency_ns: Option<u64>,
    /// Log-probabilities of the tokens that it wrote, where the endpoint gave
    /// them; outside every digest.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub logprobs: Option<TokenLogprobs>,
}

/// Who answered an `ask`.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum UserSource {
    /// The rules of docs/spec.md#simulated-user.
    RuleBased,
    /// A model in the role of the user.
    Model,
    /// A person in the role of the user.
    Human,
}

/// An answer to an `ask`.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct UserReply {
    /// Text of the reply to the question.
    pub text: String,
    /// Who or what gave the reply.
    pub source: UserSource,
}

/// What a model in the role of the user said first, which the policy did not get because it gave
/// something away, or said nothing.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct RefusedReply {
    /// Text of the reply, as the model said it.
    pub text: String,
    /// What is wrong with it: `exact_position`, `raw_id`, `empty`.
    pub rules: Vec<String>,
}

/// Which categories a query means, looked up outside.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct Lookup {
    /// Categories of the task's objects, in order.
    pub categories: Vec<String>,
    /// Who says so, e.g. the model whose vectors were compared.
    pub source: String,
}

/// The inputs of one step.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct StepInput {
    /// The call as the policy made it.
    pub call: ToolCall,
    /// What came with it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policy: Option<PolicyOutput>,
    /// The reply from outside; absent: the rule-based user answers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub user_reply: Option<UserReply>,
    /// Replies that were refused before that one, in the order in which they came. Where all were,
    /// `user_reply` is absent.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub refused_replies: Vec<RefusedReply>,
    /// The look-up from outside of what a query means; absent: the vocabulary says it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lookup: Option<Lookup>,
}

impl StepInput {
    /// A call with nothing from outside.
    pub fn from_call(call: ToolCall) -> Self {
        Self {
            call,
            policy: None,
            user_reply: None,
            refused_replies: Vec::new(),
            lookup: None,
        }
    }

    /// A call and what came with it.
    pub fn with_policy_output(call: ToolCall, policy: PolicyOutput) -> Self {
        Self {
            policy: Some(policy),
            ..Self::from_call(call)
        }
    }
}

/// What a marker stands for.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(tag = "kind", content = "id", rename_all = "lowercase")]
pub enum MarkerTarget {
    /// An object of the task, by its instance id.
    Object(InstanceId),
    /// A receptacle of the scene, by its id.
    Receptacle(ReceptacleId),
}

/// One number of the current marker map.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct Marker {
    /// Number of the marker, unique in the current map.
    pub id: u32,
    /// What it stands for. Never shown to the policy.
    pub target: MarkerTarget,
}

/// An object in the current image.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct VisibleObject {
    /// Instance id of the visible object.
    pub object: InstanceId,
    /// How many pixels of it are seen.
    pub pixels: u32,
    /// Its bounding box in the image: x, y of the first and of the last pixel.
    pub bbox: [u16; 4],
}

/// Motion state of one body, exactly. Frame: the scene's, metres, quaternion x, y, z, w.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct BodyState {
    /// Instance id, or `door:<receptacle>`.
    pub body: String,
    /// Position of its origin, in metres.
    pub position: [f32; 3],
    /// Orientation as a quaternion x, y, z, w.
    pub rotation: [f32; 4],
    /// In metres per second.
    pub linear_velocity: [f32; 3],
    /// In radians per second.
    pub angular_velocity: [f32; 3],
    /// Whether physics put it to sleep.
    pub asleep: bool,
}

/// The robot: base on the floor, camera on its head.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct RobotState {
    /// Base: x, y in metres.
    pub base: [f32; 2],
    /// Heading of base and camera around z, in radians (0 looks along +x).
    pub yaw: f32,
    /// Camera position in metres.
    pub camera: [f32; 3],
    /// Camera pitch in radians (negative looks down).
    pub pitch: f32,
    /// Path the base drove since the start of the episode, in metres.
    pub path_length_m: f32,
}

/// Digests of a moment.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
pub struct StateDigests {
    /// Of the whole simulator state.
    pub state: Digest,
    /// Of the image, where one was taken.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<FrameDigests>,
    /// First four bytes of the state digest after each executed physics step, in order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub physics_steps: Vec<u32>,
}

/// Both authorities' graphs (docs/spec.md#authority).
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
pub struct Graphs {
    /// Where physics says the objects are: scores in preset `paper`.
    pub physics: WorldGraph,
    /// Where picks and places say they are: scores in preset `real-repo`.
    pub registry: WorldGraph,
}

/// Both authorities' changes in one step.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
pub struct GraphChanges {
    /// Of the physical graph.
    pub physics: Vec<GraphEvent>,
    /// Changes of the registry's graph, which follows picks and places.
    pub registry: Vec<GraphEvent>,
}

/// One term of a step's reward.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct RewardTerm {
    /// `task`, `prog`, `phys`, `ask`, `time`, `safe`.
    pub component: String,
    /// Signed value of the term; the step's reward is the sum of its terms.
    pub value: f64,
    /// Why, for people: which event or rule.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
}

/// The state after the start, before the first decision.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct StartRecord {
    /// World graphs of both authorities after the objects have settled.
    pub graphs: Graphs,
    /// After settling, by stable id.
    pub bodies: Vec<BodyState>,
    /// Where the robot stands.
    pub robot: RobotState,
    /// What its camera sees.
    pub visible: Vec<VisibleObject>,
    /// Shortest base path start -> src -> dest with a perfect map, in metres (`l` of SPL); absent
    /// if there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shortest_path_m: Option<f32>,
    /// Digests of the settled state, of its frame if one was taken, and of the hash chain.
    pub digests: StateDigests,
}

/// One decision and what came of it.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct StepRecord {
    /// Index of the step in its episode, from 0.
    pub step: u32,
    /// What it was a function of.
    pub input: StepInput,
    /// What the policy got.
    pub outcome: Outcome,
    /// The tool's name in the paper; absent when the call was none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tool: Option<String>,
    /// The answer of an `ask`, from outside or by rule.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reply: Option<UserReply>,
    /// The marker map after the call.
    pub markers: Vec<Marker>,
    /// Objects in the image.
    pub visible: Vec<VisibleObject>,
    /// Objects whose existence the outcome told in words (`walk_around`).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub listed: Vec<InstanceId>,
    /// The object that the call acted on: picked, placed, gazed at.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub object: Option<InstanceId>,
    /// The receptacle that the call acted on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub receptacle: Option<ReceptacleId>,
    /// What the gripper holds after the call.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held: Option<InstanceId>,
    /// How the graphs of both authorities changed in this step.
    pub changes: GraphChanges,
    /// Motion states after the call, by stable id.
    pub bodies: Vec<BodyState>,
    /// The robot after the call.
    pub robot: RobotState,
    /// Simulation time after the call, in physics steps since the start.
    pub sim_step: u64,
    /// Reward terms under the header's preset; those that are zero are left out.
    pub reward: Vec<RewardTerm>,
    /// Digests of the state after the call, of its frame if one was taken, and of the hash chain.
    pub digests: StateDigests,
}

/// Why an episode ended.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EndReason {
    /// The policy called `finish`.
    Finished,
    /// The horizon was reached.
    Horizon,
    /// An error that cannot be recovered from.
    Fault,
    /// The runner or a client stopped it.
    Aborted,
}

/// How an episode ended.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct EndRecord {
    /// Why the episode ended, e.g. because the policy called `finish`.
    pub reason: EndReason,
    /// World graphs of both authorities at the end of the episode.
    pub graphs: Graphs,
    /// Metrics under the header's preset.
    pub metrics: Metrics,
    /// How many steps there were.
    pub steps: u32,
    /// What others said of the result; empty where nobody did.
    #[serde(default, skip_serializing_if = "Reported::is_empty")]
    pub reported: Reported,
}

impl EndRecord {
    /// Whether the episode succeeded: by its goal (SR), or as it was reported where the task has
    /// none. `None` where nobody knows.
    pub fn success(&self, task: &Task) -> Option<bool> {
        if task.has_goal() {
            Some(self.metrics.success)
        } else {
            self.reported.success
        }
    }
}

/// What a scorer, a benchmark or a person said of an episode where it ran. Reel computes nothing
/// of it.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct Reported {
    /// Whether it was a success; absent where that was not said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub success: Option<bool>,
    /// In the order in which they were told.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub scores: Vec<Score>,
}

impl Reported {
    /// Whether nothing was said.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// A score of one scorer, with its name.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct Score {
    /// The scorer's name, e.g. `includes`; with a dot before the name of a part of its score.
    pub name: String,
    /// As a number; absent where it is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value: Option<f64>,
    /// As it was told where it is no number, e.g. `C` for correct.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<String>,
    /// Why, in the scorer's words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub explanation: Option<String>,
}

/// Metrics of one episode (docs/spec.md#metrics).
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct Metrics {
    /// SR: no goal change is left.
    pub success: bool,
    /// CR: share of the goal changes that hold.
    pub completion: f64,
    /// Sum of the rewards of all steps, without discounting.
    pub total_reward: f64,
    /// Discounted return, gamma 0.99.
    pub discounted_return: f64,
    /// Length of the episode in decisions, one for each step.
    pub length: u32,
    /// Number of `ask` calls in the episode, answered or not.
    pub asks: u32,
    /// `S * l / max(p, l)`; absent where `l` is unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spl: Option<f64>,
}

impl StepRecord {
    /// The tool that was called: the paper's name, or the name as called where it is no tool.
    pub fn tool_name(&self) -> &str {
        let called = self.input.call.name.as_str();
        self.tool
            .as_deref()
            .unwrap_or_else(|| ToolSpec::paper_name_of(called))
    }

    /// Why the episode is over after this step, if it is. Only our simulator ends one for all three
    /// reasons: a fault comes before `finish`, and `finish` before the horizon.
    pub fn end_reason(&self, profile: Profile) -> Option<EndReason> {
        if self.outcome.error == Some(ErrorCode::PhysicsFault) {
            Some(EndReason::Fault)
        } else if self.tool.as_deref() == Some(Tool::Finish.paper_name()) {
            Some(EndReason::Finished)
        } else {
            (self.step + 1 >= profile.horizon()).then_some(EndReason::Horizon)
        }
    }

    /// Sum of the reward terms.
    pub fn reward_total(&self) -> f64 {
        self.reward.iter().map(|term| term.value).sum()
    }
}
