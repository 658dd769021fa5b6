//! The words every other crate speaks: scenes, tasks, the world graph and its difference, tools and
//! outcomes, the records of an episode, and named invariants.
//!
//! Pure data and pure functions. Never I/O, a clock, a thread, randomness or hash-order containers.

/// An array of texts, written one after the other: those that are identifiers need no quotes.
#[macro_export]
macro_rules! words {
    ($($word:tt)*) => { [$($crate::word!($word)),*] };
}

/// One text of [`words!`].
#[doc(hidden)]
#[macro_export]
macro_rules! word {
    ($word:ident) => {
        stringify!($word)
    };
    ($word:literal) => {
        $word
    };
}

mod ask_context;
mod canonical;
mod digest;
mod failure;
mod frame;
mod furniture;
mod graph;
mod id;
mod plan_text;
mod playable;
mod primitive;
mod printable;
mod profile;
mod scene;
mod skills;
mod spaced_json;
mod task;
mod tool;

pub mod answer;
pub mod invariants;
pub mod language;
pub mod logprobs;
pub mod mesh;
pub mod outcome;
pub mod record;
pub mod tool_text;

pub use ask_context::{
    AskContext, ask_answer, ask_context, ask_context_of_episode, ask_error, ask_reply,
};
pub use canonical::canonical_json;
pub use digest::Digest;
pub use failure::FailureClass;
pub use frame::{
    FIRST_RECEPTACLE_INSTANCE, FRAME_HEIGHT, FRAME_WIDTH, Frame, FrameDigests, FrameInstance,
    InstanceKind, MarkerBox, ROBOT_INSTANCE, SHELL_INSTANCE, instances, little_endian,
};
pub use furniture::{FurnitureGeometry, FurnitureJoint, Solid, SolidShape};
pub use graph::{DoorState, GraphEvent, ReceptacleState, WorldGraph};
pub use id::{AssetId, FLOOR, InstanceId, ReceptacleId};
pub use logprobs::{LogprobError, OLD_POLICY, TokenLogprobs};
pub use mesh::{Assets, Mesh, Meshes, NoAssets};
pub use outcome::{ErrorClass, ErrorCode, Outcome};
pub use playable::check_playable;
pub use primitive::Primitive;
pub use printable::{is_invisible, printable_line, printable_lines};
pub use profile::Profile;
pub use scene::{Door, Receptacle, Rect, Room, Scene, Scenes, Wall};
pub use skills::Skills;
pub use spaced_json::spaced_json;
pub use task::{Attributes, Family, ObjectInstance, PlanStep, Task};
pub use tool::{CallError, Lifecycle, NameSet, Tool, ToolCall, ToolSpec, value_text};
pub use tool_text::ToolText;

/// The tool that a turn without a call calls, in traces of agents with tools of their own.
pub const SPOKEN_TURN: &str = "message";
/// One physics step, in seconds (docs/spec.md#episode).
pub const DT_S: f32 = 1.0 / 240.0;
/// Most decisions in an episode (`H_max`, paper, Action Space and Tool Configurations).
pub const HORIZON: u32 = 30;
/// Discount factor (paper, Full POMDP Definition).
pub const GAMMA: f64 = 0.99;
