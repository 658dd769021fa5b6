//! A checkout of the published benchmark: its scene is rebuilt from its placements, and what
//! is broken is named.

use std::{collections::BTreeMap, fs};

use reel_tasks::{SceneSource, TaskError, real_bench::Checkout};
use reel_world::{Receptacle, Rect, Scene};
use serde_json::{Value, json};

use reel_vectors::checkout;

#[test]
fn every_published_task_loads_in_the_scene_that_the_placements_prove() {
    let Some(data) = reel_vectors::real_bench() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    checkout::write(&data, folder.path(), 1);
    let checkout = Checkout::read(folder.path()).unwrap();
    assert!(checkout.broken.is_empty(), "{:#?}", checkout.broken);
    assert!(checkout.complaints.is_empty(), "{:#?}", checkout.complaints);
    let scene_ids: Vec<&str> = checkout.scene_ids().into_iter().collect();
    let [scene_id] = scene_ids[..] else {
        panic!("{scene_ids:?}")
    };
    let rebuilt = checkout.rebuild(scene_id).unwrap();
    let report = checkout.load(&rebuilt.scene);
    assert!(report.broken.is_empty(), "{:#?}", report.broken);
    assert_eq!(report.tasks.len(), 180);
    assert_eq!(
        checkout.rebuild(scene_id).unwrap().text,
        rebuilt.text,
        "equal files, equal bytes"
    );
    assert!(
        crate::scenes::schema().is_valid(&serde_json::from_str(&rebuilt.text).unwrap()),
        "a scene file like any other"
    );
    assert_eq!(rebuilt.warnings, Vec::<String>::new());

    for task in &report.tasks {
        for object in &task.objects {
            let Rect { min, max } = rebuilt
                .scene
                .receptacle(&object.receptacle)
                .unwrap()
                .surface_rect();
            let inside = (0..2).all(|axis| {
                object.position[axis] - object.size[axis] / 2.0 >= min[axis]
                    && object.position[axis] + object.size[axis] / 2.0 <= max[axis]
            });
            assert!(
                inside,
                "{}: {} reaches out of {}",
                task.task_id, object.instance, object.receptacle
            );
        }
    }
    // Beside the scene that was reconstructed by hand from the same data.
    let by_hand = reel_tasks::scene::load(&data.join("s7_scene.json"))
        .unwrap()
        .scene;
    let facts = |scene: &Scene| -> BTreeMap<String, (String, String, bool)> {
        let of = |r: &Receptacle| {
            (
                r.id.to_string(),
                (r.room.clone(), r.category.clone(), r.door.exists()),
            )
        };
        scene.receptacles.iter().map(of).collect()
    };
    assert_eq!(
        facts(&rebuilt.scene),
        facts(&by_hand),
        "the same receptacles, rooms and doors"
    );
    let mut unproven = Vec::new();
    for evidence in &rebuilt.evidence {
        let id = evidence.receptacle.as_str().into();
        let (ours, theirs) = (
            rebuilt.scene.receptacle(&id).unwrap(),
            by_hand.receptacle(&id).unwrap(),
        );
        if evidence.placements == 0 {
            unproven.push(evidence.receptacle.as_str());
            continue;
        }
        assert!(
            (ours.surface_height() - theirs.surface_height()).abs() < 1e-9,
            "{id}: {} m",
            ours.surface_height()
        );
        let (ours, theirs) = (ours.surface_rect(), theirs.surface_rect());
        let off = (0..2).map(|axis| {
            (ours.min[axis] - theirs.min[axis])
                .abs()
                .max((ours.max[axis] - theirs.max[axis]).abs())
        });
        assert!(
            off.fold(0.0, f64::max) < 1e-3,
            "{id}: {ours:?} beside {theirs:?}"
        );
    }
    assert_eq!(
        unproven,
        ["washingmachine_1", "sink_0", "sink_1"],
        "nothing is placed on these"
    );
    assert_eq!(
        captions(&rebuilt.scene),
        captions(&by_hand),
        "receptacles are called what instructions call them"
    );
}

fn captions(scene: &Scene) -> BTreeMap<String, Vec<String>> {
    scene
        .receptacles
        .iter()
        .map(|r| (r.id.to_string(), r.captions.keys().cloned().collect()))
        .collect()
}

