//! Which step of a failed episode decided, from what every moment still cost. Never what caused it.
//!
//! A step does harm when more is left to do after it than before, and it is repaid when the loss
//! was made good. What changes the world (`pick`, `place`, `open`, `close`) is measured by the work
//! that is left in truth; what changes only the view, the place of the robot or the time, by the
//! cost for one who knows what the agent knew. Harm to the world comes first: who drives to a wrong
//! table and puts the thing there goes wrong where it is put.

use std::{cmp::Reverse, collections::BTreeMap};

use reel_trace::Trace;
use reel_world::{ErrorCode, Tool, record::StepRecord};
use serde::{Deserialize, Serialize};

use crate::blame::cost::{DecisionPoint, Item};

/// Decisions lost in vain after which an agent that finishes has given up rather
/// than ended too early.
const IN_VAIN: u32 = 4;

/// What kind of harm the decisive step did.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Harm {
    /// It changed the world for the worse.
    World,
    /// It ended the episode although success was still to be had.
    Ending,
    /// With it the agent left the way to success for the last time, until it ended or the decisions
    /// ran out.
    Time,
}

impl Harm {
    /// As it stands in JSON and tables.
    pub fn name(self) -> &'static str {
        match self {
            Harm::World => "world",
            Harm::Ending => "ending",
            Harm::Time => "time",
        }
    }
}

/// The decisive step of an episode that failed, with its harm; none where nothing was lost.
pub(crate) fn decisive(trace: &Trace, moments: &[DecisionPoint]) -> Option<(usize, Harm)> {
    if let Some(step) = world_harm(trace, moments) {
        return Some((step, Harm::World));
    }
    let losses = losses(trace, moments);
    let ended = trace.steps.last().filter(|step| is_finish(step));
    let (way, end) = match ended {
        Some(_) => (&losses[..losses.len() - 1], Some(losses.len() - 1)),
        None => (&losses[..], None),
    };
    let strayed = last_departure(way, moments);
    match (end, strayed) {
        (Some(end), Some((step, lost))) => {
            let in_vain = lost >= IN_VAIN || !moments[end].is_winnable();
            Some(if in_vain {
                (step, Harm::Time)
            } else {
                (end, Harm::Ending)
            })
        }
        (Some(end), None) => Some((end, Harm::Ending)),
        (None, Some((step, _))) => Some((last_behaviour(trace, way, moments, step), Harm::Time)),
        // Every loss was made good; the largest is what the time was spent on.
        (None, None) => {
            let (step, lost) = (0..)
                .zip(way)
                .max_by_key(|(step, lost)| (**lost, Reverse(*step)))?;
            (*lost > 0).then_some((step, Harm::Time))
        }
    }
}

fn is_finish(step: &StepRecord) -> bool {
    Tool::parse(&step.input.call) == Ok(Tool::Finish)
}

/// The first call that changed the world for the worse while success was still to be had, and was
/// never made good.
fn world_harm(trace: &Trace, moments: &[DecisionPoint]) -> Option<usize> {
    (0..trace.steps.len()).find(|step| {
        let record = &trace.steps[*step];
        let changes_world = matches!(
            Tool::parse(&record.input.call),
            Ok(Tool::Pick { .. } | Tool::Place { .. } | Tool::Open { .. } | Tool::Close { .. })
        );
        let before = &moments[*step];
        let harmed = worsened(&before.work, &moments[*step + 1].work);
        changes_world
            && record.outcome.error.is_none()
            && !harmed.is_empty()
            && before.is_winnable()
            && !moments[*step + 2..]
                .iter()
                .any(|later| made_good(&harmed, &before.work, &later.work))
    })
}

/// Decisions that each call lost for one who knew what its agent knew. Whoever does what a
/// competent agent would have done loses nothing, unless a skill of the robot fails.
pub(crate) fn losses(trace: &Trace, moments: &[DecisionPoint]) -> Vec<u32> {
    let lost = |(record, pair): (&StepRecord, &[DecisionPoint])| {
        let advised = pair[0].advice.to_call() == record.input.call;
        if advised && !is_skill_failure(record) {
            return 0;
        }
        match (pair[0].cost, pair[1].cost) {
            (Some(before), Some(after)) => (after + 1).saturating_sub(before),
            (Some(before), None) => before,
            (None, _) => 1,
        }
    };
    trace
        .steps
        .iter()
        .zip(moments.windows(2))
        .map(lost)
        .collect()
}

/// Whether the robot, not the decision, failed in this step.
pub(crate) fn is_skill_failure(step: &StepRecord) -> bool {
    let errors = [
        ErrorCode::SkillFailed,
        ErrorCode::BackendError,
        ErrorCode::PhysicsFault,
    ];
    step.outcome
        .error
        .is_some_and(|error| errors.contains(&error))
}

