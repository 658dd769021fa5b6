//! One episode with each capability perfect: where the agent failed by it, and what came of the
//! branch in which it does not. Many episodes at a time.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use rayon::prelude::*;
use reel_agents::{
    AgentError, EpisodeReport, GoalHint, Planner, Policy, RecordTo, RunningEpisode, retrace,
};
use reel_replay::{Fork, verify_branch, verify_trace, with_perfect_skills};
use reel_sim::render::Detail;
use reel_trace::{Images, RecordOptions, Trace, TraceFiles};
use reel_world::{
    Digest, ErrorCode, Family, ToolCall,
    record::{EndReason, PolicyInfo},
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::{
    Capability,
    agent::{CuredAgent, failure},
};
use crate::branch::{BranchError, POLICY_NAME, fork};

/// An episode with what each capability cost it.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Attributed {
    /// Path of the trace.
    pub trace: PathBuf,
    /// Id of the episode, from the trace's header.
    pub episode_id: String,
    /// Chain digest of the trace.
    pub trace_digest: Digest,
    /// Id of the task, by which episodes are clustered.
    pub task_id: String,
    /// Run that the episode belongs to.
    pub run_id: String,
    /// Name of the policy that decided.
    pub policy: String,
    /// Family of the task.
    pub family: Family,
    /// Whether the episode succeeded; `None` if it was broken off.
    pub success: Option<bool>,
    /// One entry a capability for a failed episode, in the order of [`Capability::ALL`].
    pub capabilities: Vec<CapabilityBranch>,
}

/// What came of an episode with one capability perfect.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct CapabilityBranch {
    /// The capability that was made perfect.
    pub capability: Capability,
    /// Recorded calls that failed by it.
    pub failures: u32,
    /// The first of them; `None` if there is none.
    pub first_step: Option<u32>,
    /// Whether a branch was played; without a failure none has to be.
    pub played: bool,
    /// Whether the branch succeeded.
    pub success: bool,
    /// Recorded calls that the competent agent's calls took the place of.
    pub replaced: u32,
    /// Recorded calls without a counterpart in the branch, left out.
    pub skipped: u32,
    /// Decisions of the branch; `None` if none was played.
    pub length: Option<u32>,
    /// The branch, where it was kept.
    pub branch: Option<PathBuf>,
    /// Whether the kept branch was replayed and is exact.
    pub verified: bool,
    /// Why no branch could be played.
    pub reason: Option<String>,
}

impl Attributed {
    /// Whether the episode succeeds with this capability perfect; `None` if it was broken off.
    pub fn success_with(&self, capability: Capability) -> Option<bool> {
        let rescued = |one: &&CapabilityBranch| one.capability == capability && one.success;
        Some(self.success? || self.capabilities.iter().find(rescued).is_some())
    }
}

/// How episodes are attributed.
#[derive(Clone, Debug, Default)]
pub struct AttributionOptions {
    /// The folder for branches that succeed, which are replayed; `None`: they are played and not
    /// kept.
    pub branches: Option<PathBuf>,
}

/// Plays an episode with each capability perfect. A successful one, and one that was broken off,
/// has nothing to play.
pub fn attribute(trace: &Trace, options: &AttributionOptions) -> Attributed {
    let header = &trace.header;
    let end = trace.end.as_ref();
    let success = end
        .filter(|end| end.metrics.success || end.reason != EndReason::Aborted)
        .map(|end| end.metrics.success);
    let capabilities = match success {
        Some(false) => {
            let failures = failures(trace);
            let one = |capability| cured(trace, capability, &failures, options);
            Capability::ALL.into_iter().map(one).collect()
        }
        _ => Vec::new(),
    };
    Attributed {
        trace: trace.path.clone(),
        episode_id: header.episode_id.clone(),
        trace_digest: trace.chain(),
        task_id: header.task_id.clone(),
        run_id: header.run_id.clone(),
        policy: header.policy.name.clone(),
        family: header.family,
        success,
        capabilities,
    }
}

/// Attributes traces, in the order of their paths. A trace that fails to load, or whose
/// task has no goal, is an error in words.
pub fn attribute_all(
    files: &TraceFiles,
    paths: &[PathBuf],
    workers: usize,
    options: &AttributionOptions,
    on_done: impl Fn() + Sync,
) -> Vec<Result<Attributed, String>> {
    let one = |path: &PathBuf| {
        let attributed = files
            .read(path)
            .map_err(|error| error.to_string())
            .and_then(|trace| match trace.task.has_goal() {
                true => Ok(attribute(&trace, options)),
                false => Err(format!(
                    "{}: its task has no goal: nothing can be played out against it",
                    path.display()
                )),
            });
        on_done();
        attributed
    };
    match rayon::ThreadPoolBuilder::new()
        .num_threads(workers.max(1))
        .build()
    {
        Ok(pool) => pool.install(|| paths.par_iter().with_max_len(1).map(one).collect()),
        Err(_) => paths.iter().map(one).collect(),
    }
}