#[test]
fn the_order_of_receptacles_is_that_of_the_files() {
    let Some(data) = reel_vectors::real_bench() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    checkout::write(&data, folder.path(), 9);
    let checkout = Checkout::read(folder.path()).unwrap();
    let scene = checkout
        .rebuild(checkout.scene_ids().first().unwrap())
        .unwrap()
        .scene;
    let order: Vec<&str> = scene
        .receptacles
        .iter()
        .map(|receptacle| receptacle.id.as_str())
        .collect();
    let expected = "table_1 couch_2 table_2 desk_1 cabinet_6 cabinet_7 washingmachine_1 bed_1 cabinet_8 desk_2 cabinet_9 bed_2 \
                    cabinet_10 sink_0 sink_1 potlid_0 pot_0 electriccooker_0";
    assert_eq!(order, expected.split_whitespace().collect::<Vec<_>>());
    let rooms: Vec<&str> = scene.rooms.iter().map(|room| room.name.as_str()).collect();
    assert_eq!(
        rooms[0], "dinning room/0",
        "rooms come in the order of their first receptacle: {rooms:?}"
    );
}

#[test]
fn what_the_server_tells_of_a_task_survives_loading() {
    let Some(data) = reel_vectors::real_bench() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    checkout::write(&data, folder.path(), 5);
    let checkout = Checkout::read(folder.path()).unwrap();
    let scene = checkout
        .rebuild(checkout.scene_ids().first().unwrap())
        .unwrap()
        .scene;
    let report = checkout.load(&scene);
    for (file, task) in checkout.files.iter().zip(&report.tasks) {
        let text = fs::read_to_string(&file.path).unwrap();
        let has = |field: &str| text.contains(field);
        let kept = |key: &str| {
            task.extra
                .keys()
                .any(|path| path.starts_with(&format!("episodes[0].{key}")))
        };
        for key in [
            "global_index",
            "episode_idx",
            "original_idx",
            "purpose_group",
            "obj_meta",
            "obj_distractor_meta",
        ] {
            let empty = has(&format!("\n  {key}: {{}}\n"));
            assert_eq!(
                kept(key),
                has(&format!("\n  {key}:")) && !empty,
                "{}: {key}",
                task.task_id
            );
        }
        for distractor in &task.object_distractors {
            assert!(
                kept(&format!("obj_distractor_meta.{distractor}")),
                "{}: {distractor}",
                task.task_id
            );
        }
        // The order of placements is the order of their lines.
        let placements = &text[text.find("\n  placements:").unwrap()..];
        let lines: Vec<usize> = task
            .placement_order()
            .into_iter()
            .map(|index| {
                placements
                    .find(&format!("\n    {}:", task.objects[index].instance))
                    .unwrap()
            })
            .collect();
        assert!(lines.is_sorted(), "{}: {lines:?}", task.task_id);
    }
}

