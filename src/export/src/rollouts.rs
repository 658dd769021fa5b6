//! Rollout groups for reinforcement learning (docs/spec.md#advantages): which episodes are rollouts
//! of the same prompt, and how much better each was than its group. Owns the grouping; rewards are
//! the table's or those of a preset, returns and advantages are computed by `reel-reward`.

use std::{collections::BTreeMap, sync::Arc};

use reel_reward::{Estimator, PAPER_EPS, Preset, Returns, RewardError};
use reel_tables::{Store, StoreError};
use serde::{Serialize, Serializer};

use crate::select::{Candidate, SkipCounts, count, draw};

/// How episodes are grouped.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct RolloutOptions {
    /// Where no prompt group was recorded: only episodes of equal seed are one, not all of
    /// a task and policy.
    pub same_seed: bool,
    /// Rollouts a group (G): of larger groups so many are drawn, smaller ones are left out. Without
    /// it groups are as large as they are, from two.
    pub group_size: Option<usize>,
    /// How rewards become the return of an episode. Decisions beyond its horizon are no rows.
    pub returns: Returns,
    /// How returns become advantages.
    pub advantage: Estimator,
    /// Scores the episodes again under this preset. `None` if the recorded rewards count.
    #[serde(
        serialize_with = "preset_json",
        skip_serializing_if = "Option::is_none"
    )]
    pub preset: Option<Preset>,
}

fn preset_json<S: Serializer>(preset: &Option<Preset>, to: S) -> Result<S::Ok, S::Error> {
    let named = |preset: &Preset| serde_json::json!({ "name": preset.name(), "version": preset.version().to_string() });
    preset.as_ref().map(named).serialize(to)
}

impl Default for RolloutOptions {
    fn default() -> Self {
        let advantage = Estimator::Paper { eps: PAPER_EPS };
        Self {
            same_seed: false,
            group_size: None,
            returns: Returns::PAPER,
            advantage,
            preset: None,
        }
    }
}

/// What an episode was worth in its group.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct GroupReturn {
    pub group: Arc<str>,
    pub group_size: u32,
    pub rollout: u32,
    pub episode_return: f64,
    pub advantage: f64,
    /// What each step pays: as recorded, or under the preset of the export.
    pub rewards: Arc<[f64]>,
}

/// Scores episodes again. Decisions after the step with which the preset is done with an episode
/// are left out: whoever pays by it never asks for them.
pub(crate) fn rescore(
    found: &mut [Candidate],
    store: &Store,
    preset: &Preset,
    left_out: &mut SkipCounts,
) -> Result<(), StoreError> {
    let mut wanted: BTreeMap<String, &mut Candidate> = found
        .iter_mut()
        .map(|candidate| (candidate.trace_digest.clone(), candidate))
        .collect();
    let mut later = 0;
    store.score(std::slice::from_ref(preset), |episode, rewards| {
        if let Some(candidate) = wanted.remove(episode.trace_digest) {
            let reward = &rewards[0];
            candidate.rewards = reward.steps().into();
            // an episode that breaks off before the preset is done has no return
            let ended = candidate.discounted_return.is_some() || reward.ending().is_some();
            candidate.discounted_return = ended.then(|| reward.discounted_return());
            candidate.paid_until = reward.ending().map(|(last, _)| last);
            if let Some(last) = candidate.paid_until {
                let before = candidate.decisions.len();
                candidate.decisions.retain(|decision| decision.call <= last);
                later += before - candidate.decisions.len();
            }
        }
        !wanted.is_empty()
    })?;
    count(
        left_out,
        "decisions after the reward preset was done",
        later,
    );
    Ok(())
}

/// Puts the episodes into groups; those that are in none are left out, with the reason.
///
/// # Errors
/// Fails if the estimator refuses the returns.
pub(crate) fn group(
    found: &mut Vec<Candidate>,
    how: &RolloutOptions,
    seed: u64,
    left_out: &mut SkipCounts,
) -> Result<(), RewardError> {
    let mut groups: BTreeMap<String, Vec<(usize, f64)>> = BTreeMap::new();
    let (mut endless, mut late) = (0, 0);
    for (index, candidate) in found.iter_mut().enumerate() {
        if candidate.discounted_return.is_none() {
            endless += 1;
            continue;
        }
        let before = candidate.decisions.len();
        candidate
            .decisions
            .retain(|decision| decision.call < how.returns.horizon);
        late += before - candidate.decisions.len();
        groups
            .entry(key(candidate, how))
            .or_default()
            .push((index, how.returns.of(&candidate.rewards)));
    }
    count(left_out, "episodes without an end", endless);
    count(left_out, "decisions beyond the horizon", late);
    let mut batch: Vec<(Arc<str>, _)> = Vec::new();
    for (name, mut members) in groups {
        if members.len() < how.group_size.unwrap_or(2).max(1) {
            count(
                left_out,
                "episodes of groups with too few rollouts",
                members.len(),
            );
            continue;
        }
        if let Some(size) = how.group_size {
            members.sort_by_cached_key(|(index, _)| draw(seed, &found[*index].episode_id, None));
            count(
                left_out,
                "episodes beyond the size of their group",
                members.len().saturating_sub(size),
            );
            members.truncate(size);
        }
        members.sort_by(|(a, _), (b, _)| found[*a].episode_id.cmp(&found[*b].episode_id));
        batch.push((Arc::from(name), members));
    }
    let returns: Vec<Vec<f64>> = batch
        .iter()
        .map(|(_, members)| members.iter().map(|(_, worth)| *worth).collect())
        .collect();
    for ((group, members), advantages) in batch.iter().zip(how.advantage.advantages(&returns)?) {
        let group_size = members.len() as u32;
        for (rollout, ((index, episode_return), advantage)) in
            members.iter().zip(advantages).enumerate()
        {
            let (group, rollout, episode_return) =
                (Arc::clone(group), rollout as u32, *episode_return);
            let rewards = Arc::clone(&found[*index].rewards);
            found[*index].worth = Some(GroupReturn {
                group,
                group_size,
                rollout,
                episode_return,
                advantage,
                rewards,
            });
        }
    }
    found.retain(|candidate| candidate.worth.is_some());
    Ok(())
}