/// The steps at which the agent failed, by capability.
fn failures(trace: &Trace) -> BTreeMap<Capability, Vec<u32>> {
    let mut planner = Planner::new(GoalHint::of_task(&trace.task), 0);
    let mut found: BTreeMap<Capability, Vec<u32>> = BTreeMap::new();
    let mut failed: Option<ToolCall> = None;
    let mut old_markers = BTreeSet::new();
    retrace(
        &trace.task,
        &trace.scene,
        &trace.start,
        &trace.steps,
        |context, step| {
            old_markers.extend(context.perceived.iter().filter_map(|seen| seen.marker));
            let Some(step) = step else { return };
            let call = &step.input.call;
            let again = failed.as_ref() == Some(call);
            if let Some(capability) = failure(&mut planner, context, call, again, &old_markers) {
                found.entry(capability).or_default().push(step.step);
            }
            if step.outcome.error == Some(ErrorCode::SkillFailed) {
                found
                    .entry(Capability::Primitives)
                    .or_default()
                    .push(step.step);
            }
            failed = step.outcome.error.map(|_| call.clone());
            planner.observe(context, &step.input);
        },
    );
    found
}

fn cured(
    trace: &Trace,
    capability: Capability,
    failures: &BTreeMap<Capability, Vec<u32>>,
    options: &AttributionOptions,
) -> CapabilityBranch {
    let steps = failures.get(&capability).map_or(&[][..], Vec::as_slice);
    let mut found = CapabilityBranch {
        capability,
        failures: steps.len() as u32,
        first_step: steps.first().copied(),
        played: false,
        success: false,
        replaced: 0,
        skipped: 0,
        length: None,
        branch: None,
        verified: false,
        reason: None,
    };
    // Noise of the motion leaves no error code: imperfect skills are reason enough to play.
    let noisy = capability == Capability::Primitives && !trace.header.skills.are_perfect();
    if steps.is_empty() && !noisy {
        return found;
    }
    let from = if capability == Capability::Primitives {
        0
    } else {
        steps[0] as usize
    };
    let mut agent = CuredAgent::new(trace, capability, from);
    match play(trace, &mut agent, capability, from, None) {
        Ok(report) => {
            found.played = true;
            found.success = report.success;
            found.length = Some(report.length);
            (found.replaced, found.skipped) = (agent.replaced, agent.skipped);
        }
        Err(error) => found.reason = Some(error.to_string()),
    }
    if let Some(folder) = options.branches.as_ref().filter(|_| found.success) {
        let path = folder.join(branch_name(&trace.path, capability));
        match kept(trace, capability, from, &path) {
            Ok(verified) => {
                found.verified = verified;
                found.branch = Some(path);
            }
            Err(error) => found.reason = Some(error.to_string()),
        }
    }
    found
}

fn play(
    trace: &Trace,
    agent: &mut CuredAgent<'_>,
    capability: Capability,
    from: usize,
    record: Option<&RecordTo>,
) -> Result<EpisodeReport, BranchError> {
    let refused = |verdict| BranchError::Parent {
        path: trace.path.clone(),
        call: from,
        verdict: Box::new(verdict),
    };
    let mut running = if capability == Capability::Primitives {
        agent.diverge();
        let config = with_perfect_skills(trace, info(trace, capability)).map_err(refused)?;
        RunningEpisode::start(config, record)?
    } else {
        let fork: Fork<'_> = fork(trace, from, None)?;
        let detail = if record.is_some() {
            Detail::Full
        } else {
            Detail::Geometry
        };
        let episode = fork
            .open(info(trace, capability), detail)
            .map_err(refused)?;
        RunningEpisode::resume(episode, record, |_| None, Some(&mut *agent))?
    };
    match running.play(agent) {
        // The recorded calls ended before the episode did: it stays where it is.
        Ok(()) | Err(AgentError::NoAnswer { .. }) => {}
        Err(error) => return Err(error.into()),
    }
    Ok(running.end(agent.gave_up())?)
}

fn kept(
    trace: &Trace,
    capability: Capability,
    from: usize,
    path: &Path,
) -> Result<bool, BranchError> {
    let record = RecordTo {
        path: path.to_owned(),
        options: RecordOptions::from(Images::None),
    };
    let mut agent = CuredAgent::new(trace, capability, from);
    play(trace, &mut agent, capability, from, Some(&record))?;
    let made = Trace::read(path).map_err(|error| BranchError::Unreadable {
        path: path.to_owned(),
        error: error.to_string(),
    })?;
    let made = made.with_meshes(&*trace.meshes);
    Ok(match capability {
        Capability::Primitives => verify_trace(&made).is_exact(),
        _ => verify_branch(&made, trace).holds(),
    })
}

/// Who decides in a branch, for its header.
pub(super) fn info(trace: &Trace, capability: Capability) -> PolicyInfo {
    let parameters: BTreeMap<String, Value> = [
        ("of".to_owned(), json!(trace.header.policy.name)),
        ("perfect".to_owned(), json!(capability.name())),
    ]
    .into();
    PolicyInfo {
        name: POLICY_NAME.into(),
        checkpoint: None,
        parameters,
    }
}

fn branch_name(trace: &Path, capability: Capability) -> String {
    let stem = reel_trace::trace_stem(trace);
    format!("{stem}--perfect-{}.mcap", capability.name())
}
