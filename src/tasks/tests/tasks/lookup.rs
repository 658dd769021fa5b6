//! Which scene a task plays in where nobody names one.

use std::{fs, path::Path};

use reel_tasks::{LoadedSet, ObjectOrder, SceneSource, home_scene, load_with};
use reel_world::Scene;
use serde_json::json;

use crate::{data, fixture_scene};

fn built_in(scene_id: &str) -> Option<Scene> {
    (scene_id == "home").then(home_scene)
}

fn by_id(folders: &[&Path]) -> SceneSource {
    SceneSource::ById {
        built_in,
        folders: folders.iter().map(|folder| folder.to_path_buf()).collect(),
    }
}

fn load(path: &Path) -> LoadedSet {
    load_with(path, &by_id(&[]), ObjectOrder::AsWritten)
}

/// A folder with one task file of the fixtures, renamed to play in `scene_id`.
fn put(folder: &Path, name: &str, scene_id: &str) {
    let text = fs::read_to_string(data("real_schema/FDP/sample_1.yaml")).unwrap();
    let text = text
        .replace(&fixture_scene().scene_id, scene_id)
        .replace("sample_1", name);
    fs::create_dir_all(folder).unwrap();
    fs::write(folder.join(format!("{name}.yaml")), text).unwrap();
}

/// The fixtures' scene under another id.
fn scene_text(scene_id: &str) -> String {
    let mut scene: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(data("scene.json")).unwrap()).unwrap();
    scene["scene_id"] = json!(scene_id);
    scene.to_string()
}

#[test]
fn tasks_of_several_scenes_load_together() {
    let folder = tempfile::tempdir().unwrap();
    put(&folder.path().join("tasks/a"), "one", "flat-a");
    put(&folder.path().join("tasks/b"), "two", "flat-b");
    fs::write(
        folder.path().join("tasks/a/whatever.json"),
        scene_text("flat-a"),
    )
    .unwrap();
    fs::create_dir(folder.path().join("scenes")).unwrap();
    fs::write(
        folder.path().join("scenes/flat-b.json"),
        scene_text("flat-b"),
    )
    .unwrap();
    fs::write(
        folder.path().join("tasks/report.json"),
        "{\"scene_id\": \"flat-a\"}",
    )
    .unwrap();
    let loaded = load(&folder.path().join("tasks"));
    assert!(
        loaded.report.broken.is_empty(),
        "{:?}",
        loaded.report.broken
    );
    let scenes: Vec<&str> = loaded
        .report
        .tasks
        .iter()
        .map(|task| loaded.scenes.of(task).unwrap().scene_id.as_str())
        .collect();
    assert_eq!(scenes, ["flat-a", "flat-b"]);
}

#[test]
fn a_scene_that_is_nowhere_is_said_so_and_the_rest_loads() {
    let folder = tempfile::tempdir().unwrap();
    put(folder.path(), "one", "flat-a");
    put(folder.path(), "two", "nowhere");
    fs::write(folder.path().join("flat-a.json"), scene_text("flat-a")).unwrap();
    let loaded = load(folder.path());
    assert_eq!(loaded.report.tasks.len(), 1);
    let [error] = &loaded.report.broken[..] else {
        panic!("{:?}", loaded.report.broken)
    };
    let text = error.to_string();
    assert!(
        text.contains("two.yaml:") && text.contains("scene nowhere") && text.contains("--scene"),
        "{text}"
    );
}

#[test]
fn the_nearest_scene_file_is_taken_and_two_different_ones_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    put(&folder.path().join("near"), "one", "flat-a");
    put(folder.path(), "two", "flat-a");
    fs::write(folder.path().join("near/flat.json"), scene_text("flat-a")).unwrap();
    let higher = scene_text("flat-a").replace("2.5,0.9]", "2.5,0.95]");
    assert_ne!(scene_text("flat-a"), higher);
    fs::write(folder.path().join("flat.json"), higher).unwrap();
    assert_eq!(load(&folder.path().join("near")).report.tasks.len(), 1);
    let both = load(folder.path());
    let [error] = &both.report.broken[..] else {
        panic!("{:?}", both.report.broken)
    };
    assert!(
        error
            .to_string()
            .contains("two different scenes have this id"),
        "{error}"
    );
}

#[test]
fn a_torn_scene_file_of_that_name_is_the_error() {
    let folder = tempfile::tempdir().unwrap();
    put(folder.path(), "one", "flat-a");
    fs::write(folder.path().join("flat-a.json"), "{\"scene_id\": ").unwrap();
    let loaded = load(folder.path());
    let [error] = &loaded.report.broken[..] else {
        panic!("{:?}", loaded.report.broken)
    };
    assert!(error.to_string().contains("flat-a.json:1: EOF"), "{error}");
}

#[test]
fn a_scene_far_above_is_not_searched() {
    let folder = tempfile::tempdir().unwrap();
    put(&folder.path().join("1/2/3"), "one", "flat-a");
    fs::write(folder.path().join("flat-a.json"), scene_text("flat-a")).unwrap();
    assert_eq!(load(&folder.path().join("1/2/3")).report.broken.len(), 1);
    assert_eq!(load(&folder.path().join("1/2")).report.tasks.len(), 1);
}
