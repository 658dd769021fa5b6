//! Rows of the tables of tasks and scenes.

use super::*;

#[derive(Serialize)]
pub(super) struct TaskRow<'a> {
    task_id: &'a str,
    task_digest: String,
    family: &'static str,
    task_type: Option<&'a str>,
    scene_id: &'a str,
    instruction: &'a str,
    precise_instruction: &'a str,
    fuzzy: bool,
    purpose: Option<&'a str>,
    target: &'a str,
    target_category: &'a str,
    src: &'a str,
    dest: &'a str,
    src_door: Option<String>,
    dest_door: Option<String>,
    src_distractors: Vec<&'a str>,
    dest_distractors: Vec<&'a str>,
    object_distractors: Vec<&'a str>,
    goal_changes: Vec<String>,
    object_count: usize,
    objects: Vec<ObjectRow<'a>>,
    task: String,
}

pub(super) fn task_row(task: &Task) -> TaskRow<'_> {
    let document = canonical_json(task);
    TaskRow {
        task_id: &task.task_id,
        task_digest: Digest::of(document.as_bytes()).to_string(),
        family: task.family.as_str(),
        task_type: task.task_type.as_deref(),
        scene_id: &task.scene_id,
        instruction: &task.instruction,
        precise_instruction: &task.precise_instruction,
        fuzzy: task.fuzzy,
        purpose: task.purpose.as_deref(),
        target: task.target.as_str(),
        target_category: task
            .object(&task.target)
            .map_or("", |object| &object.category),
        src: task.src.as_str(),
        dest: task.dest.as_str(),
        src_door: door(&task.initial, &task.src),
        dest_door: door(&task.initial, &task.dest),
        src_distractors: task.src_distractors.iter().map(|id| id.as_str()).collect(),
        dest_distractors: task.dest_distractors.iter().map(|id| id.as_str()).collect(),
        object_distractors: task
            .object_distractors
            .iter()
            .map(|id| id.as_str())
            .collect(),
        goal_changes: task
            .goal_changes()
            .iter()
            .map(ToString::to_string)
            .collect(),
        object_count: task.objects.len(),
        objects: objects(task),
        task: document,
    }
}

pub(crate) fn door(graph: &WorldGraph, receptacle: &ReceptacleId) -> Option<String> {
    graph.door(receptacle).map(|door| door.to_string())
}

#[derive(Serialize)]
pub(super) struct ObjectRow<'a> {
    instance: &'a str,
    asset: &'a str,
    category: &'a str,
    caption: Option<&'a str>,
    attributes: Vec<AttributeWord<'a>>,
    width_m: f64,
    depth_m: f64,
    height_m: f64,
    receptacle: &'a str,
    role: &'static str,
}

#[derive(Serialize)]
pub(super) struct AttributeWord<'a> {
    kind: &'a str,
    word: &'a str,
}

pub(super) fn objects(task: &Task) -> Vec<ObjectRow<'_>> {
    task.objects
        .iter()
        .map(|object| ObjectRow {
            instance: object.instance.as_str(),
            asset: object.asset.as_str(),
            category: &object.category,
            caption: object.caption.as_deref(),
            attributes: object
                .attributes
                .iter()
                .flat_map(|(kind, words)| {
                    words.iter().map(move |word| AttributeWord { kind, word })
                })
                .collect(),
            width_m: object.size[0],
            depth_m: object.size[1],
            height_m: object.size[2],
            receptacle: object.receptacle.as_str(),
            role: role(task, &object.instance),
        })
        .collect()
}

#[derive(Serialize)]
pub(super) struct SceneRow<'a> {
    scene_digest: String,
    scene_id: &'a str,
    rooms: Vec<&'a str>,
    receptacles: Vec<ReceptacleRow<'a>>,
    scene: String,
}

#[derive(Serialize)]
pub(super) struct ReceptacleRow<'a> {
    receptacle: &'a str,
    category: &'a str,
    room: &'a str,
    has_door: bool,
    placeable: bool,
    captions: Vec<&'a str>,
}

pub(super) fn scene_row(scene: &Scene) -> SceneRow<'_> {
    let document = canonical_json(scene);
    SceneRow {
        scene_digest: Digest::of(document.as_bytes()).to_string(),
        scene_id: &scene.scene_id,
        rooms: scene.rooms.iter().map(|room| room.name.as_str()).collect(),
        receptacles: scene
            .receptacles
            .iter()
            .map(|receptacle| ReceptacleRow {
                receptacle: receptacle.id.as_str(),
                category: &receptacle.category,
                room: &receptacle.room,
                has_door: receptacle.door.exists(),
                placeable: receptacle.placeable,
                captions: receptacle.captions.keys().map(String::as_str).collect(),
            })
            .collect(),
        scene: document,
    }
}

/// An enum of ours as the word it has in JSON.
pub(crate) fn name_of<T: Serialize>(value: &T) -> Value {
    serde_json::to_value(value).expect("an enum of ours is a JSON string")
}
