//! The better future of a decisive step, played and verified: a competent agent that knows what the episode's agent knew takes
//! over there; where even that fails, the oracle, which knows the truth. Never an edit of single calls.

use std::path::{Path, PathBuf};

use reel_agents::RecordTo;
use reel_branch::{Branch, BranchError, fork};
use reel_replay::{Fork, verify_branch};
use reel_trace::{Images, RecordOptions, Trace};
use serde::Serialize;

use crate::Decisive;

/// Who may take over, the one that knows less first.
pub(crate) const HEIRS: [&str; 2] = ["planner", "oracle"];

/// What would have been better.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Alternative {
    /// The policy that takes over at the decisive step: `planner` knows what the agent knew, `oracle` knows the truth.
    pub policy: String,
    /// Decisions of the whole episode then.
    pub length: u32,
    /// The branch, where one was wanted.
    pub trace: Option<PathBuf>,
    /// Whether the branch was replayed and is exact, with the parent's past.
    pub verified: bool,
}

/// Plays what would have been better at the decisive step, and records and verifies it where a path is given.
///
/// # Errors
/// When the episode cannot be executed up to there, or the branch cannot be written. Inside: why nobody succeeds from there.
pub fn alternative(
    trace: &Trace,
    decisive: &Decisive,
    record: Option<&Path>,
) -> Result<Result<Alternative, String>, BranchError> {
    let fork = fork(trace, decisive.step as usize, None)?;
    let mut told = Vec::new();
    for heir in HEIRS {
        let report = Branch::policy(heir, trace.header.seed).play(&fork, None)?;
        if !report.success {
            let why = report.unreachable.unwrap_or_else(|| format!("{:?} after {} calls", report.end_reason, report.length));
            told.push(format!("{heir}: {why}"));
            continue;
        }
        let verified = match record {
            Some(path) => recorded(&Branch::policy(heir, trace.header.seed), &fork, path)?,
            None => false,
        };
        let trace = record.map(Path::to_owned);
        return Ok(Ok(Alternative { policy: heir.to_owned(), length: report.length, trace, verified }));
    }
    Ok(Err(format!("from call {} on nobody succeeds ({})", decisive.step, told.join("; "))))
}

/// Records a branch, and replays what was recorded.
pub(crate) fn recorded(branch: &Branch, fork: &Fork<'_>, path: &Path) -> Result<bool, BranchError> {
    let record = RecordTo { path: path.to_owned(), options: RecordOptions::from(Images::None) };
    branch.play(fork, Some(&record))?;
    let made = Trace::read(path).map_err(|error| BranchError::Unreadable { path: path.to_owned(), error: error.to_string() })?;
    Ok(verify_branch(&made, fork.parent()).holds())
}
