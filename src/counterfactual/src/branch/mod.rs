//! Other futures of a recorded episode: its calls up to one, then others, or a policy that takes
//! over, as a trace with lineage.
//!
//! Never looks for the future that would be better; it plays the one it is told to. Going to the
//! moment, and comparing a branch with its parent, is `replay`'s.

mod calls;
mod continuation;

use std::path::PathBuf;

use reel_replay::Verdict;

pub use calls::{parse_call, parse_calls};
pub use continuation::{Branch, Continuation, POLICY_NAME, fork};

/// Why there is no branch.
#[derive(Debug, thiserror::Error)]
pub enum BranchError {
    /// The episode cannot be executed up to there, or differs on the way.
    #[error("cannot branch at call {call}: {what}: {path}", what = told(verdict), path = path.display())]
    Parent {
        /// Path of the parent's trace file.
        path: PathBuf,
        /// Index of the parent's call to branch at, from 0.
        call: usize,
        /// Replay verdict that says why the parent cannot be executed up to there.
        verdict: Box<Verdict>,
    },
    /// The parent's calls end before the one to go on with.
    #[error("there is no call {from} to go on with: the episode has {calls} calls, from 0: {path}", path = path.display())]
    NoSuchCall {
        /// Path of the parent's trace file.
        path: PathBuf,
        /// Index of the parent's call to continue from, from 0.
        from: usize,
        /// How many there are.
        calls: usize,
    },
    /// A picture of the parent is wanted and cannot be had.
    #[error("the pictures before call {call} cannot be had: {what}: {path}", what = told(verdict), path = path.display())]
    Frames {
        /// Path of the parent's trace file.
        path: PathBuf,
        /// The call it branches at.
        call: usize,
        /// Replay verdict that says why the frames are missing.
        verdict: Box<Verdict>,
    },
    /// A call is not written as one.
    #[error(
        "{reason}; write a call as {{\"name\": \"pick\", \"arguments\": {{\"marker_id\": 1}}}}: {text}"
    )]
    Call {
        /// The text that was given as a call.
        text: String,
        /// Why the text is not a valid call.
        reason: String,
    },
    /// A line of a file of calls is none.
    #[error("line {line}: {source}")]
    Line {
        /// Number of the line in the file, from 1.
        line: usize,
        /// Why the call on that line is invalid.
        source: Box<BranchError>,
    },
    /// A branch cannot be read again.
    #[error("the branch cannot be read again: {error}: {path}", path = path.display())]
    Unreadable {
        /// Path of the branch's trace file.
        path: PathBuf,
        /// Error message of the failed attempt to read the trace.
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
