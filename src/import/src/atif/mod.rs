//! Trajectories of agents in the Agent Trajectory Interchange Format (ATIF), which Harbor defines
//! and Inspect Scout, Phoenix and NeMo read or write: traces as such documents, and such documents
//! of any agent as traces.
//!
//! # What becomes of what
//! - `steps[].tool_calls[]`: one step of the trace each; of several in one turn the first one has
//!   what was said. A turn without a call is a call of [`SPOKEN_TURN`](reel_world::SPOKEN_TURN).
//! - `message`, `reasoning_content`: raw output and reasoning of the policy. `metrics`: tokens and
//!   log-probabilities.
//! - `observation.results[]`: outcome and image of the call that they name. Results that name no
//!   call belong to the last one.
//! - Turns of system and user before the first of the agent: system prompt (a parameter of the
//!   policy) and instruction. Later ones are part of what the agent got after its last call.
//! - `agent`: name and model of the policy; `version` and `tool_definitions` are parameters.
//! - `extra.reel`: what a trace of Reel has beyond that ([`LOST`] lists what is not kept). With it
//!   task, rewards, world graphs and the end are those of the trace; without it the task has no
//!   goal, and whether the episode succeeded is not known.

mod model;
mod reading;
mod turns;
mod writing;

pub(crate) use model::words_of;
pub use model::{
    Agent, Call, CallResult, Content, FinalMetrics, Media, Observation, Part, Source, Step,
    StepMetrics, Trajectory, VERSION,
};
pub(crate) use reading::{Episode, LogFacts, read_file};
pub use reading::{documents, import};
pub use writing::{Exported, export};

use reel_world::Task;
use reel_world::record::{EndRecord, EpisodeHeader, Graphs};
use serde::{Deserialize, Serialize};

/// Key of what is ours in `extra`.
pub(crate) const OURS: &str = "reel";

/// What of a trace is not the same after `reel export atif` and `reel import atif`: the field, and
/// what becomes of it.
pub const LOST: &[(&str, &str)] = &[
    ("header.episode_id", "another one, of the imported content"),
    ("header.run_id", "that of the import"),
    (
        "header.backend",
        "imported: an imported episode is not executed again",
    ),
    ("header.build", "the version of Reel that imported it"),
    (
        "header.policy.parameters",
        "besides the recorded ones, what the document says of the agent",
    ),
    (
        "header.scene_digest",
        "that of the scene that --scene or --tasks gives, else of an empty one",
    ),
    ("header.meshes", "absent"),
    ("header.parent", "absent: a branch stands for itself"),
    (
        "scene",
        "the one that --scene or --tasks gives, else an empty one",
    ),
    ("start.bodies", "absent"),
    ("start.robot", "absent"),
    ("start.visible", "absent"),
    ("start.digests", "of the image alone"),
    ("steps[].bodies", "absent"),
    ("steps[].visible", "absent"),
    ("steps[].digests", "of the image alone"),
    ("depth", "absent"),
    ("masks", "absent"),
    ("timings", "absent"),
    ("mcp_answers", "absent"),
    ("redactions", "absent"),
    ("robot", "what a robot measured is absent"),
    ("sensors", "absent"),
];

/// What a document of ours keeps of a trace beside the fields of the format. A step keeps its record, in which those are empty.
#[derive(Serialize, Deserialize)]
struct KeptEpisode {
    /// Chain digest of the trace.
    trace_digest: String,
    header: EpisodeHeader,
    task: Task,
    graphs: Graphs,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    shortest_path_m: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    end: Option<EndRecord>,
}
