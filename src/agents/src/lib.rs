//! Policies that come with Reel, and the runner that plays and records episodes.
//!
//! The oracle, a planner that sees only what an agent sees, and policies with one fault each. Never
//! the simulator's inside: a policy gets a [`PolicyContext`] and gives a call. Only the oracle and
//! the faulty policies, which are built on it, read the truth.

mod explorer;
mod faults;
mod injection;
mod narration;
mod oracle;
mod perception;
pub mod perturb;
pub mod plan;
mod planner;
mod policy;
mod random;
mod record;
mod responders;
mod runner;
mod running;
mod sink;

use std::path::PathBuf;

pub use explorer::Explorer;
pub use faults::{Gibberish, Oscillating, mistaken_task};
pub use injection::{
    Detour, Fault, FaultKind, FaultLabel, Injected, Injection, InjectionError, Label, Primary,
    SampleOptions, admitted, cluttered, paper_mix, sample,
};
pub use oracle::{Oracle, OracleOptions};
pub use planner::{GoalHint, Planner};
pub use policy::{POLICIES, PerceivedItem, Policy, PolicyContext, policy};
pub use record::{RecordTo, TraceSink};
pub use responders::{Matcher, ResponderError, Responders, USER_TRIES, User, ask_user};
pub use runner::{
    EpisodeJob, EpisodeReport, Participants, builtin, run_all, run_episode, run_injected,
};
pub use running::{RunningEpisode, retrace};
pub use sink::{NoSink, RecordedTrace, Sink, SinkError};

/// What can go wrong around an episode; never what goes wrong in it, which is
/// feedback for the policy.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum AgentError {
    /// No policy of this name.
    #[error("no policy is called '{name}'; known are {known}", known = policy::names())]
    UnknownPolicy { name: String },
    /// The episode cannot start.
    #[error("task {task}: the episode cannot start; check that task and scene belong together")]
    Start {
        task: String,
        source: reel_episode::EpisodeError,
    },
    /// The trace cannot be written.
    #[error("task {task}, seed {seed}: the trace cannot be written to {path}")]
    Trace {
        task: String,
        seed: u64,
        path: PathBuf,
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The task does not admit what shall go wrong.
    #[error("task {task}: this cannot go wrong there")]
    Injection {
        task: String,
        source: InjectionError,
    },
    /// The episode was not begun.
    #[error("task {task}, seed {seed}: not played: {why}")]
    NotPlayed {
        task: String,
        seed: u64,
        /// Reason why the episode was not begun, e.g. a spent budget.
        why: String,
    },
    /// A policy, a user or a matcher asks somebody who does not answer.
    #[error("task {task}, seed {seed}: no answer; the episode ended at step {step} as aborted")]
    NoAnswer {
        task: String,
        seed: u64,
        step: u32,
        source: ResponderError,
    },
    /// The label cannot be written.
    #[error("task {task}, seed {seed}: the label cannot be written to {path}")]
    Label {
        task: String,
        seed: u64,
        /// Path of the label file, `<trace>.label.json`.
        path: PathBuf,
        source: std::io::Error,
    },
    /// An episode broke down by a fault of ours.
    #[error(
        "task {task}, policy {policy}, seed {seed}: the episode panicked: {message}; reproduce it with: {command}"
    )]
    Panicked {
        task: String,
        policy: String,
        seed: u64,
        message: String,
        command: String,
    },
    /// The worker threads cannot be started.
    #[error("{workers} worker threads cannot be started; ask for fewer")]
    Workers { workers: usize, message: String },
}
