//! What a record without a simulator leaves open of a reward: robots and other servers tell what a
//! text listed and what got a marker, never what was in the image, and some not even what a call
//! acted on. Never guesses what was seen.

use std::{fmt, sync::Arc};

use reel_world::{
    ObjectInstance, Scene, Task,
    record::{Backend, EpisodeHeader, RewardTerm, StartRecord, StepRecord, VisibleObject},
};

use crate::{
    preset::{Preset, rewards},
    terms::Base,
};

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

/// What a record without sight leaves open of a reward.
#[derive(Clone, PartialEq, Debug)]
pub enum OpenReward {
    /// What the camera saw decides it.
    Between(RewardBounds),
    /// The task was made from messages, which do not say which objects fit its words either.
    AtLeast {
        /// The first question that paid nothing.
        first_step: u32,
    },
    /// No result shows the world: calls succeeded, and nothing tells what they acted on.
    WorldUnknown {
        /// The first such call.
        first_step: u32,
    },
}

impl fmt::Display for OpenReward {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            OpenReward::WorldUnknown { first_step } => write!(
                f,
                "no result shows the world, and from step {first_step} on success, completion and \
                 reward depend on it: they are those of a world in which nothing changed"
            ),
            OpenReward::Between(bounds) => bounds.fmt(f),
            OpenReward::AtLeast { first_step } => write!(
                f,
                "nothing tells which objects fit the task's words, and from step {first_step} on the \
                 reward for asking depends on it: the total is a lower bound; --tasks gives the \
                 task's own file"
            ),
        }
    }
}

/// What is open of the reward of a recorded episode under a preset; `None` where a simulator
/// recorded it, or the task has no goal. The task counts as that of its file: no record says where it came from.
pub fn open_reward_of_record(
    preset: &Preset,
    header: &EpisodeHeader,
    task: &Task,
    scene: &Scene,
    start: &StartRecord,
    steps: &[StepRecord],
) -> Option<OpenReward> {
    if header.backend == Backend::Sim || !task.has_goal() {
        return None;
    }
    world_unknown(steps)
        .or_else(|| reward_bounds(preset, task, scene, start, steps).map(OpenReward::Between))
}

/// A call that changes the world succeeded, and neither what it acted on nor any change is shown.
fn world_unknown(steps: &[StepRecord]) -> Option<OpenReward> {
    if steps.iter().any(|step| !step.changes.registry.is_empty()) {
        return None;
    }
    let acted = |step: &&StepRecord| {
        matches!(step.tool_name(), "pick" | "place" | "open" | "close")
            && step.outcome.is_ok()
            && step.object.is_none()
            && step.receptacle.is_none()
    };
    let first = steps.iter().find(acted)?;
    Some(OpenReward::WorldUnknown {
        first_step: first.step,
    })
}

/// What is open of the reward of an episode whose record does not hold what the camera saw; `None`
/// where the task has no goal. `known` are the tasks of files; another one was made from messages.
pub fn open_reward(
    preset: &Preset,
    known: &[Arc<Task>],
    task: &Task,
    scene: &Scene,
    start: &StartRecord,
    steps: &[StepRecord],
) -> Option<OpenReward> {
    if !task.has_goal() {
        return None;
    }
    if let Some(open) = world_unknown(steps) {
        return Some(open);
    }
    if known.iter().any(|known| known.task_id == task.task_id) {
        return reward_bounds(preset, task, scene, start, steps).map(OpenReward::Between);
    }
    if preset.base() != Base::Paper {
        return None;
    }
    let terms = rewards(preset, task, scene, start, steps);
    let unpaid = |(step, terms): &(&StepRecord, &Vec<RewardTerm>)| {
        let pays = terms.iter().any(|term| term.component == "ask");
        step.tool_name() == "ask" && step.outcome.is_ok() && !pays
    };
    let first = steps.iter().zip(&terms).find(unpaid)?.0;
    Some(OpenReward::AtLeast {
        first_step: first.step,
    })
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
