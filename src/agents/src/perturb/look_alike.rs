//! What may be taken for the target or its destination, and how a reader would name the mix-up.
//! Never whether it happens.

use rand_chacha::ChaCha8Rng;
use reel_world::{FailureClass, ObjectInstance, Receptacle, ReceptacleId, Scene, Task};

use super::{OperatorKind, Reading};
use crate::random;

/// How a reader names it that this object was taken for the target.
pub fn look_alike(task: &Task, object: &ObjectInstance) -> Reading {
    let target = task.target_object();
    let sub_class = if object.asset == target.asset {
        "wrong_instance"
    } else if object.category == target.category || task.object_distractors.contains(&object.asset)
    {
        "wrong_attribute"
    } else {
        "wrong_kind"
    };
    (FailureClass::ObjectConfusion, sub_class)
}

/// Where the target has to go.
pub(super) fn destination(task: &Task) -> &ReceptacleId {
    task.goal.receptacle_of(&task.target).unwrap_or(&task.dest)
}

/// Another object to take, by the kind of similarity that the operator wants.
pub(super) fn object<'t>(
    kind: OperatorKind,
    task: &'t Task,
    rng: &mut ChaCha8Rng,
) -> Option<&'t ObjectInstance> {
    let target = task.target_object();
    let fits = |object: &&ObjectInstance| {
        let near = object.receptacle == target.receptacle;
        let free = object.instance != task.target
            && object.receptacle != *destination(task)
            && task.goal.receptacle_of(&object.instance) == Some(&object.receptacle);
        let looks_other = object.caption != target.caption || object.category != target.category;
        free && looks_other
            && match kind {
                OperatorKind::SameCategory => object.category == target.category,
                OperatorKind::OtherCategory => object.category != target.category,
                _ => near,
            }
    };
    let found: Vec<&ObjectInstance> = task.objects.iter().filter(fits).collect();
    random::choose(rng, &found).copied()
}

/// Another receptacle to place on, by the kind of similarity that the operator wants.
pub(super) fn receptacle(
    kind: OperatorKind,
    task: &Task,
    scene: &Scene,
    rng: &mut ChaCha8Rng,
) -> Option<ReceptacleId> {
    let dest = scene.receptacle(destination(task))?;
    let source = &task.target_object().receptacle;
    if kind == OperatorKind::BackOnSource {
        return Some(source.clone());
    }
    let alike = |other: &Receptacle| {
        other.category == dest.category || task.dest_distractors.contains(&other.id)
    };
    let mut found: Vec<&Receptacle> = usable(scene)
        .filter(|other| other.id != dest.id && other.id != *source)
        .filter(|other| task.initial.door(&other.id) != Some(reel_world::DoorState::Closed))
        .filter(|other| match kind {
            OperatorKind::SimilarReceptacle => alike(other),
            OperatorKind::UnrelatedReceptacle => !alike(other),
            _ => true,
        })
        .collect();
    if kind == OperatorKind::NearReceptacle {
        let far = |other: &&Receptacle| {
            let [x, y] = [0, 1].map(|axis| other.surface_min[axis] - dest.surface_min[axis]);
            x * x + y * y
        };
        found.sort_by(|a, b| far(a).total_cmp(&far(b)));
        return found.first().map(|found| found.id.clone());
    }
    random::choose(rng, &found).map(|found| found.id.clone())
}

/// How a reader names it that the target was placed there.
pub(super) fn misplacement(task: &Task, scene: &Scene, on: &ReceptacleId) -> Reading {
    let category = |id: &ReceptacleId| scene.receptacle(id).map(|found| found.category.clone());
    let alike = category(on) == category(destination(task)) || task.dest_distractors.contains(on);
    let sub_class = if alike {
        "similar_furniture"
    } else {
        "wrong_receptacle"
    };
    (FailureClass::ObjectConfusion, sub_class)
}

/// The receptacles that one can stand at and put things on.
pub(super) fn usable(scene: &Scene) -> impl Iterator<Item = &Receptacle> {
    scene
        .receptacles
        .iter()
        .filter(|other| scene.is_usable(other))
}
