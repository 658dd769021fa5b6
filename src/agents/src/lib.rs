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
pub use responders::{Matcher, ResponderError, Responders, User, UserQuestion};
pub use runner::{
    EpisodeJob, EpisodeReport, Participants, builtin, run_all, run_episode, run_injected,
};
pub use running::{RunningEpisode, retrace};
pub use sink::{NoSink, RecordedTrace, Sink, SinkError};

/// What can go wrong around an episode; never what goes wrong in it, which is
/// feedback for the policy.
#[derive(Debug, thiserror::Error)]
pub enum AgentError {
    /// No policy of this name.
    #[error("no policy is called '{name}'; known are {known}", known = policy::names())]
    UnknownPolicy {
        /// What was asked for.
        name: String,
    },
    /// The episode cannot start.
    #[error("task {task}: the episode cannot start; check that task and scene belong together")]
    Start {
        /// Id of the task whose episode cannot start.
        task: String,
        /// Reason that the environment gave for refusing to start.
        source: reel_episode::EpisodeError,
    },
    /// The trace cannot be written.
    #[error("task {task}, seed {seed}: the trace cannot be written to {path}")]
    Trace {
        /// Id of the task that was being recorded.
        task: String,
        /// Seed of the episode that was being recorded.
        seed: u64,
        /// Path of the trace that cannot be written.
        path: PathBuf,
        /// The error that the trace writer reported.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The task does not admit what shall go wrong.
    #[error("task {task}: this cannot go wrong there")]
    Injection {
        /// Id of the task that does not admit the injection.
        task: String,
        /// Reason why the injection cannot be applied to the task.
        source: InjectionError,
    },
    /// The episode was not begun.
    #[error("task {task}, seed {seed}: not played: {why}")]
    NotPlayed {
        /// Id of the task whose episode was not begun.
        task: String,
        /// Seed of the episode that was not begun.
        seed: u64,
        /// Reason why the episode was not begun, e.g. a spent budget.
        why: String,
    },
    /// A policy, a user or a matcher asks somebody who does not answer.
    #[error("task {task}, seed {seed}: no answer; the episode ended at step {step} as aborted")]
    NoAnswer {
        /// Id of the task whose episode was aborted.
        task: String,
        /// Seed of the episode that was aborted.
        seed: u64,
        /// The step that was not decided.
        step: u32,
        /// The error of the policy, user or matcher that gave no answer.
        source: ResponderError,
    },
    /// The label cannot be written.
    #[error("task {task}, seed {seed}: the label cannot be written to {path}")]
    Label {
        /// Id of the task whose episode was labelled.
        task: String,
        /// The seed of the injection.
        seed: u64,
        /// Path of the label file, `<trace>.label.json`.
        path: PathBuf,
        /// The error that the operating system reported.
        source: std::io::Error,
    },
    /// An episode broke down by a fault of ours.
    #[error(
        "task {task}, policy {policy}, seed {seed}: the episode broke down: {message}; reproduce it by: {command}"
    )]
    Panicked {
        /// Id of the task whose episode panicked.
        task: String,
        /// Name of the policy that played the episode.
        policy: String,
        /// Seed of the episode that panicked.
        seed: u64,
        /// What the panic said.
        message: String,
        /// The command that plays this episode alone.
        command: String,
    },
    /// The worker threads cannot be started.
    #[error("{workers} worker threads cannot be started; ask for fewer")]
    Workers {
        /// Number of worker threads that were requested.
        workers: usize,
        /// The error message of the thread pool.
        message: String,
    },
}
