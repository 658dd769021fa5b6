//! Adds a thing to a task that has nothing to do with it, so that there is something of another
//! kind to be confused with. Never changes what is asked for.

use std::sync::Arc;

use reel_world::{InstanceId, ObjectInstance, Scene, Task};

use super::choices;
use crate::random;

/// The task with one object more, of a category that it does not have, taken with its position from
/// one of the other tasks of its scene, where it stands on a receptacle that is empty here; none
/// where there is no such object.
pub fn cluttered(task: &Task, scene: &Scene, others: &[Arc<Task>], seed: u64) -> Option<Task> {
    let mut rng = random::stream(seed, &format!("clutter/{}", task.task_id), 0);
    let fits = |object: &&ObjectInstance| {
        let known = |mine: &ObjectInstance| {
            mine.category == object.category || mine.receptacle == object.receptacle
        };
        let distractor = task.object_distractors.contains(&object.asset);
        !distractor
            && !task.objects.iter().any(known)
            && object.receptacle != *choices::destination(task)
    };
    let strangers: Vec<&ObjectInstance> = others
        .iter()
        .filter(|other| other.scene_id == task.scene_id)
        .flat_map(|other| &other.objects)
        .filter(fits)
        .collect();
    let mut object = (*random::choose(&mut rng, &strangers)?).clone();
    let name = task.task_id.rsplit('/').next().unwrap_or(&task.task_id);
    object.instance = InstanceId::new(&object.asset, &object.receptacle, name);
    let mut task = task.clone();
    task.initial.add(&object.receptacle, &object.instance);
    task.goal.add(&object.receptacle, &object.instance);
    task.objects.push(object);
    task.objects.sort_by(|a, b| a.instance.cmp(&b.instance));
    debug_assert_eq!(
        task.initial,
        Task::initial_graph(scene, &task.objects),
        "the graph is that of the objects"
    );
    Some(task)
}
