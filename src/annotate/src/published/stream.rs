//! The stream of events of an episode: which observation followed which action.

use serde_json::{Map, Value};

/// Events that are no actions.
const OBSERVATION: &str = "obs";
const ERROR: &str = "error";

/// An action with the observation that followed it.
#[derive(Clone, PartialEq, Debug)]
pub struct Pair {
    /// The event `{action, payload}`; `None` for an observation that followed no action.
    pub action: Option<Map<String, Value>>,
    /// The payload of the observation; `None` if another action, or nothing, followed.
    pub observation: Option<Value>,
}

/// The pairs of a stream. Its first item describes the episode; errors and what is no
/// event are passed over.
pub fn pairs(stream: &[Value]) -> Vec<Pair> {
    let mut pairs = Vec::new();
    let mut pending: Option<Map<String, Value>> = None;
    for event in stream.iter().skip(1).filter_map(Value::as_object) {
        match event.get("action").and_then(Value::as_str) {
            None | Some(ERROR) => {}
            Some(OBSERVATION) => {
                pairs.push(Pair {
                    action: pending.take(),
                    observation: Some(event.get("payload").cloned().unwrap_or_default()),
                });
            }
            Some(_) => {
                pairs.extend(pending.replace(event.clone()).map(|action| Pair {
                    action: Some(action),
                    observation: None,
                }));
            }
        }
    }
    pairs.extend(pending.map(|action| Pair {
        action: Some(action),
        observation: None,
    }));
    pairs
}