/// The prompt group that was recorded; else the task, the policy, and the seed
/// where that is wanted.
fn key(candidate: &Candidate, how: &RolloutOptions) -> String {
    let Candidate {
        group_id,
        policy,
        task_digest,
        seed,
        ..
    } = candidate;
    match group_id {
        Some(group) => group.clone(),
        None if how.same_seed => format!(
            "{policy}/{}/{seed}",
            &task_digest[..task_digest.len().min(12)]
        ),
        None => format!("{policy}/{}", &task_digest[..task_digest.len().min(12)]),
    }
}

#[cfg(test)]
mod tests {
    use reel_reward::Scale;

    use super::*;
    use crate::select::Decision;

    fn episode(id: &str, task: &str, seed: u64, worth: Option<f64>) -> Candidate {
        Candidate {
            episode_id: id.into(),
            discounted_return: worth,
            rewards: worth.into_iter().collect(),
            seed: seed.to_string(),
            ..Candidate::sample(task)
        }
    }

    fn worths(found: &[Candidate]) -> Vec<(&str, u32, u32, f64)> {
        let worth = |it: &Candidate| {
            it.worth
                .as_ref()
                .map(|worth| (worth.group_size, worth.rollout, worth.advantage))
                .unwrap()
        };
        found
            .iter()
            .map(|it| {
                (
                    it.episode_id.as_str(),
                    worth(it).0,
                    worth(it).1,
                    worth(it).2,
                )
            })
            .collect()
    }

    #[test]
    fn a_rollout_is_worth_what_it_is_better_than_its_group() {
        let mut found = vec![
            episode("c", "mug", 1, Some(1.0)),
            episode("a", "mug", 2, Some(3.0)),
            episode("lonely", "cup", 1, Some(1.0)),
            episode("endless", "mug", 3, None),
        ];
        let mut left_out = SkipCounts::default();
        let how = RolloutOptions {
            advantage: Estimator::Paper { eps: 0.0 },
            ..RolloutOptions::default()
        };
        group(&mut found, &how, 0, &mut left_out).unwrap();
        assert_eq!(worths(&found), [("c", 2, 1, -1.0), ("a", 2, 0, 1.0)]);
        assert_eq!(
            left_out.into_iter().collect::<Vec<_>>(),
            [
                ("episodes of groups with too few rollouts", 1),
                ("episodes without an end", 1)
            ]
        );
    }

    #[test]
    fn returns_and_estimator_are_those_that_were_asked_for() {
        let long = |id: &str, reward: f64| {
            let decisions = (0..60).map(|call| Decision { call, tool: 0 }).collect();
            Candidate {
                rewards: vec![reward; 60].into(),
                decisions,
                ..episode(id, "mug", 0, Some(0.0))
            }
        };
        let grouped = |returns: Returns, advantage: Estimator| {
            let (mut found, mut left_out) =
                (vec![long("a", 0.0), long("b", 1.0)], SkipCounts::default());
            let how = RolloutOptions {
                returns,
                advantage,
                ..RolloutOptions::default()
            };
            group(&mut found, &how, 0, &mut left_out).unwrap();
            let worth = found[1].worth.clone().unwrap();
            (
                worth.episode_return,
                worth.advantage,
                found[1].decisions.len(),
                left_out["decisions beyond the horizon"],
            )
        };
        let rloo = Estimator::named("rloo", Scale::None).unwrap();
        assert_eq!(grouped(Returns::PUBLISHED, rloo), (50.0, 50.0, 50, 20));
        let (paper, advantage, decisions, late) =
            grouped(Returns::PAPER, Estimator::Paper { eps: 0.0 });
        assert!(
            (paper - (1.0 - 0.99f64.powi(30)) / 0.01).abs() < 1e-9
                && (advantage - 1.0).abs() < 1e-9
        );
        assert_eq!((decisions, late), (30, 60));
    }

    #[test]
    fn groups_have_the_size_that_was_asked_for_and_recorded_groups_stay_together() {
        let rollouts = |count: u64| {
            (0..count).map(|seed| episode(&format!("e{seed}"), "mug", seed, Some(seed as f64)))
        };
        let grouped = |how: RolloutOptions, mut found: Vec<Candidate>| {
            let mut left_out = SkipCounts::default();
            group(&mut found, &how, 7, &mut left_out).unwrap();
            (found.len(), left_out.values().sum::<u64>())
        };
        let of = |size: usize| RolloutOptions {
            group_size: Some(size),
            ..RolloutOptions::default()
        };
        assert_eq!(grouped(of(8), rollouts(10).collect()), (8, 2));
        assert_eq!(grouped(of(8), rollouts(7).collect()), (0, 7));
        let same_seed = RolloutOptions {
            same_seed: true,
            ..RolloutOptions::default()
        };
        assert_eq!(
            grouped(same_seed.clone(), rollouts(5).collect()),
            (0, 5),
            "every seed is another group"
        );
        let recorded = rollouts(5).map(|it| Candidate {
            group_id: Some("g".into()),
            ..it
        });
        assert_eq!(grouped(same_seed, recorded.collect()), (5, 0));
    }
}
