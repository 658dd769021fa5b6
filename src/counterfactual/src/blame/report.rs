//! What is to be said of a failed episode: the decisive step in words, what it lost,
//! and which capacity failed.

use reel_agents::plan::Objection;
use reel_trace::Trace;
use reel_world::{Digest, InstanceId, ToolCall, record::StepRecord};
use serde::{Deserialize, Serialize};

use crate::blame::{
    StepCost,
    cost::{self, DecisionPoint},
    decide::{self, Harm},
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
    /// Share of the loss that is due to [`Cause::Other`], from 0 to 1.
    pub other: f64,
}

impl Shares {
    /// What most of it is due to.
    fn largest(&self) -> Cause {
        let causes = [
            (self.other, Cause::Other),
            (self.memory, Cause::Memory),
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
    /// What a competent agent would have called then.
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
    /// Whether it succeeded; none: it was broken off.
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

/// Measures an episode; nothing is executed.
pub fn blame(trace: &Trace) -> Blame {
    let moments = cost::decision_points(trace);
    let costs = cost::step_costs(&moments);
    let success = cost::outcome(trace);
    let decided = if success == Some(false) {
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

fn cause(moment: &DecisionPoint) -> Cause {
    match moment.objection {
        Some(Objection::Perception) => Cause::Perception,
        Some(Objection::Communication) => Cause::Communication,
        Some(Objection::Memory) => Cause::Memory,
        None => Cause::Other,
    }
}

/// Of what was lost from the decisive step on and never came back.
fn shares(trace: &Trace, moments: &[DecisionPoint], decisive: usize) -> Shares {
    let last = moments.len() - 1;
    let cost = |moment: usize| moments[moment].cost;
    let mut shares = Shares::default();
    for (step, moment) in moments.iter().enumerate().take(last).skip(decisive) {
        let Some(before) = moment.cost else { continue };
        let lost = cost(step + 1).map_or(before, |after| (after + 1).saturating_sub(before));
        let repaid = (step + 1..=last).any(|later| cost(later).is_some_and(|cost| cost < before));
        let finishes = trace.steps[step].tool_name() == "finish";
        if step != decisive && (lost == 0 || repaid || finishes) {
            continue;
        }
        let lost = lost.max(1);
        let share = match cause(moment) {
            Cause::Perception => &mut shares.perception,
            Cause::Communication => &mut shares.communication,
            Cause::Memory => &mut shares.memory,
            Cause::Other => &mut shares.other,
        };
        *share += f64::from(lost);
    }
    let Shares {
        perception,
        communication,
        memory,
        other,
    } = shares;
    let all = perception + communication + memory + other;
    if all == 0.0 {
        return shares;
    }
    Shares {
        perception: perception / all,
        communication: communication / all,
        memory: memory / all,
        other: other / all,
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
        cause(&moments[step])
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
        advised_call: moments[step].advice.to_call(),
    }
}

fn explanation(
    trace: &Trace,
    moments: &[DecisionPoint],
    record: &StepRecord,
    harm: Harm,
    cause: Cause,
) -> String {
    let step = record.step as usize;
    let task = &trace.task;
    let named = |id: &InstanceId| {
        let known = task.object(id);
        let caption = known.and_then(|known| known.caption.as_deref());
        let caption =
            caption.map(|caption| format!("the {}", caption.trim_end_matches('.').to_lowercase()));
        caption
            .or_else(|| Some(format!("the {}", known?.category)))
            .unwrap_or_else(|| id.to_string())
    };
    let (target, wanted) = (
        named(&task.target),
        task.goal.receptacle_of(&task.target).unwrap_or(&task.dest),
    );
    let (tool, object, receptacle) = (
        record.tool_name(),
        record.object.as_ref(),
        record.receptacle.as_ref(),
    );
    match (harm, tool, object, receptacle) {
        (Harm::World, "pick", Some(object), _) if *object == task.target => {
            format!(
                "it took what was meant, {target}, at a moment at which it could only put it down again"
            )
        }
        (Harm::World, "pick", Some(object), _) => {
            let reason = match cause {
                Cause::Perception => ", which looks different or stands elsewhere",
                Cause::Communication => ", and asked nobody although several things fitted",
                Cause::Memory | Cause::Other => "",
            };
            format!("it took {}; meant was {target}{reason}", named(object))
        }
        (Harm::World, "place", Some(object), Some(receptacle)) if *object == task.target => {
            format!("it put {target} on {receptacle}; it belongs on {wanted}")
        }
        (Harm::World, "place", Some(object), Some(receptacle)) => {
            format!(
                "it left {} on {receptacle}, where it does not belong",
                named(object)
            )
        }
        (Harm::World, _, _, Some(receptacle)) => {
            format!("after it more was left to do: {tool} at {receptacle}")
        }
        (Harm::World, ..) => format!("after it more was left to do: {tool}"),
        (Harm::Ending, ..) => {
            let moment = &moments[step];
            let (needed, left) = (moment.cost.unwrap_or_default(), moment.budget);
            format!(
                "it ended the episode with {left} decisions left, of which {needed} were enough to succeed for sure"
            )
        }
        (Harm::Time, ..) => {
            let (after, due) = (trace.steps.len() - step, moments[step].advice.to_call());
            format!(
                "it left the way to success, on which {due} was next: in the {after} calls from here on it never came nearer"
            )
        }
    }
}
