//! What a policy would notice of another simulator: a trace's inputs executed to the end
//! although things differ, and the outcomes that are not as recorded. Never a verdict on
//! bits; that is [`verify`](crate::verify)'s.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
};

use reel_episode::Episode;
use reel_sim::{render::Detail, sim_version};
use reel_trace::{Trace, TraceFiles};
use reel_world::{
    Assets, Outcome, Task,
    record::{EndReason, EndRecord, EpisodeHeader, StartRecord, StateDigests, StepRecord},
};
use serde::{Deserialize, Serialize};

use crate::{Verdict, file_verdict::verify_from, on_workers, player};

/// What differs between an episode as recorded and as this simulator plays it from the same inputs.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct Changes {
    /// The simulator in the trace.
    pub recorded_sim_version: u32,
    /// Version of this simulator for the trace's profile.
    pub sim_version: u32,
    /// Number of calls in the trace that are executed again.
    pub calls: u32,
    /// Calls whose outcome differs, in their order.
    pub outcomes: Vec<ChangedOutcome>,
    /// How it ended, if that differs.
    pub end: Option<ChangedEnd>,
    /// Whether a digest of the simulator's state differs anywhere.
    pub state_differs: bool,
    /// Whether a digest of an image differs anywhere.
    #[serde(alias = "pictures_differ")]
    pub images_differ: bool,
}

/// A call that comes to something else.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct ChangedOutcome {
    /// Index of the call in the episode, from 0.
    pub call: u32,
    /// The call, for people.
    #[serde(alias = "what")]
    pub call_text: String,
    /// Outcome of the call as the trace records it.
    pub recorded: Outcome,
    /// Outcome of the call when executed again by this simulator.
    pub replayed: Outcome,
}

/// An episode that ends otherwise.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
pub struct ChangedEnd {
    /// How the episode ended according to the trace.
    pub recorded: EndSummary,
    /// How the episode ends when executed again by this simulator.
    pub replayed: EndSummary,
}

/// How an episode ended, in a few figures.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
pub struct EndSummary {
    /// Why the episode ended, e.g. by `finish` or at the horizon.
    pub reason: EndReason,
    /// SR: no goal change is left; what was told where the task has no goal.
    pub success: Option<bool>,
    /// CR: share of the goal changes that hold; `None` where the task has no goal.
    pub completion: Option<f64>,
    /// Cumulative reward of the episode, undiscounted; `None` where the task has no goal.
    pub total_reward: Option<f64>,
    /// Number of calls that the episode made.
    pub steps: u32,
}

/// A trace file's verdict, and what changed where it is not exact.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct ReplayReport {
    /// Path of the trace file that was replayed.
    pub trace: PathBuf,
    /// What a replay found.
    #[serde(flatten)]
    pub verdict: Verdict,
    /// What changed; none where nothing can be executed.
    pub outcomes: Option<Changes>,
}

impl Changes {
    /// Whether nothing of it would be noticed by a policy, or counted afterwards.
    pub fn no_outcome(&self) -> bool {
        self.outcomes.is_empty() && self.end.is_none()
    }

    fn none(trace: &Trace) -> Self {
        Self {
            recorded_sim_version: trace.header.sim_version,
            sim_version: sim_version(trace.header.profile),
            calls: count(trace.steps.len()),
            ..Self::default()
        }
    }
}

/// Executes all inputs of a trace, of any version of the simulator, and lists what changed.
///
/// # Errors
/// Why nothing can be executed.
pub fn changes(trace: &Trace) -> Result<Changes, Verdict> {
    Ok(Reexecution::run(trace)?.compare(trace))
}

/// Replays many trace files on so many threads, and says what changed in those that are not exact;
/// in the order of the paths.
pub fn replay_outcomes_all<P: AsRef<Path> + Sync>(
    files: &TraceFiles,
    paths: &[P],
    assets: &dyn Assets,
    workers: usize,
    on_done: impl Fn(&Path, &Verdict) + Sync,
) -> Vec<ReplayReport> {
    on_workers(paths, workers, |path| {
        let path = path.as_ref();
        let judgement = catch_unwind(AssertUnwindSafe(|| judge(files, path, assets)))
            .unwrap_or_else(|_| ReplayReport {
                trace: path.to_owned(),
                verdict: Verdict::panicked(path),
                outcomes: None,
            });
        on_done(path, &judgement.verdict);
        judgement
    })
}

