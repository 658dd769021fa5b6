//! Rows for reinforcement learning: a decision with its reward, return and advantage in its rollout group (SPEC section 5),
//! and the list of tasks that a trainer asks for (SPEC section 11). Computes no reward.

use std::{collections::BTreeSet, fmt::Write as _};

use serde::Serialize;

use crate::{DatasetError, Example, Format, Pictures};

/// What a decision was worth.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Rollout {
    /// Rollouts of the same task and seed by the same policy.
    pub group: String,
    /// How many rollouts the group has: G.
    pub group_size: u32,
    /// Seed of the task.
    pub seed: u64,
    /// Of this decision.
    pub reward: f64,
    /// Discounted sum of rewards of the episode from its beginning: `J_i`.
    #[serde(rename = "return")]
    pub episode_return: f64,
    /// `(J_i - mean) / (std + eps)` over the group.
    pub advantage: f64,
    /// Whether the episode succeeded.
    pub success: bool,
}

/// Appends a row: prompt, completion and pictures as TRL reads them, then the fields of the rollout, then provenance.
///
/// # Errors
/// When a picture is missing, or the example is not one decision to learn.
pub fn write_rollout_row(
    example: &Example,
    rollout: &Rollout,
    pictures: &Pictures,
    out: &mut Vec<u8>,
) -> Result<(), DatasetError> {
    Format::Trl.write_row(example, pictures, out)?;
    assert_eq!(out.pop(), Some(b'}'), "a row is a JSON object");
    let fields = serde_json::to_string(rollout).expect("a rollout has text keys only");
    out.push(b',');
    out.extend_from_slice(&fields.as_bytes()[1..]);
    Ok(())
}

/// A trainer's list of tasks: their ids as a JSON list, each once, sorted.
pub fn task_list<'t>(ids: impl IntoIterator<Item = &'t str>) -> String {
    let ids: BTreeSet<&str> = ids.into_iter().collect();
    let mut list = String::from("[");
    for (at, id) in ids.into_iter().enumerate() {
        let _ = write!(list, "{}\n  {}", if at > 0 { "," } else { "" }, crate::json::quoted(id));
    }
    list.push_str("\n]\n");
    list
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tasks_are_named_once() {
        assert_eq!(serde_json::from_str::<Vec<String>>(&task_list(["b", "a\"", "b"])).unwrap(), ["a\"", "b"]);
        assert_eq!(serde_json::from_str::<Vec<String>>(&task_list([])).unwrap(), [""; 0]);
    }
}
