//! The one step function that every runner uses: dispatch of a call to the simulator or
//! the user, graphs, reward, digests and the hash chain. Never files, clocks or threads;
//! the caller owns those.

mod episode;
mod published_user;
pub mod user;

use std::sync::Arc;

use reel_reward::Preset;
use reel_world::{
    Digest, ErrorCode, Frame, InstanceId, Meshes, Profile, Receptacle, ReceptacleId, Scene, Skills,
    Task, WorldGraph,
    record::{EpisodeHeader, Marker, Parent, PolicyInfo, StepRecord},
};

pub use episode::{Episode, Suspended, prepare_task};
pub use reel_sim::{PreparedTask, render::Detail};

/// What an episode is a function of, besides its calls.
#[derive(Clone, Debug)]
pub struct EpisodeConfig {
    /// The task that the episode plays.
    pub task: Arc<Task>,
    /// The scene of that task.
    pub scene: Arc<Scene>,
    /// Seed of everything random in the simulator.
    pub seed: u64,
    /// Behaviour where paper and published code differ.
    pub profile: Profile,
    /// How reliable the robot's skills are.
    pub skills: Skills,
    /// What its objects look like, those that have a mesh; no others than the task's.
    pub meshes: Meshes,
    /// Reward preset whose terms the steps hold.
    pub preset: Preset,
    /// The run it belongs to.
    pub run_id: String,
    /// The policy that makes the decisions.
    pub policy: PolicyInfo,
    /// The prompt group it is played for, if any.
    pub rollout: Option<Rollout>,
    /// The trace and call it branches from, if any.
    pub parent: Option<Parent>,
}

/// An episode's place in a prompt group: several episodes of one task and seed, whose advantages
/// are relative to each other.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Rollout {
    /// Id of the prompt group, which all of its episodes share.
    pub group_id: String,
    /// Index of the episode in its group, from 0.
    pub index: u32,
}

impl Rollout {
    /// The place that a header names; none where it is of no group.
    pub fn of(header: &EpisodeHeader) -> Option<Self> {
        Some(Self {
            group_id: header.group_id.clone()?,
            index: header.rollout_index.unwrap_or(0),
        })
    }
}

/// What a step gives back: the record for the trace and the image for the policy.
#[derive(Clone, Debug)]
pub struct StepOutput {
    /// Record of the step, for the trace.
    pub record: StepRecord,
    /// The image, where the tool returns one.
    pub frame: Option<Frame>,
}

/// Why an episode cannot start.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum EpisodeError {
    /// The task plays in another scene.
    #[error("task {task} plays in scene {expected}, not in {found}")]
    SceneMismatch {
        task: String,
        expected: String,
        found: String,
    },
    /// No simulator could play it.
    #[error("task {task} cannot be played: {problem}")]
    Unplayable { task: String, problem: String },
    /// The snapshot is of another moment or episode.
    #[error("the snapshot has the state {found}, but after {steps} steps the state was {expected}")]
    SnapshotMismatch {
        steps: usize,
        expected: Digest,
        found: Digest,
    },
    /// The snapshot cannot be restored.
    #[error(transparent)]
    Snapshot(#[from] reel_sim::SnapshotError),
}

/// What an agent is told before its first decision: nothing privileged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Briefing {
    /// The task's instruction to the agent, in natural language.
    pub instruction: String,
    /// Receptacle ids with category and room.
    pub receptacles: Vec<(ReceptacleId, String, String)>,
}

impl Briefing {
    /// What an agent is told of a task in its scene.
    pub fn new(task: &Task, scene: &Scene) -> Self {
        let entry = |receptacle: &Receptacle| {
            (
                receptacle.id.clone(),
                receptacle.category.clone(),
                receptacle.room.clone(),
            )
        };
        Self {
            instruction: task.instruction.clone(),
            receptacles: scene.receptacles.iter().map(entry).collect(),
        }
    }
}

/// What an agent gets after a decision (and before the first): nothing privileged.
#[derive(Clone, Debug)]
pub struct Observation {
    /// Text of the outcome; empty before the first decision.
    pub text: String,
    /// Code of the error, if the call failed.
    pub error: Option<ErrorCode>,
    /// The image, if there is a new one.
    pub frame: Option<Frame>,
    /// The category of what the gripper holds; `None` if nothing.
    pub held: Option<String>,
}

/// The simulator's truth, for the oracle, built-in policies and tests. Never for
/// a policy under evaluation.
#[derive(Clone, Debug)]
pub struct Privileged<'a> {
    /// The task, goal included.
    pub task: &'a Task,
    /// The scene that the episode plays in.
    pub scene: &'a Scene,
    /// Where the objects are, by the authority of the profile: physics, or with the
    /// published servers the registry.
    pub graph: &'a WorldGraph,
    /// The current marker map with what the numbers stand for.
    pub markers: &'a [Marker],
    /// What the gripper holds.
    pub held: Option<&'a InstanceId>,
    /// The receptacle the robot stands at.
    pub landmark: Option<&'a ReceptacleId>,
}
