//! A perfect eye: what a policy would read from the image and the text of its last call. It turns
//! the identifiers of a record into categories and captions, and never lets one through.

use std::collections::BTreeSet;

use reel_world::{
    Attributes, InstanceId, ReceptacleId, Scene, Task, WorldGraph,
    record::{Marker, MarkerTarget, StartRecord, StepRecord},
};

use crate::PerceivedItem;

/// What is in view before the first decision.
pub fn at_start(task: &Task, scene: &Scene, start: &StartRecord) -> Vec<PerceivedItem> {
    let visible: Vec<&InstanceId> = start.visible.iter().map(|object| &object.object).collect();
    see(task, scene, &start.graphs.physics, &[], &visible)
}

/// What is in view, numbered or told of after a step; `graph` is where physics
/// says the objects are.
pub fn after_step(
    task: &Task,
    scene: &Scene,
    graph: &WorldGraph,
    step: &StepRecord,
) -> Vec<PerceivedItem> {
    let objects: Vec<&InstanceId> = step
        .visible
        .iter()
        .map(|object| &object.object)
        .chain(&step.listed)
        .collect();
    see(task, scene, graph, &step.markers, &objects)
}

fn see(
    task: &Task,
    scene: &Scene,
    graph: &WorldGraph,
    markers: &[Marker],
    objects: &[&InstanceId],
) -> Vec<PerceivedItem> {
    let mut seen = Vec::new();
    let mut numbered = BTreeSet::new();
    for marker in markers {
        match &marker.target {
            MarkerTarget::Object(id) => {
                numbered.insert(id);
                seen.extend(object(task, graph, id, Some(marker.id)));
            }
            MarkerTarget::Receptacle(id) => seen.extend(receptacle(task, scene, id, marker.id)),
        }
    }
    let others: BTreeSet<&InstanceId> = objects
        .iter()
        .copied()
        .filter(|id| !numbered.contains(id))
        .collect();
    seen.extend(
        others
            .into_iter()
            .filter_map(|id| object(task, graph, id, None)),
    );
    seen
}

fn object(
    task: &Task,
    graph: &WorldGraph,
    id: &InstanceId,
    marker: Option<u32>,
) -> Option<PerceivedItem> {
    let known = task.object(id)?;
    Some(PerceivedItem {
        marker,
        furniture: false,
        category: known.category.clone(),
        caption: known.caption.clone(),
        attributes: known.attributes.clone(),
        receptacle_hint: graph.receptacle_of(id).cloned(),
        object: task
            .objects
            .iter()
            .position(|object| object.instance == *id)
            .and_then(|index| index.try_into().ok()),
    })
}

fn receptacle(task: &Task, scene: &Scene, id: &ReceptacleId, marker: u32) -> Option<PerceivedItem> {
    let known = scene.receptacle(id)?;
    let instruction = task.instruction.to_lowercase();
    let told = known
        .captions
        .keys()
        .find(|caption| instruction.contains(&caption.to_lowercase()));
    Some(PerceivedItem {
        marker: Some(marker),
        furniture: true,
        category: known.category.clone(),
        caption: told
            .map(String::as_str)
            .or(known.main_caption())
            .map(str::to_owned),
        attributes: Attributes::new(),
        receptacle_hint: Some(id.clone()),
        object: None,
    })
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn what_is_seen_has_words_and_numbers_but_no_identifier_of_an_object() {
        let receptacle = json!({"id": "table_1", "room": "room", "category": "table", "surface_min": [0.0, 0.0, 0.0],
            "surface_max": [1.0, 1.0, 0.7], "captions": {"the big table": 9.0, "the oak table": 1.0}});
        let scene: Scene = serde_json::from_value(
            json!({"scene_id": "flat", "rooms": [], "receptacles": [receptacle]}),
        )
        .unwrap();
        let object = |name: &str| {
            json!({"instance": format!("{name}_on_table_1_at_t"), "asset": name, "category": "apple", "caption": format!("{name} apple"),
                   "size": [0.1, 0.1, 0.1], "position": [0.0, 0.0, 0.0], "receptacle": "table_1"})
        };
        let task = json!({"task_id": "t", "family": "FDP", "scene_id": "flat", "instruction": "Go to the Oak table.",
            "precise_instruction": "", "objects": [object("red"), object("green")], "initial": {}, "goal": {},
            "target": "red_on_table_1_at_t", "src": "table_1", "dest": "table_1"});
        let mut task: Task = serde_json::from_value(task).unwrap();
        task.initial = Task::initial_graph(&scene, &task.objects);
        let markers = [
            Marker {
                id: 4,
                target: MarkerTarget::Object("red_on_table_1_at_t".into()),
            },
            Marker {
                id: 5,
                target: MarkerTarget::Receptacle("table_1".into()),
            },
        ];
        let visible: [InstanceId; 2] =
            ["red_on_table_1_at_t".into(), "green_on_table_1_at_t".into()];
        let seen = see(
            &task,
            &scene,
            &task.initial,
            &markers,
            &[&visible[0], &visible[1]],
        );
        let told: Vec<_> = seen
            .iter()
            .map(|thing| {
                (
                    thing.marker,
                    thing.furniture,
                    thing.caption.as_deref().unwrap(),
                )
            })
            .collect();
        assert_eq!(
            told,
            [
                (Some(4), false, "red apple"),
                (Some(5), true, "the oak table"),
                (None, false, "green apple")
            ]
        );
        assert!(!format!("{seen:?}").contains("_on_"));
    }
}
