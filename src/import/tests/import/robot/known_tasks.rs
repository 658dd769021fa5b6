//! Episodes of tasks and scenes that are known: success by the graphs, poses in the scene's frame.

use std::sync::Arc;

use serde_json::Value;

use super::*;

fn start_of_a_known_task() -> Value {
    json!({"event": "start", "task_id": "FDP/apple", "source_furniture": "table_1", "destination_furniture": "fridge_0",
        "target_object": {"name": APPLE, "id": "_a1", "category": "apple"}})
}

#[test]
fn a_task_that_is_known_is_judged_by_the_graphs() {
    let place = Place::new();
    let mut messages = episode();
    messages[2].value = start_of_a_known_task();
    messages.last_mut().unwrap().value = json!({"event": "end", "success": false});
    let (recording, trace) = place.said(&messages);
    assert_eq!(recording.episodes[0].success, Some(true));
    assert_eq!(
        recording.episodes[0].notes[1..],
        [
            "nothing tells which objects fit the task's words, and from step 3 on the reward for asking depends on it: the total is a lower bound; --tasks gives the task's own file",
            "the recording says success false, the graphs true"
        ]
    );
    assert_eq!(trace.task.target.as_str(), APPLE);

    // Its file goes before what the recording says, and is the one of recordings that name none.
    let task = Arc::new(reel_world::Task {
        instruction: "As it is in the file.".into(),
        ..reel_world::Task::clone(&trace.task)
    });
    let (tasks, path) = ([task], place.path("said.mcap"));
    let scenes = trace.scene.clone().into();
    let options = ImportOptions {
        tasks: &tasks,
        scenes: Some(&scenes),
        ..PLAIN
    };
    let (_, traces) = place.import_by(MAPPING, &path, &options);
    assert_eq!(traces[0].task.instruction, "As it is in the file.");
    messages.remove(2);
    bags::write(&path, &messages, Encoding::Json);
    let (recording, traces) = place.import_by(MAPPING, &path, &options);
    assert_eq!(
        (
            traces[0].task.instruction.as_str(),
            recording.episodes[0].success
        ),
        ("As it is in the file.", Some(true))
    );
}

#[test]
fn poses_are_brought_into_the_frame_of_the_scene() {
    let place = Place::new();
    let mut messages = episode();
    messages[2].value = start_of_a_known_task();
    let (_, plain) = place.said(&messages);
    let mut scene = reel_world::Scene::clone(&plain.scene);
    let centres = [[1.0, 2.0], [4.0, 2.5]];
    for (receptacle, [x, y]) in scene.receptacles.iter_mut().zip(centres) {
        receptacle.surface_min = [x - 0.5, y - 0.3, 0.7];
        receptacle.surface_max = [x + 0.5, y + 0.3, 0.7];
    }
    let (yaw, shift) = (0.6_f64, [-3.0, 1.5]);
    let moved = |[x, y]: [f64; 2]| {
        let (sine, cosine) = yaw.sin_cos();
        [
            cosine * x - sine * y + shift[0],
            sine * x + cosine * y + shift[1],
        ]
    };
    // The map is the scene, moved back; each receptacle is 5 cm off, one outwards and one inwards.
    let back = |[x, y]: [f64; 2]| {
        let [x, y] = [x - shift[0], y - shift[1]];
        let (sine, cosine) = yaw.sin_cos();
        [cosine * x + sine * y, -sine * x + cosine * y]
    };
    let between = [centres[1][0] - centres[0][0], centres[1][1] - centres[0][1]];
    let length = between[0].hypot(between[1]);
    let off = between.map(|axis| 0.05 * axis / length);
    let shown = [
        back([centres[0][0] - off[0], centres[0][1] - off[1]]),
        back([centres[1][0] + off[0], centres[1][1] + off[1]]),
    ];
    let ids: Vec<String> = scene
        .receptacles
        .iter()
        .map(|it| it.id.to_string())
        .collect();
    let map = json!({&ids[0]: shown[0], &ids[1]: {"position": {"x": shown[1][0], "y": shown[1][1]}}, "sofa_9": [0, 0]});
    messages.insert(0, said(0, "/map", json!({"data": map.to_string()})));
    let path = place.path("said.mcap");
    bags::write(&path, &messages, Encoding::Json);
    let mapping = format!("{MAPPING}\"/map\" = {{ is = \"map\" }}\n");
    let task = reel_world::Task {
        scene_id: scene.scene_id.clone(),
        ..reel_world::Task::clone(&plain.task)
    };
    let (tasks, scenes) = ([Arc::new(task)], Arc::new(scene).into());
    let options = ImportOptions {
        tasks: &tasks,
        scenes: Some(&scenes),
        ..PLAIN
    };
    let (recording, traces) = place.import_by(&mapping, &path, &options);
    let notes = recording.episodes[0].notes.join("\n");
    let wanted = "laid over the scene by 2 receptacles: turned by 34.4 degrees, moved by -3.00 m, 1.50 m; left over: 0.050 m root mean square";
    assert!(notes.contains(wanted), "{notes}");
    let settings = &traces[0].header.policy.parameters["map_alignment"];
    assert!((settings["rmse_m"].as_f64().unwrap() - 0.05).abs() < 1e-9);
    let near = |a: f64, b: f64| (a - b).abs() < 1e-6;
    assert!(!plain.robot.odometry.is_empty());
    for (before, after) in plain.robot.odometry.iter().zip(&traces[0].robot.odometry) {
        let [x, y] = moved([before.x, before.y]);
        assert!(near(after.x, x) && near(after.y, y), "{before:?} {after:?}");
        assert!(near((after.yaw - before.yaw - yaw).sin(), 0.0));
    }
    for (before, after) in plain.steps.iter().zip(&traces[0].steps) {
        assert_eq!(before.robot.path_length_m, after.robot.path_length_m);
        let [x, y] = moved(before.robot.base.map(f64::from));
        assert!((f64::from(after.robot.base[0]) - x).abs() < 1e-4);
        assert!((f64::from(after.robot.base[1]) - y).abs() < 1e-4);
    }
    // A map that stays farther from the scene than is allowed is of another place: nothing is moved.
    let strict = format!("map_error_max_m = 0.01\n{mapping}");
    let (recording, traces) = place.import_by(&strict, &path, &options);
    let notes = recording.episodes[0].notes.join("\n");
    assert!(
        notes.contains("map does not fit the scene: its 2 receptacles stay 0.05 m"),
        "{notes}"
    );
    assert_eq!(traces[0].robot.odometry, plain.robot.odometry);
    assert_eq!(
        traces[0].header.policy.parameters["map_alignment"]["used"],
        false
    );
    // Without two receptacles of the scene nothing is moved, and it is said.
    let (recording, traces) = place.import_by(&mapping, &path, &PLAIN);
    let notes = recording.episodes[0].notes.join("\n");
    assert!(
        notes.contains("the scene of the episode is not known"),
        "{notes}"
    );
    assert_eq!(traces[0].robot.odometry, plain.robot.odometry);
}
