//! Plays plausible calls. Many at a time, on several threads; results come in the order of the
//! calls.

use rayon::prelude::*;
use reel_agents::EpisodeReport;
use reel_replay::Fork;
use reel_trace::Trace;
use serde::{Deserialize, Serialize};

use super::{PlausibleCall, plausible_calls};
use crate::branch::{Branch, BranchError, Continuation};

/// The competent agent that goes on after a call.
const COMPETENT: &str = "planner";

/// What an episode came to.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
pub struct PlayedOutcome {
    /// Whether no goal change was left.
    pub success: bool,
    /// Share of the goal changes that hold, from 0 to 1.
    pub completion: f64,
    /// Decisions of the whole episode.
    pub length: u32,
}

/// A plausible call with what came of it.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct PlayedCall {
    /// What was called, where and why; its fields stand beside the outcomes in JSON.
    #[serde(flatten)]
    pub plausible: PlausibleCall,
    /// With the recorded calls after it.
    pub with_recorded: PlayedOutcome,
    /// With policy `planner` after it; `None` where the recorded calls succeed.
    pub with_planner: Option<PlayedOutcome>,
}

impl From<EpisodeReport> for PlayedOutcome {
    fn from(report: EpisodeReport) -> Self {
        Self {
            success: report.success,
            completion: report.completion,
            length: report.length,
        }
    }
}

/// Plays every plausible call of an episode, unrecorded. `on_start` is told how many there are,
/// `on_done` when one of them was played.
///
/// # Errors
/// When the episode cannot be executed, or differs from its record on the way.
pub fn play_all(
    trace: &Trace,
    workers: usize,
    on_start: impl FnOnce(usize),
    on_done: impl Fn() + Sync,
) -> Result<Vec<PlayedCall>, BranchError> {
    let forks = Fork::at_every_call(trace).map_err(|verdict| BranchError::Parent {
        path: trace.path.clone(),
        call: 0,
        verdict: Box::new(verdict),
    })?;
    let calls = plausible_calls(trace);
    on_start(calls.len());
    let one = |plausible: &PlausibleCall| {
        let played = forks
            .get(plausible.step as usize)
            .map(|fork| play(fork, plausible))
            .transpose();
        on_done();
        played
    };
    let all = || calls.par_iter().with_max_len(1).map(one).collect();
    let played: Result<Vec<Option<PlayedCall>>, BranchError> = match rayon::ThreadPoolBuilder::new()
        .num_threads(workers.max(1))
        .build()
    {
        Ok(pool) => pool.install(all),
        Err(_) => calls.iter().map(one).collect(),
    };
    Ok(played?.into_iter().flatten().collect())
}

fn play(fork: &Fork<'_>, plausible: &PlausibleCall) -> Result<PlayedCall, BranchError> {
    let (at, call) = (plausible.step as usize, plausible.call.clone());
    let with_recorded: PlayedOutcome = Branch::replacing(at, call.clone()).play(fork, None)?.into();
    let handed_over = Branch {
        calls: vec![call],
        continuation: Continuation::Policy {
            name: COMPETENT.to_owned(),
            seed: fork.parent().header.seed,
        },
    };
    let with_planner = match with_recorded.success {
        true => None,
        false => Some(handed_over.play(fork, None)?.into()),
    };
    Ok(PlayedCall {
        plausible: plausible.clone(),
        with_recorded,
        with_planner,
    })
}
