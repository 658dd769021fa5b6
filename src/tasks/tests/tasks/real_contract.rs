//! What the published loaders accept, case by case of `datagen.json`: ours accept
//! and refuse the same.

use std::{fs, path::Path};

use reel_tasks::real_bench::{Checkout, check_runtime};
use reel_vectors::{Report, items, load, text};
use serde_json::{Value, json};

/// How the vectors say that a key is removed.
const DELETE: &str = "\u{27e6}delete\u{27e7}";

#[test]
fn task_files_are_accepted_as_published() {
    let Some(vectors) = load("datagen.json") else {
        return;
    };
    let mut report = Report::new("datagen.json", "config");
    for case in items(&vectors["config"]) {
        let mut config = vectors["config_base"].clone();
        change(&mut config, items(&case["path"]), &case["value"]);
        let found = check_runtime(&config.to_string(), "task.yaml").is_ok();
        report.compare(
            &format!("{} = {}", case["path"], case["value"]),
            &case["accepted"],
            &json!(found),
        );
    }
    report.finish();
}

/// Puts a value where a path says; without a path nothing changes.
fn change(document: &mut Value, path: &[Value], value: &Value) {
    let Some((last, before)) = path.split_last() else {
        return;
    };
    let at = before.iter().fold(document, |at, key| match key {
        Value::String(key) => &mut at[key.as_str()],
        key => &mut at[usize::try_from(key.as_u64().unwrap()).unwrap()],
    });
    if value == DELETE {
        at.as_object_mut().unwrap().remove(text(last));
    } else {
        at[text(last)] = value.clone();
    }
}

#[test]
fn benchmarks_are_accepted_as_published() {
    let Some(vectors) = load("datagen.json") else {
        return;
    };
    let mut report = Report::new("datagen.json", "bench");
    for case in items(&vectors["bench"]) {
        let id = text(&case["id"]);
        let mut bundle = Bundle::of(&vectors);
        match case["change"].get("man") {
            Some(changes) => {
                for (key, value) in changes.as_object().unwrap() {
                    bundle.manifest[key] = value.clone();
                }
            }
            None => bundle.change(id),
        }
        let folder = tempfile::tempdir().unwrap();
        bundle.write(folder.path());
        let checkout = Checkout::read(folder.path()).unwrap();
        let accepted = checkout.broken.is_empty() && checkout.complaints.is_empty();
        let found = if accepted {
            json!(checkout.files.len())
        } else {
            json!("rejected")
        };
        report.compare(id, &case["result"], &found);
        // One that is refused says by which file.
        for error in checkout.broken.iter().chain(&checkout.complaints) {
            assert!(
                error
                    .to_string()
                    .starts_with(&*folder.path().to_string_lossy()),
                "{error}"
            );
        }
    }
    report.finish();
}

/// A benchmark of two tasks.
struct Bundle {
    manifest: Value,
    tasks: [(String, Value); 2],
    meshes: Vec<&'static str>,
    stray: bool,
}

impl Bundle {
    fn of(vectors: &Value) -> Self {
        let first = vectors["bench_task"].clone();
        let mut second = first.clone();
        let episode = &mut second["episodes"][0];
        for (key, value) in [
            ("benchmark_task_id", json!("SUL/t1")),
            ("family", json!("SUL")),
            ("task_id", json!("t1")),
            ("global_index", json!(1)),
        ] {
            episode[key] = value;
        }
        Self {
            manifest: vectors["bench_manifest"].clone(),
            tasks: [("FDP/t0".into(), first), ("SUL/t1".into(), second)],
            meshes: vec!["u1.usd", "u2.usd"],
            stray: false,
        }
    }

    /// The change that the id of a case stands for.
    fn change(&mut self, id: &str) {
        let task = &mut self.tasks[0].1;
        let second = task["episodes"][0].clone();
        let episode = &mut task["episodes"][0];
        match id {
            "good" => {}
            "mesa-unsorted" => self.meshes.reverse(),
            "stray-file" => self.stray = true,
            "index" => episode["global_index"] = json!(7),
            "benchmark-id" => episode["benchmark_task_id"] = json!("FDP/other"),
            "two-targets" => {
                episode["obj_meta"]["u2"] = episode["obj_distractor_meta"]["u2"].clone()
            }
            "target-id" => episode["target_object_id"] = json!("u2"),
            "graph-placement" => {
                episode["initial_world_graph"]["table_1"]["content"] = json!(["u1"])
            }
            "goal-keeps-source" => {
                episode["goal_world_graph"]["table_1"]["content"] = json!(["u1", "u2"])
            }
            "goal-not-conserving" => {
                episode["goal_world_graph"]["desk_1"]["content"] = json!(["u1", "u2", "u2"])
            }
            "dest-missing" => drop(
                episode["goal_world_graph"]
                    .as_object_mut()
                    .unwrap()
                    .remove("desk_1"),
            ),
            "plan-text" => episode["execution_plan"] = json!(["go to the table"]),
            "plan-empty" => episode["execution_plan"] = json!([]),
            "usd-path" => episode["obj_meta"]["u1"]["usd_path"] = json!("meshes/u1.usd"),
            "size" => task["objects"]["u1_on_table_1_at_x"]["size"] = json!([0.1, 0.1, 0.2]),
            "paths" => task["paths"]["occ_map_dir"] = json!("assets/metadata/T"),
            "final-positions" => {
                episode["final_positions"] = json!({"u1_on_table_1_at_x": {"original_id": "u1"}})
            }
            "family" => episode["family"] = json!("FDO"),
            "two-episodes" => task["episodes"].as_array_mut().unwrap().push(second),
            other => panic!("no change is known for the case {other}"),
        }
    }

    fn write(&self, root: &Path) {
        let write = |path: &str, text: String| {
            let path = root.join("benchmark").join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        };
        for (path, task) in &self.tasks {
            write(&format!("tasks/{path}.yaml"), task.to_string());
        }
        write("manifest.yaml", self.manifest.to_string());
        write("mesa_required.txt", self.meshes.join("\n"));
        if self.stray {
            write("tasks/FDP/notes.txt", "nothing".into());
        }
    }
}
