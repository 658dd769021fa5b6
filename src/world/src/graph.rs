//! The world graph, a multiset of object instances per receptacle, and its signed difference
//! (paper, Problem Formulation; docs/spec.md#world-graph).

use std::{collections::BTreeMap, fmt};

use serde::{Deserialize, Serialize};

use crate::{FLOOR, InstanceId, ReceptacleId};

/// Whether a door stands open.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DoorState {
    /// The hinge is nearer to its open angle.
    Open,
    /// The hinge is nearer to its closed angle.
    Closed,
}

impl fmt::Display for DoorState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            DoorState::Open => "open",
            DoorState::Closed => "closed",
        })
    }
}

/// What the graph knows of one receptacle.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
pub struct ReceptacleState {
    /// Absent where the receptacle has no door.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub door: Option<DoorState>,
    /// How many of each instance are here; never zero.
    pub content: BTreeMap<InstanceId, u32>,
}

/// `{receptacle -> multiset of object instances}` with door states. [`FLOOR`] is a
/// place like any other.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct WorldGraph {
    /// By receptacle, in identifier order.
    pub receptacles: BTreeMap<ReceptacleId, ReceptacleState>,
}

/// One signed element of a difference of two world graphs.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "lowercase")]
pub enum GraphEvent {
    /// An object leaves a receptacle, shown as `-object@receptacle`.
    Remove {
        /// The object that left.
        object: InstanceId,
        /// The receptacle (or the floor) that the object left.
        receptacle: ReceptacleId,
    },
    /// An object arrives at a receptacle, shown as `+object@receptacle`.
    Add {
        /// The object that came.
        object: InstanceId,
        /// The receptacle (or the floor) that the object came to.
        receptacle: ReceptacleId,
    },
    /// `receptacle.door: from -> to`
    Door {
        /// The receptacle with the door.
        receptacle: ReceptacleId,
        /// State of the door before the change.
        from: DoorState,
        /// State of the door after the change.
        to: DoorState,
    },
}

impl GraphEvent {
    /// The event that undoes this one.
    pub fn reverse(&self) -> Self {
        match self.clone() {
            GraphEvent::Remove { object, receptacle } => GraphEvent::Add { object, receptacle },
            GraphEvent::Add { object, receptacle } => GraphEvent::Remove { object, receptacle },
            GraphEvent::Door {
                receptacle,
                from,
                to,
            } => GraphEvent::Door {
                receptacle,
                from: to,
                to: from,
            },
        }
    }

    /// The object that moved; none for a door.
    pub fn object(&self) -> Option<&InstanceId> {
        match self {
            GraphEvent::Remove { object, .. } | GraphEvent::Add { object, .. } => Some(object),
            GraphEvent::Door { .. } => None,
        }
    }

    /// The receptacle it happened at.
    pub fn receptacle(&self) -> &ReceptacleId {
        match self {
            GraphEvent::Remove { receptacle, .. }
            | GraphEvent::Add { receptacle, .. }
            | GraphEvent::Door { receptacle, .. } => receptacle,
        }
    }
}

impl fmt::Display for GraphEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            GraphEvent::Remove { object, receptacle } => write!(f, "-{object}@{receptacle}"),
            GraphEvent::Add { object, receptacle } => write!(f, "+{object}@{receptacle}"),
            GraphEvent::Door {
                receptacle,
                from,
                to,
            } => write!(f, "{receptacle}.door: {from} -> {to}"),
        }
    }
}

impl WorldGraph {
    /// Adds one instance to a receptacle, which is made if it was not there.
    pub fn add(&mut self, receptacle: &ReceptacleId, object: &InstanceId) {
        let state = self.receptacles.entry(receptacle.clone()).or_default();
        *state.content.entry(object.clone()).or_insert(0) += 1;
    }

    /// Takes one instance away; false if it was not there.
    pub fn remove(&mut self, receptacle: &ReceptacleId, object: &InstanceId) -> bool {
        let Some(state) = self.receptacles.get_mut(receptacle) else {
            return false;
        };
        let Some(count) = state.content.get_mut(object) else {
            return false;
        };
        *count -= 1;
        if *count == 0 {
            state.content.remove(object);
        }
        true
    }

    /// The first receptacle (or the floor) that holds the object.
    pub fn receptacle_of(&self, object: &InstanceId) -> Option<&ReceptacleId> {
        self.receptacles
            .iter()
            .find(|(_, state)| state.content.contains_key(object))
            .map(|(id, _)| id)
    }

    /// Objects on a receptacle, in identifier order, repeated by count.
    pub fn objects_on(&self, receptacle: &ReceptacleId) -> Vec<InstanceId> {
        let Some(state) = self.receptacles.get(receptacle) else {
            return Vec::new();
        };
        let repeat = |(object, count): (&InstanceId, &u32)| vec![object.clone(); *count as usize];
        state.content.iter().flat_map(repeat).collect()
    }

    /// Door state of a receptacle; none where it has no door.
    pub fn door(&self, receptacle: &ReceptacleId) -> Option<DoorState> {
        self.receptacles.get(receptacle)?.door
    }