/// Where the last departure from the way to success began, with the decisions it lost: the start of
/// the stretch to the end in which losses outweigh calls without a loss by most (the change point
/// of a cumulative sum). A loss after which the agent went on well weighs less and less, so it
/// neither hides nor starts a later departure; a call that brought it nearer to success than it
/// ever was weighs twice.
///
/// A departure begins with a call that lost something also for one who knows which receptacles are
/// meant (luck is nobody's fault), and that was never repaid: the agent came no nearer afterwards,
/// as long as success could be had.
fn last_departure(losses: &[u32], moments: &[DecisionPoint]) -> Option<(usize, u32)> {
    let cost = |moment: usize| moments[moment].hindsight.unwrap_or(u32::MAX);
    let nearest_before = |step: usize| (0..=step).map(cost).min().unwrap_or(u32::MAX);
    let repaid = |step: usize| {
        (step + 1..=losses.len())
            .any(|later| cost(later) < cost(step) && moments[later].is_winnable())
    };
    let (mut sum, mut lost) = (0_i64, 0_u32);
    let mut best: Option<(i64, usize, u32)> = None;
    for (step, loss) in losses.iter().enumerate().rev() {
        sum += match loss {
            0 if cost(step + 1) < nearest_before(step) => -2,
            0 => -1,
            loss => i64::from(*loss),
        };
        lost = lost.saturating_add(*loss);
        let begins = *loss > 0 && cost(step + 1).saturating_add(1) > cost(step) && !repaid(step);
        if begins && sum > 0 && sum >= best.map_or(0, |(sum, ..)| sum) {
            best = Some((sum, step, lost));
        }
    }
    best.map(|(_, step, lost)| (step, lost))
}

/// How a call loses decisions.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Behaviour {
    /// What came is no call.
    Invalid,
    /// A skill of the robot failed.
    Skill,
    /// The call was refused.
    Refused,
    /// The same call three times or more in a row.
    Again,
    /// A drive or a look.
    Moves,
}

fn behaviour(trace: &Trace, step: usize) -> Behaviour {
    let record = &trace.steps[step];
    let same = |from: usize| {
        let run = trace.steps.get(from..from + 3);
        run.is_some_and(|run| run.iter().all(|one| one.input.call == record.input.call))
    };
    match record.outcome.error {
        Some(ErrorCode::UnparsableOutput | ErrorCode::UnknownTool | ErrorCode::BadArguments) => {
            Behaviour::Invalid
        }
        Some(_) if is_skill_failure(record) => Behaviour::Skill,
        // These tell of what was left out before: they begin nothing.
        Some(
            ErrorCode::NothingFound
            | ErrorCode::NothingHeld
            | ErrorCode::HandNotFree
            | ErrorCode::DoorClosed,
        ) => Behaviour::Moves,
        Some(_) => Behaviour::Refused,
        _ if (step.saturating_sub(2)..=step).any(same) => Behaviour::Again,
        _ => Behaviour::Moves,
    }
}

/// Where the last behaviour of a departure began, if success could still be had then: what was lost
/// before it could be afforded.
fn last_behaviour(
    trace: &Trace,
    losses: &[u32],
    moments: &[DecisionPoint],
    departed: usize,
) -> usize {
    let lossy: Vec<usize> = (departed..losses.len())
        .filter(|step| losses[*step] > 0)
        .collect();
    let Some(last) = lossy.last().map(|step| behaviour(trace, *step)) else {
        return departed;
    };
    // What the departure began with goes on, or is taken up again.
    if behaviour(trace, departed) == last {
        return departed;
    }
    let run = lossy
        .iter()
        .rev()
        .take_while(|step| behaviour(trace, **step) == last)
        .count();
    let start = lossy[lossy.len() - run];
    let lost: u32 = losses[start..].iter().sum();
    if lost >= IN_VAIN && moments[start].is_winnable() {
        start
    } else {
        departed
    }
}

/// With what more was left to do after it.
fn worsened<'m>(before: &BTreeMap<Item, u32>, after: &'m BTreeMap<Item, u32>) -> Vec<&'m Item> {
    after
        .iter()
        .filter(|(item, left)| before.get(item).is_none_or(|was| was < left))
        .map(|(item, _)| item)
        .collect()
}

/// Whether no more is left to do with these than before. What was taken by mistake may also stay
/// where it is, once more was done for what is wanted than when it was taken.
fn made_good(harmed: &[&Item], before: &BTreeMap<Item, u32>, later: &BTreeMap<Item, u32>) -> bool {
    let left = |work: &BTreeMap<Item, u32>, item: &Item| work.get(item).copied().unwrap_or(0);
    let wanted = before.keys().filter(|item| matches!(item, Item::Wanted(_)));
    let nearer = wanted
        .clone()
        .any(|item| left(later, item) < left(before, item));
    harmed.iter().all(|item| {
        left(later, item) <= left(before, item) || (matches!(item, Item::Taken(_)) && nearer)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moments(costs: &[u32]) -> Vec<DecisionPoint> {
        let moment = |cost: &u32| DecisionPoint {
            cost: Some(*cost),
            hindsight: Some(*cost),
            work: BTreeMap::new(),
            budget: 30,
            advice: Tool::Finish,
            question: Tool::Finish,
            objection: None,
        };
        costs.iter().map(moment).collect()
    }

    #[test]
    fn a_departure_that_was_repaid_begins_nothing() {
        let (losses, costs) = ([1, 1, 1, 1, 1, 0, 0, 4], [10, 10, 10, 10, 10, 10, 9, 8, 11]);
        assert_eq!(last_departure(&losses, &moments(&costs)), Some((7, 4)));
    }

    #[test]
    fn a_departure_begins_with_no_bad_luck() {
        assert_eq!(
            last_departure(&[1, 1, 1], &moments(&[8, 7, 8, 9])),
            Some((1, 2))
        );
    }
}
