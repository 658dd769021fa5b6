//! Invariants by name: pure predicates that tests and production call alike.

use std::{collections::BTreeMap, fmt};

use crate::{
    InstanceId, Scene, Task, WorldGraph,
    record::{Marker, MarkerTarget},
};

/// What an invariant is checked on.
#[derive(Clone, Copy)]
pub struct InvariantInput<'a> {
    /// The scene whose receptacles and doors the graph must match.
    pub scene: &'a Scene,
    /// The task whose objects must be conserved.
    pub task: &'a Task,
    /// World graph of one authority, physics or registry.
    pub graph: &'a WorldGraph,
    /// What the gripper holds.
    pub held: Option<&'a InstanceId>,
    /// The current marker map: each marker with what it stands for.
    pub markers: &'a [Marker],
}

/// An invariant that does not hold, with the reason.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("invariant {name} broken: {detail}")]
pub struct Violation {
    /// Name of the invariant that does not hold.
    pub name: &'static str,
    /// What contradicts the invariant, in words.
    pub detail: String,
}

/// A named predicate over the world's state at one moment.
#[derive(Clone, Copy)]
pub struct Invariant {
    /// Its name, as in messages and documents.
    pub name: &'static str,
    check: fn(&InvariantInput<'_>) -> Result<(), String>,
}

impl fmt::Debug for Invariant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

/// All five invariants, in the order in which they are checked.
pub const ALL: [Invariant; 5] = [
    Invariant {
        name: "objects_are_conserved",
        check: objects_are_conserved,
    },
    Invariant {
        name: "held_object_is_in_no_receptacle",
        check: held_object_is_in_no_receptacle,
    },
    Invariant {
        name: "receptacles_are_the_scenes",
        check: receptacles_are_the_scenes,
    },
    Invariant {
        name: "doors_only_where_the_scene_has_them",
        check: doors_only_where_the_scene_has_them,
    },
    Invariant {
        name: "markers_are_unique_and_known",
        check: markers_are_unique_and_known,
    },
];

/// Checks all invariants.
///
/// # Errors
/// The first violation.
pub fn check(moment: &InvariantInput<'_>) -> Result<(), Violation> {
    ALL.iter().try_for_each(|invariant| {
        (invariant.check)(moment).map_err(|detail| Violation {
            name: invariant.name,
            detail,
        })
    })
}

fn objects_are_conserved(moment: &InvariantInput<'_>) -> Result<(), String> {
    let mut count: BTreeMap<&InstanceId, i64> = BTreeMap::new();
    for object in &moment.task.objects {
        *count.entry(&object.instance).or_default() += 1;
    }
    for state in moment.graph.receptacles.values() {
        for (object, here) in &state.content {
            *count.entry(object).or_default() -= i64::from(*here);
        }
    }
    if let Some(held) = moment.held {
        *count.entry(held).or_default() -= 1;
    }
    match count.into_iter().find(|(_, left)| *left != 0) {
        None => Ok(()),
        Some((object, left)) if left > 0 => Err(format!("{object} is nowhere")),
        Some((object, left)) => Err(format!("{object} is there {} times too often", -left)),
    }
}

fn held_object_is_in_no_receptacle(moment: &InvariantInput<'_>) -> Result<(), String> {
    match moment
        .held
        .and_then(|held| moment.graph.receptacle_of(held).map(|place| (held, place)))
    {
        None => Ok(()),
        Some((held, place)) => Err(format!("{held} is held and on {place}")),
    }
}

fn receptacles_are_the_scenes(moment: &InvariantInput<'_>) -> Result<(), String> {
    let unknown = moment
        .graph
        .receptacles
        .keys()
        .find(|id| id.as_str() != crate::FLOOR && moment.scene.receptacle(id).is_none());
    match unknown {
        None => Ok(()),
        Some(id) => Err(format!("{id} is not a receptacle of the scene")),
    }
}

fn doors_only_where_the_scene_has_them(moment: &InvariantInput<'_>) -> Result<(), String> {
    for receptacle in &moment.scene.receptacles {
        let in_graph = moment.graph.door(&receptacle.id).is_some();
        if in_graph != receptacle.door.exists() {
            return Err(format!(
                "{}: door in the scene: {}, in the graph: {in_graph}",
                receptacle.id,
                receptacle.door.exists()
            ));
        }
    }
    Ok(())
}

fn markers_are_unique_and_known(moment: &InvariantInput<'_>) -> Result<(), String> {
    for (index, marker) in moment.markers.iter().enumerate() {
        if moment.markers[..index]
            .iter()
            .any(|other| other.id == marker.id)
        {
            return Err(format!("marker {} stands twice in the map", marker.id));
        }
        let known = match &marker.target {
            MarkerTarget::Object(object) => moment.task.object(object).is_some(),
            MarkerTarget::Receptacle(receptacle) => moment.scene.receptacle(receptacle).is_some(),
        };
        if !known {
            return Err(format!(
                "marker {} stands for something unknown: {:?}",
                marker.id, marker.target
            ));
        }
    }
    Ok(())
}