    /// How many objects it holds in all.
    pub fn object_count(&self) -> u32 {
        self.receptacles
            .values()
            .flat_map(|state| state.content.values())
            .sum()
    }

    /// The signed difference `self (-) before`: what must happen to `before` to give `self`.
    /// Moving n objects gives 2n entries. Sorted; an entry is repeated by its multiplicity.
    pub fn difference(&self, before: &WorldGraph) -> Vec<GraphEvent> {
        let empty = ReceptacleState::default();
        let mut events = Vec::new();
        let mut ids: Vec<&ReceptacleId> = self
            .receptacles
            .keys()
            .chain(before.receptacles.keys())
            .collect();
        ids.sort();
        ids.dedup();
        for receptacle in ids {
            let new = self.receptacles.get(receptacle).unwrap_or(&empty);
            let old = before.receptacles.get(receptacle).unwrap_or(&empty);
            if let (Some(from), Some(to)) = (old.door, new.door)
                && from != to
            {
                events.push(GraphEvent::Door {
                    receptacle: receptacle.clone(),
                    from,
                    to,
                });
            }
            let mut objects: Vec<&InstanceId> =
                new.content.keys().chain(old.content.keys()).collect();
            objects.sort();
            objects.dedup();
            for object in objects {
                let now = new.content.get(object).copied().unwrap_or(0);
                let was = old.content.get(object).copied().unwrap_or(0);
                let event = |add: bool| {
                    let (object, receptacle) = (object.clone(), receptacle.clone());
                    if add {
                        GraphEvent::Add { object, receptacle }
                    } else {
                        GraphEvent::Remove { object, receptacle }
                    }
                };
                events.extend(std::iter::repeat_n(
                    event(now > was),
                    now.abs_diff(was) as usize,
                ));
            }
        }
        events.sort();
        events
    }

    /// Applies events of a difference. The inverse of [`WorldGraph::difference`]:
    /// `before.apply(after.difference(before)) == after` up to receptacles
    /// without content and door.
    pub fn apply(&mut self, events: &[GraphEvent]) {
        for event in events {
            match event {
                GraphEvent::Remove { object, receptacle } => {
                    self.remove(receptacle, object);
                }
                GraphEvent::Add { object, receptacle } => self.add(receptacle, object),
                GraphEvent::Door { receptacle, to, .. } => {
                    self.receptacles.entry(receptacle.clone()).or_default().door = Some(*to);
                }
            }
        }
    }

    /// What lies on the floor.
    pub fn objects_on_floor(&self) -> Vec<InstanceId> {
        self.objects_on(&FLOOR.into())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn graph(entries: &[(u8, u8)], doors: &[(u8, bool)]) -> WorldGraph {
        let mut graph = WorldGraph::default();
        for receptacle in 0..4u8 {
            graph
                .receptacles
                .insert(format!("r{receptacle}").into(), ReceptacleState::default());
        }
        for (receptacle, object) in entries {
            graph.add(
                &format!("r{receptacle}").into(),
                &format!("o{object}_on_r_at_t").into(),
            );
        }
        for receptacle in 0..2u8 {
            let open = doors.iter().any(|(id, open)| *id == receptacle && *open);
            let state = if open {
                DoorState::Open
            } else {
                DoorState::Closed
            };
            graph
                .receptacles
                .get_mut(format!("r{receptacle}").as_str())
                .unwrap()
                .door = Some(state);
        }
        graph
    }

    fn any_graph() -> impl Strategy<Value = WorldGraph> {
        let entries = proptest::collection::vec((0..4u8, 0..5u8), 0..12);
        let doors = proptest::collection::vec((0..2u8, any::<bool>()), 0..3);
        (entries, doors).prop_map(|(entries, doors)| graph(&entries, &doors))
    }

    proptest! {
        #[test]
        fn difference_then_apply_gives_the_other(a in any_graph(), b in any_graph()) {
            let mut c = a.clone();
            c.apply(&b.difference(&a));
            prop_assert_eq!(c, b);
        }

        #[test]
        fn difference_is_antisymmetric(a in any_graph(), b in any_graph()) {
            let mut back: Vec<_> = a.difference(&b).iter().map(GraphEvent::reverse).collect();
            back.sort();
            prop_assert_eq!(back, b.difference(&a));
        }
    }

    #[test]
    fn moving_n_objects_gives_2n_entries() {
        let before = graph(&[(0, 1), (0, 1), (1, 2)], &[]);
        let after = graph(&[(3, 1), (3, 1), (0, 2)], &[]);
        assert_eq!(after.difference(&before).len(), 6);
        assert_eq!(before.difference(&before), vec![]);
    }

    #[test]
    fn an_event_reads_as_in_the_paper() {
        let before = graph(&[(0, 1)], &[]);
        let after = graph(&[(1, 1)], &[(0, true)]);
        let text: Vec<_> = after
            .difference(&before)
            .iter()
            .map(ToString::to_string)
            .collect();
        assert_eq!(
            text,
            [
                "-o1_on_r_at_t@r0",
                "+o1_on_r_at_t@r1",
                "r0.door: closed -> open"
            ]
        );
    }
}