#[test]
fn broken_files_are_named_and_the_rest_loads() {
    let folder = tempfile::tempdir().unwrap();
    let benchmark = folder.path().join("benchmark");
    let counts = BTreeMap::from([("FDP".to_owned(), 3)]);
    let write = |path: &str, text: &str| {
        let path = benchmark.join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    };
    write("manifest.yaml", &checkout::manifest(&counts, 1));
    write("mesa_required.txt", "mug.usd\n");
    write("tasks/FDP/one.yaml", &task("one", 0).to_string());
    let mut other_scene = task("two", 1);
    other_scene["paths"]["scene_usd"] = json!("elsewhere.usd");
    write("tasks/FDP/two.yaml", &other_scene.to_string());
    write("tasks/FDP/three.yaml", "scene_id: house\nepisodes: [\n");
    let checkout = Checkout::read(folder.path()).unwrap();
    assert_eq!(checkout.files.len(), 1);
    let inside = |errors: &[TaskError]| -> Vec<String> {
        let root = format!("{}/", benchmark.display());
        errors
            .iter()
            .map(|error| error.to_string().replace(&root, ""))
            .collect()
    };
    assert_eq!(
        inside(&checkout.broken),
        [
            "tasks/FDP/three.yaml:3: while parsing a node, did not find expected node content",
            "tasks/FDP/two.yaml:1: paths.scene_usd: expected assets/scenes/house_usd/scene.usd, found elsewhere.usd",
        ]
    );
    assert_eq!(
        inside(&checkout.complaints),
        ["manifest.yaml: family_counts.FDP is 3, but 1 good task files are there"]
    );

    // The rebuilt scene of the one good task: a table that carries its mug, a sink of
    // which nothing is known.
    let rebuilt = checkout.rebuild("house").unwrap();
    assert_eq!(checkout.load(&rebuilt.scene).tasks.len(), 1);
    let table = rebuilt.scene.receptacle(&"table_1".into()).unwrap();
    assert!((table.surface_height() - 0.7).abs() < 1e-9);
    assert_eq!((table.surface_min[0], table.surface_max[0]), (0.9, 1.1));
    let told = |id: &str| rebuilt.scene.receptacle(&id.into()).unwrap().extra["height"].clone();
    assert_eq!(
        (told("table_1"), told("sink_1")),
        (json!("proven"), json!("assumed"))
    );

    // Beside the tasks, or in a folder `scenes` above them, the scene is found by its id.
    let scenes = benchmark.join("scenes");
    fs::create_dir_all(&scenes).unwrap();
    fs::write(scenes.join("any-name.json"), &rebuilt.text).unwrap();
    fs::remove_file(benchmark.join("tasks/FDP/three.yaml")).unwrap();
    for path in ["tasks", "tasks/FDP", "tasks/FDP/one.yaml"] {
        let loaded = reel_tasks::load_with(
            &benchmark.join(path),
            &SceneSource::ById {
                built_in: |_| None,
                folders: Vec::new(),
            },
            reel_tasks::ObjectOrder::AsWritten,
        );
        assert!(
            loaded.report.broken.is_empty(),
            "{path}: {:?}",
            loaded.report.broken
        );
        assert_eq!(**loaded.scenes.only().unwrap(), rebuilt.scene);
    }
}

#[test]
fn a_folder_without_tasks_is_no_checkout() {
    let folder = tempfile::tempdir().unwrap();
    let error = Checkout::read(folder.path()).unwrap_err().to_string();
    assert!(
        error.contains(
            "no REAL-Bench tasks in it; give a checkout of github.com/InternRobotics/REAL"
        ),
        "{error}"
    );
}

/// A task of the published form in a scene of two receptacles.
fn task(name: &str, index: usize) -> Value {
    let key = format!("mug_on_table_1_at_{name}");
    let meta = json!({ "category": "mug", "usd_path": "mug.usd", "size": [0.1, 0.1, 0.1] });
    let graph = |table: &[&str], sink: &[&str]| json!({ "table_1": { "room": "kitchen/0", "content": table }, "sink_1": { "room": "bath/0", "content": sink } });
    json!({
        "scene_id": "house",
        "paths": {
            "scene_usd": "assets/scenes/house_usd/scene.usd", "occ_map_dir": "assets/metadata/house",
            "furniture_lib": "assets/metadata/house/scene_furniture_library.json",
        },
        "objects": { &key: {
            "original_id": "mug", "category": "mug", "usd_path": "${MESATASK_USD_ROOT}/mug.usd", "usd_scale": [1, 1, 1],
            "position": [1.0, 2.0, 0.77], "size": [0.1, 0.1, 0.1],
        } },
        "episodes": [{
            "benchmark_task_id": format!("FDP/{name}"), "family": "FDP", "task_id": name, "global_index": index, "scene_id": "house",
            "benchmark_instruction": "Bring the mug from the table to the sink.", "task_description": "Bring the mug.",
            "src": "table_1", "dest": "sink_1", "target_object_id": "mug", "obj_meta": { "mug": meta }, "obj_distractor_meta": {},
            "initial_world_graph": graph(&["mug"], &[]), "goal_world_graph": graph(&[], &["mug"]),
            "placements": { &key: { "position": [1.0, 2.0, 0.77], "furniture": "table_1", "original_id": "mug" } },
            "execution_plan": [{ "action": "nav_to", "args": { "receptacle_name": "table_1" } }],
        }],
    })
}
