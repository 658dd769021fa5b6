//! What two presets give the same episode, compared: how much, through which component, in which
//! steps. Never runs a preset.

use std::collections::BTreeMap;

use crate::{real_trainer::TrainerEnd, score::EpisodeReward};

/// How the reward of an episode changes from one preset to another.
#[derive(Clone, PartialEq, Debug)]
pub struct RewardDifference {
    /// The total under the first preset.
    pub before: f64,
    /// The total under the second.
    pub after: f64,
    /// Components whose terms differ in any step, by name.
    pub components: BTreeMap<&'static str, ComponentDifference>,
    /// Steps whose terms differ, from 0, in order.
    pub steps: Vec<u32>,
    /// The step with which the rules of each preset were done with the episode, and why; `None` if
    /// they read it to its end.
    pub endings: [Option<(u32, TrainerEnd)>; 2],
}

/// How one component changes over an episode.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct ComponentDifference {
    /// Its sum under the first preset; 0 where that one has no such component.
    pub before: f64,
    /// Its sum under the second.
    pub after: f64,
}

/// Compares two rewards of one episode, bit for bit. None: no term of any step differs
/// (names and reasons apart).
pub fn difference(before: &EpisodeReward, after: &EpisodeReward) -> Option<RewardDifference> {
    let mut changed = BTreeMap::new();
    let mut steps = Vec::new();
    for step in 0..before.steps().len().max(after.steps().len()) {
        let (old, new) = (components(before, step), components(after, step));
        let names: Vec<&str> = old
            .keys()
            .chain(new.keys())
            .copied()
            .filter(|name| old.get(name) != new.get(name))
            .collect();
        if !names.is_empty() {
            steps.push(step as u32);
        }
        for name in names {
            let sums = || ComponentDifference {
                before: before.component(name),
                after: after.component(name),
            };
            changed.entry(name).or_insert_with(sums);
        }
    }
    let endings = [before.ending(), after.ending()];
    let found = RewardDifference {
        before: before.total(),
        after: after.total(),
        components: changed,
        steps,
        endings,
    };
    (!found.steps.is_empty()).then_some(found)
}

/// The bits of what a step pays by component.
fn components(reward: &EpisodeReward, step: usize) -> BTreeMap<&'static str, Vec<u64>> {
    let mut values: BTreeMap<&str, Vec<u64>> = BTreeMap::new();
    for fired in reward.terms(step) {
        values
            .entry(fired.term.component())
            .or_default()
            .push(fired.value.to_bits());
    }
    values
}
