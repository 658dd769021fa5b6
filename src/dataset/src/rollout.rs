//! What decisions were worth to reinforcement learning: reward, return and advantage in a rollout
//! group (docs/spec.md#advantages), as fields of their rows; and the list of tasks that a trainer
//! asks for (docs/spec.md#published-servers). Computes no reward.

use std::{collections::BTreeSet, fmt::Write as _};

use reel_world::TokenLogprobs;
use serde::Serialize;

/// What a decision was worth.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Rollout {
    /// Names its prompt group: rollouts of the same task by the same policy.
    pub group: String,
    /// How many rollouts the group has: G.
    pub group_size: u32,
    /// Which of them it is, from 0.
    pub rollout: u32,
    /// Seed of the episode.
    pub seed: u64,
    /// Which decision of the episode, from 0.
    pub step: u32,
    /// How many decisions the episode has.
    pub steps: u32,
    /// Reward that the agent got for this decision.
    pub reward: f64,
    /// Of the episode: the sum of its rewards as the manifest says (`rollouts.returns`), `J_i`.
    #[serde(rename = "return")]
    pub episode_return: f64,
    /// How much better that is than the group, by the estimator that
    /// the manifest names (`rollouts.advantage`).
    pub advantage: f64,
    /// Whether the episode succeeded.
    pub success: bool,
    /// The tokens that the policy wrote, as `tokens`, and by policy their log-probabilities, as
    /// `logprobs`; `None` (and no such fields) if they were not recorded.
    #[serde(flatten)]
    pub logprobs: Option<TokenLogprobs>,
}

impl Rollout {
    /// Appends its fields, each after a comma.
    pub(crate) fn append(&self, out: &mut Vec<u8>) {
        let fields = serde_json::to_string(self).expect("a rollout has text keys only");
        out.push(b',');
        out.extend_from_slice(&fields.as_bytes()[1..fields.len() - 1]);
    }
}

/// Name of the list of tasks in a dataset's folder.
pub const TASK_LIST: &str = "tasks.json";

/// A trainer's list of tasks: their ids as a JSON list, each once, sorted.
pub fn task_list<'t>(ids: impl IntoIterator<Item = &'t str>) -> String {
    let ids: BTreeSet<&str> = ids.into_iter().collect();
    let mut list = String::from("[");
    for (at, id) in ids.into_iter().enumerate() {
        let _ = write!(
            list,
            "{}\n  {}",
            if at > 0 { "," } else { "" },
            crate::json::quoted(id)
        );
    }
    list.push_str("\n]\n");
    list
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tasks_are_named_once() {
        assert_eq!(
            serde_json::from_str::<Vec<String>>(&task_list(["b", "a\"", "b"])).unwrap(),
            ["a\"", "b"]
        );
        assert_eq!(
            serde_json::from_str::<Vec<String>>(&task_list([])).unwrap(),
            [""; 0]
        );
    }
}
