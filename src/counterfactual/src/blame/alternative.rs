//! The better future of a decisive step, played and verified: a competent agent that knows what the
//! episode's agent knew takes over there; where even that fails, the oracle, which knows the truth.
//! Never an edit of single calls.

use std::path::{Path, PathBuf};

use crate::branch::{Branch, BranchError, fork};
use reel_agents::RecordTo;
use reel_replay::{Fork, verify_branch};
use reel_trace::{Images, RecordOptions, Trace};
use reel_world::{ToolCall, record::StepRecord};
use serde::{Deserialize, Serialize};

use crate::blame::{CompetentAgent, Decisive};

/// What would have been better.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Alternative {
    /// The policy that takes over at the decisive step: the competent agent, which knows what the
    /// agent knew, or `oracle`, which knows the truth.
    pub policy: String,
    /// What it calls at the decisive step.
    pub call: ToolCall,
    /// Decisions of the whole episode then.
    pub length: u32,
    /// The branch, where one was wanted.
    pub trace: Option<PathBuf>,
    /// Whether the branch was replayed and is exact, with the parent's past.
    pub verified: bool,
}

/// Plays what would have been better at the decisive step, and records and verifies it where
/// a path is given.
///
/// # Errors
/// When the episode cannot be executed up to there, or the branch cannot be written. Inside: why
/// nobody succeeds from there.
pub fn alternative(
    trace: &Trace,
    decisive: &Decisive,
    record: Option<&Path>,
    agent: CompetentAgent,
) -> Result<Result<Alternative, String>, BranchError> {
    let fork = fork(trace, decisive.step as usize, None)?;
    let better = match better_future(&fork, agent)? {
        Ok(better) => better,
        Err(why) => return Ok(Err(why)),
    };
    let verified = match record {
        Some(path) => recorded(&better.branch, &fork, path)?,
        None => false,
    };
    let (policy, trace) = (better.policy.to_owned(), record.map(Path::to_owned));
    let Some(call) = better.calls.first().cloned() else {
        return Ok(Err(format!("{policy} calls nothing from there on")));
    };
    Ok(Ok(Alternative {
        policy,
        call,
        length: better.length,
        trace,
        verified,
    }))
}

/// A future in which the episode succeeds.
pub(crate) struct SuccessfulFuture {
    policy: &'static str,
    branch: Branch,
    length: u32,
    /// Its calls from there on.
    pub calls: Vec<ToolCall>,
}

/// Lets the competent agent take over, then, where it fails, the oracle; else says how both failed.
pub(crate) fn better_future(
    fork: &Fork<'_>,
    agent: CompetentAgent,
) -> Result<Result<SuccessfulFuture, String>, BranchError> {
    let mut told = Vec::new();
    for policy in [agent.policy(), "oracle"] {
        let branch = Branch::policy(policy, fork.parent().header.seed);
        let (report, steps) = branch.play_for_steps(fork)?;
        if report.success {
            return Ok(Ok(SuccessfulFuture {
                policy,
                branch,
                length: report.length,
                calls: calls_from(&steps, fork.call()),
            }));
        }
        let why = report
            .unreachable
            .unwrap_or_else(|| format!("{:?} after {} calls", report.end_reason, report.length));
        told.push(format!("{policy}: {why}"));
    }
    Ok(Err(format!(
        "from call {} on nobody succeeds ({})",
        fork.call(),
        told.join("; ")
    )))
}

/// The calls of an episode from one on.
fn calls_from(steps: &[StepRecord], from: usize) -> Vec<ToolCall> {
    let calls = steps[from..].iter().map(|step| step.input.call.clone());
    calls.collect()
}

/// Records a branch, and replays what was recorded.
pub(crate) fn recorded(branch: &Branch, fork: &Fork<'_>, path: &Path) -> Result<bool, BranchError> {
    let record = RecordTo {
        path: path.to_owned(),
        options: RecordOptions::from(Images::None),
    };
    branch.play(fork, Some(&record))?;
    let made = Trace::read(path).map_err(|error| BranchError::Unreadable {
        path: path.to_owned(),
        error: error.to_string(),
    })?;
    let made = made.with_meshes(&*fork.parent().meshes);
    Ok(verify_branch(&made, fork.parent()).holds())
}
