//! What is to be said of a failed episode: the decisive step in words, what it lost,
//! and which capacity failed.

use reel_agents::plan::Objection;
use reel_trace::Trace;
use reel_world::{Digest, ToolCall, record::StepRecord};
use serde::{Deserialize, Serialize};

use crate::blame::{
    StepCost,
    cost::{self, CompetentAgent, DecisionPoint},
    decide::{self, Harm},
    explanation::explanation,
};

/// The capacity of an agent to which a failure is attributed.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// It took or used the wrong candidate although its look told it apart.
    Perception,
    /// It asked nobody although several things fitted.
    Communication,
    /// It went against what it had seen.
    Memory,
    /// A skill of the robot failed, or what executes its calls.
    Primitive,
    /// None of these: it left out what was due, or put out what was no call.
    Other,
}

impl Cause {
    /// As it stands in JSON and tables.
    pub fn name(self) -> &'static str {
        match self {
            Cause::Perception => "perception",
            Cause::Communication => "communication",
            Cause::Memory => "memory",
            Cause::Primitive => "primitive",
            Cause::Other => "other",
        }
    }
}

/// How much of what was lost for good is due to each capacity, from 0 to 1; all 0
/// where nothing was lost.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct Shares {
    /// Share of the loss that is due to [`Cause::Perception`], from 0 to 1.
    pub perception: f64,
    /// Share of the loss that is due to [`Cause::Communication`], from 0 to 1.
    pub communication: f64,
    /// Share of the loss that is due to [`Cause::Memory`], from 0 to 1.
    pub memory: f64,
    /// Share of the loss that is due to [`Cause::Primitive`], from 0 to 1.
    pub primitive: f64,
    /// Share of the loss that is due to [`Cause::Other`], from 0 to 1.
    pub other: f64,
}

impl Shares {
    /// What most of it is due to.
    fn largest(&self) -> Cause {
        let causes = [
            (self.other, Cause::Other),
            (self.memory, Cause::Memory),
            (self.primitive, Cause::Primitive),
            (self.communication, Cause::Communication),
            (self.perception, Cause::Perception),
        ];
        causes
            .into_iter()
            .max_by(|(one, _), (other, _)| one.total_cmp(other))
            .map_or(Cause::Other, |(_, cause)| cause)
    }
}

/// The step that decided.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Decisive {
    /// Index of the decisive step in the episode, from 0.
    pub step: u32,
    /// The tool's name in the paper, or the name as called.
    pub tool: String,
    /// The call that the agent made at that step.
    pub call: ToolCall,
    /// What it got for it, in one line.
    pub outcome: String,
    /// What kind of harm it did.
    pub harm: Harm,
    /// The capacity that failed; for [`Harm::Time`] the one with the largest share.
    pub cause: Cause,
    /// Why it did harm, in a sentence.
    pub explanation: String,
    /// What a competent agent would have called then; the question to the user where the cause is
    /// [`Cause::Communication`].
    pub advised_call: ToolCall,
}

/// What a measured episode shows.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Blame {
    /// Id of the measured episode, from the trace's header.
    pub episode_id: String,
    /// Chain digest of the trace.
    pub trace_digest: Digest,
    /// Id of the episode's task, from the trace's header.
    pub task_id: String,
    /// Whether it succeeded; none where nobody knows, or where it was broken off.
    pub success: Option<bool>,
    /// The step that decided; none where it succeeded or nothing was lost.
    pub decisive: Option<Decisive>,
    /// Decisions lost in all.
    pub wasted_steps: u32,
    /// The step after which success could no longer be had for sure; luck may
    /// still have brought it.
    pub point_of_no_return: Option<u32>,
    /// Whether it still was to be had for sure before the last step.
    pub repairable_at_end: bool,
    /// What the failure is due to.
    pub shares: Shares,
    /// What every step cost.
    pub costs: Vec<StepCost>,
}

