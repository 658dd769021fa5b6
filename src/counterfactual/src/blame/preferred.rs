//! The decision to prefer to the decisive one, for training on pairs: what a competent agent that
//! knew what the episode's agent knew would have called. Never a guess: the call has to be
//! possible, and the future after it was played and succeeds.

use std::path::{Path, PathBuf};

use reel_trace::Trace;
use reel_world::{Tool, ToolCall};
use serde::Serialize;

use crate::{
    blame::{Cause, Decisive, alternative::recorded},
    branch::{Branch, BranchError, Continuation, fork},
};

/// A better decision at the decisive step, and the future that shows it.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Preferred {
    /// Index of the decision in the episode, from 0: that of the decisive step.
    pub at: usize,
    /// The call to prefer.
    pub call: ToolCall,
    /// Decisions of the whole episode then.
    pub length: u32,
    /// The trace of the future after it, where one was wanted.
    pub trace: Option<PathBuf>,
    /// Whether the trace was replayed and is exact, with the parent's past.
    pub verified: bool,
}

/// Plays the advised call at the decisive step, with a competent agent going on after it, and
/// records and verifies that future where a path is given.
///
/// # Errors
/// When the episode cannot be executed up to there, or the branch cannot be written. Inside: why no
/// decision is to be preferred.
pub fn preferred(
    trace: &Trace,
    decisive: &Decisive,
    record: Option<&Path>,
) -> Result<Result<Preferred, String>, BranchError> {
    let (at, call) = (decisive.step as usize, &decisive.advised_call);
    if same(call, &decisive.call) {
        return Ok(Err(format!(
            "the decisive call {call} is what a competent agent would have called, too"
        )));
    }
    let asks = matches!(Tool::parse(call), Ok(Tool::Ask { .. }));
    if decisive.cause == Cause::Communication && !asks {
        return Ok(Err(format!("a question was missing, and {call} is none")));
    }
    let fork = fork(trace, at, None)?;
    let branch = Branch {
        calls: vec![call.clone()],
        continuation: Continuation::Policy {
            name: "planner".to_owned(),
            seed: trace.header.seed,
        },
    };
    let (report, steps) = branch.play_for_steps(&fork)?;
    if let Some(error) = steps.get(at).and_then(|step| step.outcome.error) {
        return Ok(Err(format!("{call} fails at this moment: {error}")));
    }
    if !report.success {
        return Ok(Err(format!(
            "after {call} an agent that knows what this one knew does not succeed ({:?} after {} calls)",
            report.end_reason, report.length
        )));
    }
    let verified = match record {
        Some(path) => recorded(&branch, &fork, path)?,
        None => false,
    };
    Ok(Ok(Preferred {
        at,
        call: call.clone(),
        length: report.length,
        trace: record.map(Path::to_owned),
        verified,
    }))
}

/// Whether two calls do the same, whatever name set and spelling they use.
fn same(one: &ToolCall, other: &ToolCall) -> bool {
    match (Tool::parse(one), Tool::parse(other)) {
        (Ok(one), Ok(other)) => one == other,
        _ => one == other,
    }
}
