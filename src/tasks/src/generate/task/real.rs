//! Tasks in the schema of REAL-Bench and nothing but it (docs/spec.md#real-bench): what published
//! code can read. `crate::yaml` writes more, so that nothing of a task is lost; here it is left
//! out, and what published files have besides is made up.

use std::collections::BTreeMap;

use crate::{real_proc, yaml};
use reel_world::{Family, Scene, Task};
use serde_json::{Value, json};

/// The task as the text of a REAL-Bench file; none where the schema cannot say it:
/// it moves one object.
///
/// `index` numbers the tasks of a set. There are no USD files: the paths are where published code
/// would look for them.
pub fn write(task: &Task, scene: &Scene, index: usize) -> Option<String> {
    if task.goal_changes().len() != 2 {
        return None;
    }
    let (task, scene) = (published(task, scene, index), without_doors(task, scene));
    Some(yaml::write(&task, &scene))
}

/// The task with the fields of published files, and without those of our own.
fn published(task: &Task, scene: &Scene, index: usize) -> Task {
    let mut task = task.clone();
    let articulated = task.family == Family::FDO;
    task.task_type = task.task_type.filter(|_| articulated);
    for object in &mut task.objects {
        // What the caption does not say, published files do not say.
        object.attributes = object
            .caption
            .as_deref()
            .map(crate::attributes::from_caption)
            .unwrap_or_default();
        if articulated {
            object.caption = None;
            object.attributes.clear();
        }
    }
    let kept = without_doors(&task, scene);
    if let Some(Value::Object(goal)) = &mut task.published_goal {
        goal.retain(|id, _| kept.receptacle(&id.as_str().into()).is_some());
    }
    let mut extra: BTreeMap<String, Value> = BTreeMap::new();
    extra.insert("paths".to_owned(), real_proc::paths(&task.scene_id));
    for object in &task.objects {
        let usd = format!("{}.usd", object.asset);
        extra.insert(
            format!("objects.{}.usd_path", object.instance),
            json!(format!("${{MESATASK_USD_ROOT}}/{usd}")),
        );
        extra.insert(
            format!("objects.{}.usd_scale", object.instance),
            json!([1.0, 1.0, 1.0]),
        );
        let distracts = task.object_distractors.contains(&object.asset);
        for meta in [
            ("obj_meta", object.instance == task.target),
            ("obj_distractor_meta", distracts),
        ] {
            if let (section, true) = meta {
                extra.insert(
                    format!("episodes[0].{section}.{}.usd_path", object.asset),
                    json!(usd),
                );
            }
        }
    }
    for key in ["episode_idx", "original_idx", "global_index"] {
        extra.insert(format!("episodes[0].{key}"), json!(index));
    }
    if let Some(purpose) = &task.purpose {
        extra.insert(
            "episodes[0].purpose_group".to_owned(),
            json!(real_proc::purpose_group(purpose)),
        );
    }
    task.extra = extra;
    task
}

/// The scene as the graphs of a family have it: only FDO knows furniture with doors.
fn without_doors(task: &Task, scene: &Scene) -> Scene {
    let mut scene = scene.clone();
    scene
        .receptacles
        .retain(|receptacle| task.family == Family::FDO || !receptacle.door.exists());
    scene
}
