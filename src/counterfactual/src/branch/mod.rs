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
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum BranchError {
    /// The episode cannot be executed up to there, or differs on the way.
    #[error("cannot branch at call {call}: {what}: {path}", what = told(verdict), path = path.display())]
    Parent {
        path: PathBuf,
        /// Index of the parent's call to branch at, from 0.
        call: usize,
        verdict: Box<Verdict>,
    },
    /// The parent's calls end before the one to go on with.
    #[error("cannot continue from call {from}: the episode has {calls} calls, from 0: {path}", path = path.display())]
    NoSuchCall {
        path: PathBuf,
        /// Index of the parent's call to continue from, from 0.
        from: usize,
        calls: usize,
    },
    /// An image of the parent is wanted and cannot be had.
    #[error("the images before call {call} cannot be rendered: {what}: {path}", what = told(verdict), path = path.display())]
    Frames {
        path: PathBuf,
        call: usize,
        verdict: Box<Verdict>,
    },
    /// A call is not written as one.
    #[error(
        "{reason}; write a call as {{\"name\": \"pick\", \"arguments\": {{\"marker_id\": 1}}}}: {text}"
    )]
    Call { text: String, reason: String },
    /// A line of a file of calls is none.
    #[error("line {line}: {source}")]
    Line {
        /// Number of the line in the file, from 1.
        line: usize,
        source: Box<BranchError>,
    },
    /// A branch cannot be read again.
    #[error("the branch cannot be read again: {error}: {path}", path = path.display())]
    Unreadable { path: PathBuf, error: String },
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