/// Measures an episode against the policy `planner`; nothing is executed.
pub fn blame(trace: &Trace) -> Blame {
    blame_against(trace, CompetentAgent::default())
}

/// Measures an episode against a competent agent; nothing is executed. Where the task has no goal
/// there are no costs and no decisive step.
pub fn blame_against(trace: &Trace, agent: CompetentAgent) -> Blame {
    let moments = if trace.task.has_goal() {
        cost::decision_points(trace, agent)
    } else {
        Vec::new()
    };
    let costs = cost::step_costs(&moments);
    let success = cost::outcome(trace);
    let decided = if success == Some(false) && !moments.is_empty() {
        decide::decisive(trace, &moments)
    } else {
        None
    };
    let shares = decided
        .map(|(step, _)| shares(trace, &moments, step))
        .unwrap_or_default();
    let lost =
        |pair: &[DecisionPoint]| pair[0].affordable().is_some() && pair[1].affordable().is_none();
    Blame {
        episode_id: trace.header.episode_id.clone(),
        trace_digest: trace.chain(),
        task_id: trace.header.task_id.clone(),
        success,
        wasted_steps: costs.iter().filter_map(|cost| cost.regret).sum(),
        point_of_no_return: moments
            .windows(2)
            .rposition(lost)
            .filter(|_| success != Some(true))
            .map(|step| step as u32),
        repairable_at_end: moments.len() > 1 && moments[moments.len() - 2].affordable().is_some(),
        decisive: decided.map(|(step, harm)| tell(trace, &moments, &shares, step, harm)),
        shares,
        costs,
    }
}

fn cause(record: &StepRecord, moment: &DecisionPoint) -> Cause {
    if decide::is_skill_failure(record) {
        return Cause::Primitive;
    }
    match moment.objection {
        Some(Objection::Perception) => Cause::Perception,
        Some(Objection::Communication) => Cause::Communication,
        Some(Objection::Memory) => Cause::Memory,
        None => Cause::Other,
    }
}

/// What the losses from the decisive step on are due to. The last `finish` counts only where it
/// decided.
fn shares(trace: &Trace, moments: &[DecisionPoint], decisive: usize) -> Shares {
    let losses = decide::losses(trace, moments);
    let mut sums = Shares::default();
    let mut all = 0.0;
    for (step, lost) in losses.into_iter().enumerate().skip(decisive) {
        let record = &trace.steps[step];
        let lost = match step == decisive {
            true => lost.max(1),
            false if record.tool_name() == "finish" => 0,
            false => lost,
        };
        let sum = match cause(record, &moments[step]) {
            Cause::Perception => &mut sums.perception,
            Cause::Communication => &mut sums.communication,
            Cause::Memory => &mut sums.memory,
            Cause::Primitive => &mut sums.primitive,
            Cause::Other => &mut sums.other,
        };
        *sum += f64::from(lost);
        all += f64::from(lost);
    }
    Shares {
        perception: sums.perception / all,
        communication: sums.communication / all,
        memory: sums.memory / all,
        primitive: sums.primitive / all,
        other: sums.other / all,
    }
}

fn tell(
    trace: &Trace,
    moments: &[DecisionPoint],
    shares: &Shares,
    step: usize,
    harm: Harm,
) -> Decisive {
    let record = &trace.steps[step];
    let cause = if harm == Harm::Time {
        shares.largest()
    } else {
        cause(record, &moments[step])
    };
    let advice = match cause {
        Cause::Communication => &moments[step].question,
        _ => &moments[step].advice,
    };
    Decisive {
        step: record.step,
        tool: record.tool_name().to_owned(),
        call: record.input.call.clone(),
        outcome: record
            .outcome
            .text
            .lines()
            .next()
            .unwrap_or_default()
            .to_owned(),
        harm,
        cause,
        explanation: explanation(trace, moments, record, harm, cause),
        advised_call: advice.to_call(),
    }
}
