//! What was done wrong on purpose in an episode, and which of it decided. Never
//! read by what classifies.

use reel_world::{FailureClass, record::PolicyInfo};
use serde::{Deserialize, Serialize};

use crate::{FaultKind, Injection};

/// What an episode of an [`crate::Injected`] policy should be classified as.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Label {
    /// Id of the labelled episode, as its trace header has it.
    pub episode_id: String,
    /// Id of the task that the episode plays.
    pub task_id: String,
    /// The seed of the injection.
    pub seed: u64,
    /// The policy as the trace names it.
    pub policy: PolicyInfo,
    /// What was to go wrong.
    pub injection: Injection,
    /// What came of each fault, in the order of the injection.
    pub faults: Vec<FaultLabel>,
    /// What decided; none where the episode succeeded or nothing came about.
    pub primary: Option<Primary>,
}

/// What came of one fault.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct FaultLabel {
    /// Kind of fault that was injected.
    pub kind: FaultKind,
    /// Failure class of the injected fault kind.
    pub class: FailureClass,
    /// Failure sub-class; for object mistakes it follows from the object taken.
    pub sub_class: String,
    /// The decision at which it began, from 0; none: it never came about.
    pub step: Option<u32>,
    /// Whether the agent corrected it.
    pub repaired: bool,
}

/// The fault that decided.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct Primary {
    /// Failure class of the decisive fault.
    pub class: FailureClass,
    /// Failure sub-class of the decisive fault.
    pub sub_class: String,
    /// The decision at which it began.
    pub step: u32,
}

impl Primary {
    /// The primary of several (docs/spec.md#failure-taxonomy): of those not repaired `missing_ask`
    /// first, `stale_marker` and then idle repetition last, the others by time. Where all were
    /// repaired and the goal was missed all the same, the first of them cost it.
    pub fn of(faults: &[FaultLabel], success: bool) -> Option<Primary> {
        let rank = |fault: &FaultLabel| match fault.sub_class.as_str() {
            "missing_ask" => 0,
            "stale_marker" => 2,
            "repeated_call" | "repeated_question" => 3,
            _ => 1,
        };
        let decided = faults
            .iter()
            .filter(|_| !success)
            .filter_map(|fault| Some((fault, fault.step?)));
        let (fault, step) =
            decided.min_by_key(|(fault, step)| (fault.repaired, rank(fault), *step))?;
        Some(Primary {
            class: fault.class,
            sub_class: fault.sub_class.clone(),
            step,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(kind: FaultKind, step: Option<u32>, repaired: bool) -> FaultLabel {
        FaultLabel {
            kind,
            class: kind.class(),
            sub_class: kind.sub_class().unwrap_or("wrong_attribute").into(),
            step,
            repaired,
        }
    }

    fn primary(faults: &[FaultLabel]) -> Option<String> {
        Primary::of(faults, false).map(|primary| primary.sub_class)
    }

    #[test]
    fn the_primary_is_the_first_but_for_the_ask_and_the_last_resorts() {
        let early = fault(FaultKind::SimilarFurniture, Some(3), false);
        let ask = fault(FaultKind::MissingAsk, Some(7), false);
        let stale = fault(FaultKind::StaleMarker, Some(1), false);
        let idle = fault(FaultKind::Dawdling, Some(0), false);
        assert_eq!(
            primary(&[early.clone(), ask.clone()]).unwrap(),
            "missing_ask"
        );
        assert_eq!(
            primary(&[stale.clone(), idle.clone(), early.clone()]).unwrap(),
            "similar_furniture"
        );
        assert_eq!(primary(&[idle, stale]).unwrap(), "stale_marker");
        let repaired = fault(FaultKind::MissingAsk, Some(2), true);
        assert_eq!(
            primary(&[repaired.clone(), early.clone()]).unwrap(),
            "similar_furniture"
        );
        assert_eq!(
            primary(std::slice::from_ref(&repaired)).unwrap(),
            "missing_ask",
            "it cost the success"
        );
        assert_eq!(Primary::of(&[repaired, early], true), None);
        assert_eq!(primary(&[fault(FaultKind::Oscillation, None, false)]), None);
    }
}
