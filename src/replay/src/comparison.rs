//! Two episodes of one task side by side, from the first difference on: what was called, what came
//! of it, what it changed and what it was worth. Reads records only; never executes anything, never
//! says which was better.

use std::path::PathBuf;

use reel_trace::Trace;
use reel_world::{
    Digest, ErrorCode, GraphEvent, WorldGraph,
    record::{Parent, StepRecord},
};
use serde::Serialize;
use similar::{Algorithm, DiffOp, capture_diff_slices};

use crate::EndSummary;

/// Two episodes laid side by side.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Comparison {
    /// What each of them is.
    pub episodes: [EpisodeSummary; 2],
    /// Inputs known before the first call that differ, besides the policy.
    pub inputs: Vec<&'static str>,
    /// Whether the state before the first call is the same.
    pub same_start: bool,
    /// So many first calls are the same, and all that came of them.
    pub same_calls: usize,
    /// The calls after these, in order. A row has one call of each where they are made alike or
    /// come at the same place; one side is empty where the other has a call more.
    pub rows: Vec<CallPair>,
    /// How each ended; none where the recording broke off.
    pub ends: [Option<EndSummary>; 2],
    /// Sum of all rewards of each.
    pub reward: [f64; 2],
    /// What would have to happen to the first one's final world graph to give the second's.
    pub graph: Vec<GraphEvent>,
}

/// What an episode is, in a few words.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct EpisodeSummary {
    /// Path of the trace file of this episode.
    pub trace: PathBuf,
    /// Id of the episode, from the trace header.
    pub episode_id: String,
    /// Id of the task that the episode plays.
    pub task_id: String,
    /// Name of the policy that chose the calls.
    pub policy: String,
    /// Seed of the episode, from the trace header.
    pub seed: u64,
    /// Chain digest of the trace.
    pub chain: Digest,
    /// What it branches from, if it is a branch.
    pub parent: Option<Parent>,
}

/// A call of each.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct CallPair {
    /// Call of the first episode; `None` if only the second has a call here.
    pub a: Option<CallSummary>,
    /// Call of the second episode; `None` if only the first has a call here.
    pub b: Option<CallSummary>,
    /// Whether both made the same call; what came of it may differ.
    pub same_call: bool,
    /// Whether all that came of it is the same, the simulator's state included.
    pub same_outcome: bool,
}

/// A call and what came of it.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct CallSummary {
    /// Index of the call in its episode, from 0.
    pub call: u32,
    /// As made, for people.
    pub call_text: String,
    /// Code of the error, if it failed.
    pub error: Option<ErrorCode>,
    /// What the agent was told.
    pub text: String,
    /// Changes of the physical world graph.
    pub changes: Vec<GraphEvent>,
    /// What was held after it.
    pub held: Option<reel_world::InstanceId>,
    /// Reward of this call.
    pub reward: f64,
    /// Sum of the rewards up to this call.
    pub total: f64,
}

/// The episodes play other tasks: nothing can be laid side by side.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("{a} plays task {a_task}, {b} plays {b_task}: episodes of different tasks have nothing to lay side by side", a = a.display(), b = b.display())]
pub struct TaskMismatch {
    /// Path of the first of the two traces.
    pub a: PathBuf,
    /// Task id of the first trace, with its digest if both ids are equal.
    pub a_task: String,
    /// Path of the second of the two traces.
    pub b: PathBuf,
    /// Task id of the second trace, with its digest if both ids are equal.
    pub b_task: String,
}

impl Comparison {
    /// Whether nothing differs but who decided.
    pub fn is_same(&self) -> bool {
        self.inputs.is_empty()
            && self.same_start
            && self.rows.is_empty()
            && self.ends[0] == self.ends[1]
    }
}

/// Lays two episodes of one task side by side.
///
/// # Errors
/// When they play different tasks.
pub fn compare(a: &Trace, b: &Trace) -> Result<Comparison, TaskMismatch> {
    if a.header.task_digest != b.header.task_digest {
        let task = |trace: &Trace| match a.header.task_id == b.header.task_id {
            true => format!("{} ({})", trace.header.task_id, trace.header.task_digest),
            false => trace.header.task_id.clone(),
        };
        return Err(TaskMismatch {
            a: a.path.clone(),
            a_task: task(a),
            b: b.path.clone(),
            b_task: task(b),
        });
    }
    let same_start =
        a.start.digests.state == b.start.digests.state && a.start.graphs == b.start.graphs;
    let same_calls = match same_start {
        true => a
            .steps
            .iter()
            .zip(&b.steps)
            .take_while(|(a, b)| a.input.call == b.input.call && same_outcome(a, b))
            .count(),
        false => 0,
    };
    Ok(Comparison {
        episodes: [title(a), title(b)],
        inputs: inputs(a, b),
        same_start,
        same_calls,
        rows: rows(a, b, same_calls),
        ends: [a, b].map(|trace| {
            let end = trace.end.as_ref();
            end.map(|end| EndSummary::of(end, &trace.task))
        }),
        reward: [a, b].map(|trace| trace.steps.iter().map(StepRecord::reward_total).sum()),
        graph: final_graph(b).difference(&final_graph(a)),
    })
}