fn judge(files: &TraceFiles, path: &Path, assets: &dyn Assets) -> ReplayReport {
    let verdict = verify_from(files, path, assets).verdict;
    let outcomes = files.read(path).ok().and_then(|trace| match verdict {
        // Nothing changed, and nothing need be executed a second time to say so.
        Verdict::Exact { .. } => Some(Changes::none(&trace)),
        _ => changes(&trace.with_meshes(assets)).ok(),
    });
    ReplayReport {
        trace: path.to_owned(),
        verdict,
        outcomes,
    }
}

/// An episode executed again from its inputs, whatever was recorded of its outputs.
pub(crate) struct Reexecution {
    pub header: EpisodeHeader,
    pub start: StartRecord,
    pub steps: Vec<StepRecord>,
    pub end: EndRecord,
}

impl Reexecution {
    /// Executes all inputs of a trace of any version.
    pub fn run(trace: &Trace) -> Result<Self, Verdict> {
        let config = player::config_of_any_version(trace)?;
        let (mut episode, start, _) =
            Episode::start_with(config, Detail::Full).map_err(|error| Verdict::NotReplayable {
                reason: error.to_string(),
            })?;
        let steps = trace
            .steps
            .iter()
            .map(|step| episode.step(step.input.clone()).record)
            .collect();
        Ok(Self {
            header: episode.header().clone(),
            start,
            steps,
            end: episode.end(),
        })
    }

    /// What is not as recorded.
    pub fn compare(&self, trace: &Trace) -> Changes {
        let mut changes = Changes::none(trace);
        changes.compare_digests(&trace.start.digests, &self.start.digests);
        for (old, new) in trace.steps.iter().zip(&self.steps) {
            changes.compare_digests(&old.digests, &new.digests);
            if old.outcome != new.outcome {
                let (recorded, replayed) = (old.outcome.clone(), new.outcome.clone());
                changes.outcomes.push(ChangedOutcome {
                    call: old.step,
                    call_text: old.input.call.to_string(),
                    recorded,
                    replayed,
                });
            }
        }
        changes.end = trace.end.as_ref().and_then(|end| {
            let (recorded, replayed) = (
                EndSummary::of(end, &trace.task),
                EndSummary::of(&self.end, &trace.task),
            );
            (recorded != replayed).then_some(ChangedEnd { recorded, replayed })
        });
        changes
    }
}

impl Changes {
    fn compare_digests(&mut self, old: &StateDigests, new: &StateDigests) {
        self.state_differs |= old.state != new.state || old.physics_steps != new.physics_steps;
        self.images_differ |= old.frame != new.frame;
    }
}

impl EndSummary {
    /// The figures of an end of an episode with this task.
    pub fn of(end: &EndRecord, task: &Task) -> Self {
        let metrics = Some(&end.metrics).filter(|_| task.has_goal());
        Self {
            reason: end.reason,
            success: end.success(task),
            completion: metrics.map(|metrics| metrics.completion),
            total_reward: metrics.map(|metrics| metrics.total_reward),
            steps: end.steps,
        }
    }
}

impl std::fmt::Display for EndSummary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let success = match self.success {
            Some(true) => "success",
            Some(false) => "no success",
            None => "not judged",
        };
        let steps = self.steps;
        let reason = format!("{:?}", self.reason).to_lowercase();
        write!(f, "{reason} after {steps} calls, {success}")?;
        if let Some(completion) = self.completion {
            write!(f, ", completion {completion:.2}")?;
        }
        if let Some(total_reward) = self.total_reward {
            write!(f, ", total reward {total_reward:.3}")?;
        }
        Ok(())
    }
}

impl std::fmt::Display for Changes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut parts = Vec::new();
        if self.recorded_sim_version != self.sim_version {
            parts.push(format!(
                "recorded by simulator {}",
                self.recorded_sim_version
            ));
        }
        if !self.outcomes.is_empty() {
            let calls: Vec<String> = self
                .outcomes
                .iter()
                .map(|outcome| outcome.call.to_string())
                .collect();
            parts.push(format!("other outcomes at calls {}", calls.join(", ")));
        }
        if let Some(end) = &self.end {
            parts.push(format!(
                "ended: {}; ends now: {}",
                end.recorded, end.replayed
            ));
        }
        match (self.state_differs, self.images_differ) {
            (true, true) => parts.push("other motion and images".to_owned()),
            (true, false) => parts.push("other motion".to_owned()),
            (false, true) => parts.push("other images".to_owned()),
            (false, false) if self.no_outcome() => parts.push("the same episode".to_owned()),
            (false, false) => {}
        }
        f.write_str(&parts.join("; "))
    }
}

fn count(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}
