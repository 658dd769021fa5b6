//! Which goal changes hold in a graph. Looks at the state only, never at how it came about.

use reel_world::{GraphEvent, InstanceId, WorldGraph};

/// How many elements of `goal (-) initial` hold in a graph, and how many there are. An element that
/// moves one of several equal instances holds as often as their number has changed since the start.
pub(crate) fn holding(
    initial: &WorldGraph,
    goal: &WorldGraph,
    graph: &WorldGraph,
) -> (usize, usize) {
    let changes = goal.difference(initial);
    let mut holding = 0;
    for (index, event) in changes.iter().enumerate() {
        let earlier = changes[..index]
            .iter()
            .filter(|other| *other == event)
            .count() as u32;
        let (was, now) = (count(initial, event), count(graph, event));
        let holds = match event {
            GraphEvent::Remove { .. } => was.saturating_sub(now) > earlier,
            GraphEvent::Add { .. } => now.saturating_sub(was) > earlier,
            GraphEvent::Door { receptacle, to, .. } => graph.door(receptacle) == Some(*to),
        };
        holding += usize::from(holds);
    }
    (holding, changes.len())
}

/// How many of the object of an event a graph holds at its place.
pub(crate) fn count(graph: &WorldGraph, event: &GraphEvent) -> u32 {
    let content = graph
        .receptacles
        .get(event.receptacle())
        .map(|state| &state.content);
    event
        .object()
        .and_then(|object| content?.get(object).copied())
        .unwrap_or(0)
}

/// The graph as the published code compares it: kinds (assets, categories) instead of
/// instances, and no doors.
pub(crate) fn by_kind(graph: &WorldGraph, kind: impl Fn(&InstanceId) -> InstanceId) -> WorldGraph {
    let mut kinds = WorldGraph::default();
    for (receptacle, state) in &graph.receptacles {
        let content = &mut kinds
            .receptacles
            .entry(receptacle.clone())
            .or_default()
            .content;
        for (instance, count) in &state.content {
            *content.entry(kind(instance)).or_insert(0) += count;
        }
    }
    kinds
}
