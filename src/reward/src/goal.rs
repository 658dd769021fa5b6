//! Which goal changes hold in a state. Looks at the state only, never at how it came about.

use reel_world::{GraphEvent, Task, WorldGraph};

/// How many elements of `changes` (`Delta_goal`) hold in a graph. An element that moves one of several equal instances holds
/// as often as their number has changed since the start.
pub(crate) fn holding(task: &Task, changes: &[GraphEvent], graph: &WorldGraph) -> usize {
    let count = |graph: &WorldGraph, event: &GraphEvent| {
        let content = graph.receptacles.get(event.receptacle()).map(|state| &state.content);
        event.object().and_then(|object| content?.get(object).copied()).unwrap_or(0)
    };
    let mut holding = 0;
    for (index, event) in changes.iter().enumerate() {
        let earlier = changes[..index].iter().filter(|other| *other == event).count() as u32;
        let (was, now) = (count(&task.initial, event), count(graph, event));
        let holds = match event {
            GraphEvent::Remove { .. } => was.saturating_sub(now) > earlier,
            GraphEvent::Add { .. } => now.saturating_sub(was) > earlier,
            GraphEvent::Door { receptacle, to, .. } => graph.door(receptacle) == Some(*to),
        };
        holding += usize::from(holds);
    }
    holding
}
