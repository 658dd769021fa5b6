//! World graphs as the published server writes them: `{receptacle: {content: [instance], door:
//! bool}}`, and its older summary in text, which leaves out doors and whatever is empty.

use reel_world::{DoorState, ReceptacleId, WorldGraph};
use serde_json::{Map, Value};

/// The graph of a `debug_info.json`; none where it holds none. A summary in text is completed by
/// the graph before it.
pub(crate) fn of_debug_info(
    debug_info: &Map<String, Value>,
    before: Option<&WorldGraph>,
) -> Option<WorldGraph> {
    match (debug_info.get("world_graph"), debug_info.get("WORLD_GRAPH")) {
        (Some(graph @ Value::Object(_)), _) | (_, Some(graph @ Value::Object(_))) => parse(graph),
        (_, Some(Value::String(text))) => Some(parse_summary(text, before)),
        _ => None,
    }
}

/// A graph in JSON; none where the value is none. What stands in it and is no name is passed over.
pub(crate) fn parse(value: &Value) -> Option<WorldGraph> {
    let mut graph = WorldGraph::default();
    for (name, state) in value.as_object()? {
        let receptacle = ReceptacleId::from(name.as_str());
        graph
            .receptacles
            .entry(receptacle.clone())
            .or_default()
            .door = state.get("door").and_then(door_state);
        let content = state.get("content").unwrap_or(state).as_array();
        for object in content.into_iter().flatten().filter_map(Value::as_str) {
            graph.add(&receptacle, &object.into());
        }
    }
    Some(graph)
}

/// A door is `true` where it is open.
fn door_state(value: &Value) -> Option<DoorState> {
    match value {
        Value::Bool(true) => Some(DoorState::Open),
        Value::Bool(false) => Some(DoorState::Closed),
        Value::String(text) if text == "open" => Some(DoorState::Open),
        Value::String(text) if text == "closed" => Some(DoorState::Closed),
        _ => None,
    }
}

/// Lines `receptacle: ['instance', ...]`. What they leave out is empty; its door stands as before.
fn parse_summary(text: &str, before: Option<&WorldGraph>) -> WorldGraph {
    let mut graph = before.cloned().unwrap_or_default();
    for state in graph.receptacles.values_mut() {
        state.content.clear();
    }
    for (name, content) in summary_lines(text) {
        for object in content {
            graph.add(&name.into(), &object.into());
        }
    }
    graph
}

/// The lines of a summary: receptacles and what they hold. What is no list of texts holds nothing.
pub(crate) fn summary_lines(text: &str) -> impl Iterator<Item = (&str, Vec<&str>)> {
    let lines = text.lines().filter_map(|line| line.split_once(':'));
    lines.map(|(name, content)| {
        let content = content.trim();
        let list = content
            .strip_prefix('[')
            .and_then(|rest| rest.strip_suffix(']'));
        (
            name.trim(),
            list.map(|list| quoted(list).collect()).unwrap_or_default(),
        )
    })
}

/// The strings between the brackets of a Python list of strings; identifiers hold no quotes.
fn quoted(list: &str) -> impl Iterator<Item = &str> {
    list.split(['\'', '"'])
        .skip(1)
        .step_by(2)
        .filter(|object| !object.is_empty())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn debug_info(value: Value) -> Map<String, Value> {
        value.as_object().unwrap().clone()
    }

    #[test]
    fn the_machine_readable_graph_goes_before_the_summary() {
        let both = json!({"WORLD_GRAPH": "a: ['y']\n", "world_graph": {"a": {"content": ["x", "x", 3]}, "b": {"content": [], "door": true}}});
        let graph = of_debug_info(&debug_info(both), None).unwrap();
        assert_eq!(graph.objects_on(&"a".into()), ["x".into(), "x".into()]);
        assert_eq!(graph.door(&"b".into()), Some(DoorState::Open));
        assert_eq!(
            of_debug_info(&debug_info(json!({"CURRENT_INV": null})), None),
            None
        );
    }

    #[test]
    fn a_summary_is_completed_by_the_graph_before() {
        let before =
            parse(&json!({"a": {"content": ["x"]}, "fridge": {"content": ["y"], "door": false}}))
                .unwrap();
        let summary = debug_info(json!({"WORLD_GRAPH": "fridge: ['y', \"x\"]\nnonsense\n"}));
        let graph = of_debug_info(&summary, Some(&before)).unwrap();
        assert_eq!(graph.objects_on(&"fridge".into()), ["x".into(), "y".into()]);
        assert_eq!(graph.door(&"fridge".into()), Some(DoorState::Closed));
        assert!(graph.objects_on(&"a".into()).is_empty() && graph.receptacles.contains_key("a"));
    }
}
