//! Other futures of a recorded episode: its calls up to one, then others, or a policy that takes
//! over, as a trace with lineage.
//!
//! Never looks for the future that would be better; it plays the one it is told to. Going to the
//! moment, and comparing a branch with its parent, is `replay`'s.

mod branch;
mod calls;

use std::path::PathBuf;

use reel_replay::Verdict;

pub use branch::{Branch, Continuation, POLICY_NAME, fork};
pub use calls::{parse_call, parse_calls};

/// Why there is no branch.
#[derive(Debug, thiserror::Error)]
pub enum BranchError {
    /// The episode cannot be executed up to there, or differs on the way.
    #[error("cannot branch at call {call}: {what}: {path}", what = told(verdict), path = path.display())]
    Parent {
        /// The trace.
        path: PathBuf,
        /// Where to.
        call: usize,
        /// What was found.
        verdict: Box<Verdict>,
    },
    /// The parent's calls end before the one to go on with.
    #[error("there is no call {from} to go on with: the episode has {calls} calls, from 0: {path}", path = path.display())]
    NoSuchCall {
        /// The trace.
        path: PathBuf,
        /// Which call.
        from: usize,
        /// How many there are.
        calls: usize,
    },
    /// A picture of the parent is wanted and cannot be had.
    #[error("the pictures before call {call} cannot be had: {what}: {path}", what = told(verdict), path = path.display())]
    Frames {
        /// The trace.
        path: PathBuf,
        /// The call it branches at.
        call: usize,
        /// Why.
        verdict: Box<Verdict>,
    },
    /// A call is not written as one.
    #[error(
        "{what}; write a call as {{\"name\": \"pick\", \"arguments\": {{\"marker_id\": 1}}}}: {text}"
    )]
    Call {
        /// As written.
        text: String,
        /// What is wrong.
        reason: String,
    },
    /// A line of a file of calls is none.
    #[error("line {line}: {source}")]
    Line {
        /// Which, from 1.
        line: usize,
        /// Why.
        source: Box<BranchError>,
    },
    /// A branch cannot be read again.
    #[error("the branch cannot be read again: {error}: {path}", path = path.display())]
    Unreadable {
        /// The trace.
        path: PathBuf,
        /// Why.
        error: String,
    },
    /// The policy is unknown, or the trace cannot be written.
    #[error(transparent)]
    Agent(#[from] reel_agents::AgentError),
}

impl BranchError {
    /// Whether the parent could be executed but is not what its simulator gives.
    pub fn is_divergence(&self) -> bool {
        matches!(self, BranchError::Parent { verdict, .. } if matches!(**verdict, Verdict::Diverged { .. }))
    }
}

/// A verdict in a sentence.
fn told(verdict: &Verdict) -> String {
    match verdict {
        Verdict::Refused { reason } | Verdict::NotReplayable { reason } => reason.clone(),
        other => other.to_string(),
    }
}
