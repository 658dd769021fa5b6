//! What an agent could mistake for the target or its destination in a task, by kind of fault.
//! Never whether it does.

use reel_world::{DoorState, ObjectInstance, Receptacle, ReceptacleId, Scene, Task};

use super::{FaultKind, InjectionError};

/// The objects that could be taken by a fault of this kind.
pub(super) fn wrong_objects(
    kind: FaultKind,
    task: &Task,
) -> Result<Vec<&ObjectInstance>, InjectionError> {
    let social = matches!(
        kind,
        FaultKind::IgnoredAnswer | FaultKind::MissingAsk | FaultKind::ClaimedAnswer
    );
    match (social, task.fuzzy) {
        (true, false) => return Err(InjectionError::Precise { kind }),
        (false, true) => return Err(InjectionError::Underspecified { kind }),
        _ => {}
    }
    let target = task.target_object();
    let fits = |object: &&ObjectInstance| {
        let here = object.receptacle == target.receptacle;
        match kind {
            FaultKind::WrongAttribute | FaultKind::WrongInstance | FaultKind::WrongKind => {
                mistake(task, object) == kind
            }
            FaultKind::StaleWrongObject => here,
            _ => here && mistake(task, object) == FaultKind::WrongAttribute,
        }
    };
    let at_destination =
        |object: &ObjectInstance| task.goal.receptacle_of(&task.target) == Some(&object.receptacle);
    let stays = |object: &ObjectInstance| !task.moves(object);
    let others = task.objects.iter().filter(|object| {
        object.instance != task.target && !at_destination(object) && stays(object)
    });
    let found: Vec<&ObjectInstance> = others.filter(fits).collect();
    if found.is_empty() {
        Err(InjectionError::NoObject { kind })
    } else {
        Ok(found)
    }
}

/// Which mistake it is to take this object for the target.
pub(super) fn mistake(task: &Task, object: &ObjectInstance) -> FaultKind {
    let target = task.target_object();
    if object.asset == target.asset {
        FaultKind::WrongInstance
    } else if object.category == target.category || task.object_distractors.contains(&object.asset)
    {
        FaultKind::WrongAttribute
    } else {
        FaultKind::WrongKind
    }
}

/// The receptacles that the target could be put on by a fault of this kind.
pub(super) fn wrong_receptacles(
    kind: FaultKind,
    task: &Task,
    scene: &Scene,
) -> Result<Vec<ReceptacleId>, InjectionError> {
    let destination = destination(task);
    let category = scene
        .receptacle(destination)
        .map(|receptacle| receptacle.category.as_str());
    let alike = |receptacle: &Receptacle| {
        Some(receptacle.category.as_str()) == category
            || task.dest_distractors.contains(&receptacle.id)
    };
    let wanted = kind == FaultKind::SimilarFurniture;
    let size = task.target_object().size;
    let others = usable(scene)
        .filter(|other| other.id != *destination && other.id != task.target_object().receptacle);
    let found: Vec<ReceptacleId> = others
        .filter(|other| alike(other) == wanted && has_room(other, size))
        .map(|other| other.id.clone())
        .collect();
    if found.is_empty() {
        Err(InjectionError::NoReceptacle {
            kind,
            destination: destination.clone(),
        })
    } else {
        Ok(found)
    }
}

/// The receptacles that one can stand at and put things on.
pub(super) fn usable(scene: &Scene) -> impl Iterator<Item = &Receptacle> {
    scene
        .receptacles
        .iter()
        .filter(|other| scene.is_usable(other))
}

/// Where the target has to go.
pub(super) fn destination(task: &Task) -> &ReceptacleId {
    task.goal.receptacle_of(&task.target).unwrap_or(&task.dest)
}

/// Whether a receptacle is closed at the start.
pub(super) fn is_closed(task: &Task, id: &ReceptacleId) -> bool {
    task.initial.door(id) == Some(DoorState::Closed)
}

fn has_room(receptacle: &Receptacle, size: [f64; 3]) -> bool {
    (0..2).all(|axis| receptacle.surface_max[axis] - receptacle.surface_min[axis] >= size[axis])
}
