//! Which step of a failed episode decided, from what every moment still cost. Never what caused it.
//!
//! A step does harm when more is left to do after it than before, and it is repaid when the loss
//! was made good. What changes the world (`pick`, `place`, `open`, `close`) is measured by the work
//! that is left in truth; what changes only the view, the place of the robot or the time, by the
//! cost for one who knows what the agent knew. Harm to the world comes first: who drives to a wrong
//! table and puts the thing there goes wrong where it is put.

use std::collections::BTreeMap;

use reel_trace::Trace;
use reel_world::Tool;
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
    /// With it the agent left the way to success and never came back, until it ended or
    /// the decisions ran out.
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
    let steps = trace.steps.len();
    let tools: Vec<Option<Tool>> = trace
        .steps
        .iter()
        .map(|step| Tool::parse(&step.input.call).ok())
        .collect();
    let mut settled = 0;
    for (step, tool) in tools.iter().enumerate() {
        let done = trace.steps[step].outcome.error.is_none();
        let deed = matches!(
            tool,
            Some(Tool::Pick { .. } | Tool::Place { .. } | Tool::Open { .. } | Tool::Close { .. })
        );
        let harmed = worsened(&moments[step].work, &moments[step + 1].work);
        if done && deed && !harmed.is_empty() {
            let good =
                |later: &usize| made_good(&harmed, &moments[step].work, &moments[*later].work);
            match (step + 2..=steps).find(good) {
                Some(repaid) => settled = settled.max(repaid),
                None => return Some((step, Harm::World)),
            }
        }
    }
    let cost = |moment: usize| moments[moment].hindsight.unwrap_or(u32::MAX);
    let lost = |step: usize| cost(step + 1).saturating_add(1).saturating_sub(cost(step));
    let in_time = |moment: usize| {
        moments[moment]
            .hindsight
            .is_some_and(|cost| cost <= moments[moment].budget)
    };
    let never_repaid =
        |step: usize| !(step + 1..=steps).any(|later| cost(later) < cost(step) && in_time(later));
    // Who does what a competent agent would have done loses nothing by itself.
    let astray = |step: usize| moments[step].advice.to_call() != trace.steps[step].input.call;
    let unpaid: Vec<usize> = (settled..steps)
        .filter(|step| lost(*step) > 0 && astray(*step) && never_repaid(*step))
        .collect();
    let first = *unpaid.first()?;
    let Some(end) = unpaid
        .last()
        .copied()
        .filter(|step| tools[*step] == Some(Tool::Finish))
    else {
        return Some((first, Harm::Time));
    };
    let worse = unpaid
        .iter()
        .copied()
        .find(|step| cost(step + 1) > cost(*step));
    let in_vain = unpaid
        .iter()
        .take_while(|step| **step < end)
        .fold(0_u32, |sum, step| sum.saturating_add(lost(*step)));
    let ended = worse == Some(end) && in_time(end) && in_vain < IN_VAIN;
    Some(if ended {
        (end, Harm::Ending)
    } else {
        (first, Harm::Time)
    })
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
