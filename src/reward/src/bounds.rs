//! Bounds of the reward of an episode whose record does not hold what the camera saw: robots and
//! other servers tell what a text listed and what got a marker, never what was in the picture.
//! Never guesses what was seen.

use std::fmt;

use reel_world::{
    ObjectInstance, Scene, Task,
    record::{RewardTerm, StartRecord, StepRecord, VisibleObject},
};

use crate::preset::{Preset, rewards};

/// Between which totals a reward lies that depends on what the camera saw.
#[derive(Clone, PartialEq, Debug)]
pub struct RewardBounds {
    /// The first step whose terms depend on it; those of the steps before are exact.
    pub first_step: u32,
    /// The smallest total reward: where questions pay, that of the record.
    pub lower: f64,
    /// The largest total reward: where questions pay, the one if every object was seen.
    pub upper: f64,
}

impl fmt::Display for RewardBounds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "nothing tells what the camera saw, and from step {} on the reward for asking depends \
             on it: the total lies between {:.3} and {:.3}",
            self.first_step, self.lower, self.upper
        )
    }
}

/// The bounds of the reward of an episode whose record does not hold what the camera saw; none
/// where its terms are those that [`rewards`] gives, whatever was seen.
///
/// Only the questions of `paper` read what was seen. Who saw more has no fewer reasons to ask, so
/// that the true total lies between that of the record as it is and that of one in which every
/// object was seen from the start. Up to a step where these two pay the same, so does every record
/// between them. The task has to be that of its file: one that was made from messages does not say
/// which objects fit its words.
pub fn reward_bounds(
    preset: &Preset,
    task: &Task,
    scene: &Scene,
    start: &StartRecord,
    steps: &[StepRecord],
) -> Option<RewardBounds> {
    let visible = |object: &ObjectInstance| VisibleObject {
        object: object.instance.clone(),
        pixels: 0,
        bbox: [0; 4],
    };
    let all_visible = StartRecord {
        visible: task.objects.iter().map(visible).collect(),
        ..start.clone()
    };
    let recorded = rewards(preset, task, scene, start, steps);
    let all_seen = rewards(preset, task, scene, &all_visible, steps);
    let first = recorded
        .iter()
        .zip(&all_seen)
        .position(|(recorded, seen)| !recorded.iter().map(paid).eq(seen.iter().map(paid)))?;
    let (recorded, all_seen) = (total(&recorded), total(&all_seen));
    Some(RewardBounds {
        first_step: steps[first].step,
        lower: recorded.min(all_seen),
        upper: recorded.max(all_seen),
    })
}

/// A term without its reason, which counts the candidates that were seen.
fn paid(term: &RewardTerm) -> (&str, u64) {
    (term.component.as_str(), term.value.to_bits())
}

/// The sum over all steps, added as in the metrics of an episode.
fn total(steps: &[Vec<RewardTerm>]) -> f64 {
    let of_step = |terms: &Vec<RewardTerm>| terms.iter().map(|term| term.value).sum::<f64>();
    steps.iter().map(of_step).sum()
}
