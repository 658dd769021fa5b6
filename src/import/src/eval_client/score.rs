//! How the client scores an episode: on the last world graph it was shown.

use serde_json::{Map, Value, json};

use crate::graph;

/// The graph of debug information, as the client keeps it. `None` if there is none. A summary in
/// text names only receptacles that hold something, and those are then all.
pub fn world_graph(debug: &Map<String, Value>) -> Option<Value> {
    match (debug.get("world_graph"), debug.get("WORLD_GRAPH")) {
        (Some(graph @ Value::Object(_)), _) | (_, Some(graph @ Value::Object(_))) => {
            Some(graph.clone())
        }
        (_, Some(Value::String(text))) => {
            let states = graph::summary_lines(text)
                .map(|(name, content)| (name.to_owned(), json!({ "content": content })));
            let states: Map<String, Value> = states.collect();
            (!states.is_empty()).then_some(Value::Object(states))
        }
        _ => None,
    }
}

/// Whether a graph is the goal: each receptacle of the goal is there, holds the same names in any
/// order and, where the goal says how its door stands, stands so. No goal is never reached.
pub fn is_success(actual: &Value, goal: &Value) -> bool {
    let Some(goal) = goal.as_object().filter(|goal| !goal.is_empty()) else {
        return false;
    };
    goal.iter().all(|(name, wanted)| {
        let Some(state) = actual.get(name).and_then(Value::as_object) else {
            return false;
        };
        let same_door = wanted
            .get("door")
            .is_none_or(|door| state.get("door") == Some(door));
        same_door && sorted(state.get("content")) == sorted(wanted.get("content"))
    })
}

/// A list in the order of its texts; anything else as it is.
fn sorted(content: Option<&Value>) -> Option<Value> {
    let mut content = content?.clone();
    if let Value::Array(names) = &mut content {
        names.sort_by(|a, b| a.as_str().cmp(&b.as_str()));
    }
    Some(content)
}
