//! Episodes of published tasks: the task file's own task is used where it is given, and what
//! is made of `task_meta.json` alone has the same goal. Reads the data from `REEL_REAL_BENCH`
//! or beside the repository.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use reel_import::ImportOptions;
use reel_world::{DoorState, GraphEvent, Task, WorldGraph};
use serde_json::{Map, Value, json};

use crate::{
    PLAIN,
    fixture::{png, write_json},
    folders, imported, imported_with,
};

#[test]
fn published_tasks_are_found_again_and_succeed() {
    let Some(bench) = reel_vectors::real_bench() else {
        return;
    };
    let (_folder, root, out) = folders();
    let scene = reel_tasks::scene::load(&bench.join("s7_scene.json"))
        .unwrap()
        .scene;
    let tasks: Vec<Arc<Task>> = reel_tasks::load(&bench.join("tasks"), &scene)
        .tasks
        .into_iter()
        .map(Arc::new)
        .collect();
    assert!(tasks.len() > 100, "only {} tasks", tasks.len());
    let scenes = Arc::new(scene.clone()).into();
    let options = ImportOptions {
        tasks: &tasks,
        scenes: Some(&scenes),
        ..PLAIN
    };
    for task in tasks.iter().step_by(9) {
        let folder = play(&root, task);
        let (report, trace) = imported_with(&folder, &out, &options);
        assert_eq!((&*trace.task, &*trace.scene), (&**task, &scene));
        assert_eq!(
            (report.success, &report.losses[..], &report.notes[..]),
            (Some(true), &[][..], &[][..]),
            "{}",
            task.task_id
        );
        let (alone, made) = imported(&folder, &out);
        assert_eq!(
            (alone.success, &alone.notes[..]),
            (Some(true), &[][..]),
            "{}",
            task.task_id
        );
        let identity = |task: &Task| {
            (
                task.task_id.clone(),
                task.family,
                task.target.clone(),
                task.goal_changes(),
            )
        };
        assert_eq!(identity(&made.task), identity(task));
        assert_eq!(made.start.graphs, trace.start.graphs);
    }
}

/// Three steps and the end: the target goes where it shall.
fn play(root: &Path, task: &Task) -> PathBuf {
    let (family, short) = task.task_id.split_once('/').unwrap();
    let folder = root
        .join(&task.scene_id)
        .join(format!("{family}_{short}"))
        .join("m");
    let target = json!({"id": task.target.asset(), "name": task.target, "category": task.target_object().category});
    let meta = json!({"benchmark_task_id": task.task_id, "family": family, "task_id": short, "scene_id": task.scene_id,
        "task_description": task.instruction, "source_furniture": task.src, "destination_furniture": task.dest,
        "target_object": target, "model": "m"});
    let mut graph = task.initial.clone();
    let steps: [(&str, Value, Option<GraphEvent>); 3] = [
        ("navigate_to", json!({"receptacle_name": task.src}), None),
        (
            "pick",
            json!({"marker_id": "1"}),
            Some(GraphEvent::Remove {
                object: task.target.clone(),
                receptacle: task.src.clone(),
            }),
        ),
        (
            "place",
            json!({"marker_id": "1"}),
            Some(GraphEvent::Add {
                object: task.target.clone(),
                receptacle: task.dest.clone(),
            }),
        ),
    ];
    for (number, (tool, args, event)) in steps.into_iter().enumerate() {
        graph.apply(event.as_slice());
        let held = if tool == "pick" {
            json!(task.target)
        } else {
            Value::Null
        };
        let marked = if tool == "pick" {
            json!({"1": task.dest})
        } else {
            json!({"1": task.target})
        };
        let debug_info = json!({"CURRENT_INV": held, "CURRENT_MARKER_MAP": marked, "world_graph": runtime(&graph)});
        write_step(
            &folder,
            number,
            &json!({"tool_name": tool, "args": args}),
            &debug_info,
        );
        fs::write(
            folder.join(format!("step_{number:03}/image_observation_0.png")),
            png(7),
        )
        .unwrap();
    }
    write_step(
        &folder,
        3,
        &json!({"tool_name": "finish", "args": {}}),
        &json!({"world_graph": runtime(&graph)}),
    );
    fs::write(
        folder.join("step_003/textual_observation.txt"),
        "Episode finished. Success: True",
    )
    .unwrap();
    write_json(&folder.join("task_meta.json"), &meta);
    write_json(
        &folder.join("episode_summary.json"),
        &json!({"status": "finished", "success": true, "total_steps": 4}),
    );
    folder
}

fn write_step(folder: &Path, number: usize, call: &Value, debug_info: &Value) {
    let step = folder.join(format!("step_{number:03}"));
    fs::create_dir_all(&step).unwrap();
    write_json(&step.join("tool_call.json"), call);
    write_json(&step.join("debug_info.json"), debug_info);
}

/// A graph as the published server holds it: instances in lists, doors as booleans, no rooms.
fn runtime(graph: &WorldGraph) -> Value {
    let state = |(id, state): (&reel_world::ReceptacleId, &reel_world::ReceptacleState)| {
        let mut entry = json!({"content": graph.objects_on(id)});
        if let Some(door) = state.door {
            entry["door"] = json!(door == DoorState::Open);
        }
        (id.to_string(), entry)
    };
    Value::Object(
        graph
            .receptacles
            .iter()
            .map(state)
            .collect::<Map<String, Value>>(),
    )
}
