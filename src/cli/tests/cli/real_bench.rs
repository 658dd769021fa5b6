//! REAL-Bench from a public checkout: tasks and scenes are written, found without being named,
//! played to their goals and replayed.

use std::{fs, path::Path};

use reel_vectors::checkout;

use super::{complaint, expect};

/// Every so many tasks are played here; `make acceptance` plays all.
const STEP: usize = 20;

#[test]
fn an_outsider_plays_the_benchmark_from_a_checkout() {
    let Some(data) = reel_vectors::real_bench() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let counts = checkout::write(&data, &folder.join("REAL"), 1);
    let all: usize = counts.values().sum();
    let text = reel!(folder, "task real-bench REAL --out real-bench");
    assert!(
        text.contains(&format!("{all} of {all} tasks load")),
        "{text}"
    );
    assert!(
        text.contains("proven 0.744 m") && text.contains("assumed 0.850 m"),
        "which is proven, which is assumed: {text}"
    );
    let checked = reel!(folder, "task check real-bench/tasks");
    assert!(
        checked.contains(&format!("{all} of {all} tasks load in scene ")),
        "{checked}"
    );

    // Some of each family: their files are the published ones, and nobody names the scene.
    for family in counts.keys() {
        let from = folder.join("real-bench/tasks").join(family);
        let to = folder.join("real-bench/some").join(family);
        fs::create_dir_all(&to).unwrap();
        for file in sorted(&from).iter().step_by(STEP) {
            let published = folder
                .join("REAL/benchmark/tasks")
                .join(family)
                .join(file.file_name().unwrap());
            assert_eq!(fs::read(file).unwrap(), fs::read(published).unwrap());
            fs::copy(file, to.join(file.file_name().unwrap())).unwrap();
        }
    }
    let played = reel!(
        folder,
        "run --tasks real-bench/some --no-images --out traces --json"
    );
    for episode in played.lines() {
        let episode: serde_json::Value = serde_json::from_str(episode).unwrap();
        assert_eq!(episode["success"], true, "{episode}");
    }
    assert!(played.lines().count() >= 8, "{played}");
    reel!(folder, "replay traces");
}

#[test]
fn an_incomplete_checkout_plays_what_is_there() {
    let Some(data) = reel_vectors::real_bench() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    checkout::write(&data, &folder.join("REAL"), 30);
    let torn = sorted(&folder.join("REAL/benchmark/tasks/FDP")).remove(0);
    fs::write(&torn, "scene_id: [").unwrap();
    let text = expect(folder, 3, "task real-bench REAL/benchmark --out real-bench");
    assert!(
        text.contains(&format!(
            "broken: REAL/benchmark/tasks/FDP/{}:2: ",
            torn.file_name().unwrap().to_str().unwrap()
        )),
        "{text}"
    );
    assert!(
        text.contains("bundle: REAL/benchmark/manifest.yaml: family_counts.FDP is 2, but 1 good task files are there"),
        "{text}"
    );
    assert!(text.contains("7 of 8 tasks load"), "{text}");
    assert!(
        complaint(folder, 2, "task real-bench elsewhere --out x").contains("give a checkout of")
    );
}

#[test]
fn tasks_of_several_scenes_are_played_in_one_run() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for scene in ["S1", "S3"] {
        reel!(
            folder,
            "task generate --scene {scene} --count 2 --seed 1 --out made"
        );
        // The scene comes with Reel, so it need not lie there.
        fs::remove_file(folder.join("made").join(format!("{scene}.json"))).unwrap();
    }
    let played = reel!(folder, "run --tasks made --no-images --out traces --json");
    let scenes: std::collections::BTreeSet<&str> = played
        .lines()
        .filter_map(|line| {
            ["S1", "S3"]
                .into_iter()
                .find(|scene| line.contains(&format!("/{scene}_")))
        })
        .collect();
    assert_eq!((played.lines().count(), scenes.len()), (4, 2), "{played}");
    reel!(folder, "replay traces");
    let refused = complaint(folder, 2, "run --tasks made --scene S7 --out traces");
    assert!(refused.contains("but the scene given is S7"), "{refused}");
}

fn sorted(folder: &Path) -> Vec<std::path::PathBuf> {
    let mut paths: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    paths.sort();
    paths
}