fn title(trace: &Trace) -> EpisodeSummary {
    let header = &trace.header;
    EpisodeSummary {
        trace: trace.path.clone(),
        episode_id: header.episode_id.clone(),
        task_id: header.task_id.clone(),
        policy: header.policy.name.clone(),
        seed: header.seed,
        chain: trace.chain(),
        parent: header.parent.clone(),
    }
}

fn inputs(a: &Trace, b: &Trace) -> Vec<&'static str> {
    let (a, b) = (&a.header, &b.header);
    let differ = [
        ("scene", a.scene_digest != b.scene_digest),
        ("seed", a.seed != b.seed),
        ("simulator", a.sim_version != b.sim_version),
        ("profile", a.profile != b.profile),
        ("reward preset", a.reward_preset != b.reward_preset),
        ("backend", a.backend != b.backend),
    ];
    differ
        .into_iter()
        .filter(|(_, differs)| *differs)
        .map(|(name, _)| name)
        .collect()
}

/// Everything that came of a call, but the links, which cover the words and the headers too.
fn same_outcome(a: &StepRecord, b: &StepRecord) -> bool {
    a.outcome == b.outcome
        && a.reply == b.reply
        && a.changes == b.changes
        && a.reward == b.reward
        && (a.digests.state, a.digests.frame) == (b.digests.state, b.digests.frame)
}

/// The calls after the common ones: those made alike in one row, so that a call more does not
/// shift all that follows.
fn rows(a: &Trace, b: &Trace, same: usize) -> Vec<CallPair> {
    let deeds = [deeds(a), deeds(b)];
    let calls = |trace: &Trace| -> Vec<String> {
        trace.steps[same..]
            .iter()
            .map(|step| step.input.call.to_string())
            .collect()
    };
    let mut rows = Vec::new();
    let mut row = |a_call: Option<usize>, b_call: Option<usize>| {
        let pair = a_call
            .zip(b_call)
            .map(|(a_call, b_call)| (&a.steps[same + a_call], &b.steps[same + b_call]));
        rows.push(CallPair {
            a: a_call.map(|call| deeds[0][same + call].clone()),
            b: b_call.map(|call| deeds[1][same + call].clone()),
            same_call: pair.is_some_and(|(a, b)| a.input.call == b.input.call),
            same_outcome: pair.is_some_and(|(a, b)| same_outcome(a, b)),
        });
    };
    for op in capture_diff_slices(Algorithm::Myers, &calls(a), &calls(b)) {
        let (old, new) = (op.old_range(), op.new_range());
        match op {
            DiffOp::Equal { .. } | DiffOp::Replace { .. } => {
                for index in 0..old.len().max(new.len()) {
                    row(old.clone().nth(index), new.clone().nth(index));
                }
            }
            DiffOp::Delete { .. } => old.for_each(|call| row(Some(call), None)),
            DiffOp::Insert { .. } => new.for_each(|call| row(None, Some(call))),
        }
    }
    rows
}

fn deeds(trace: &Trace) -> Vec<CallSummary> {
    let mut total = 0.0;
    let deed = |step: &StepRecord| {
        let reward = step.reward_total();
        total += reward;
        CallSummary {
            call: step.step,
            call_text: step.input.call.to_string(),
            error: step.outcome.error,
            text: step.outcome.text.clone(),
            changes: step.changes.physics.clone(),
            held: step.held.clone(),
            reward,
            total,
        }
    };
    trace.steps.iter().map(deed).collect()
}

/// Where physics says the objects were in the end.
fn final_graph(trace: &Trace) -> WorldGraph {
    let mut graph = trace.start.graphs.physics.clone();
    trace
        .steps
        .iter()
        .for_each(|step| graph.apply(&step.changes.physics));
    graph
}
