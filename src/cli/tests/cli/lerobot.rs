//! LeRobot datasets, from outside.

use std::fs;

use crate::{complaint, expect};

#[test]
fn episodes_become_a_dataset_that_the_lint_accepts() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task generate --count 2 --seed 5 --out tasks");
    reel!(
        folder,
        "run --tasks tasks --policy planner --no-images --out traces"
    );
    let export = "export lerobot traces --camera-size 64x48";
    let told = reel!(folder, "{export} --out decisions");
    assert!(told.contains("of 2 episodes"), "{told}");
    let told = reel!(folder, "{export} --out motion --fps 4 --json");
    let told: serde_json::Value = serde_json::from_str(&told).unwrap();
    assert_eq!((&told["fps"], &told["refused"]), (&4.into(), &0.into()));
    for name in ["decisions", "motion"] {
        let report = reel!(folder, "dataset lint {name} --json");
        let report: serde_json::Value = serde_json::from_str(&report).unwrap();
        let checks = report["checks"].as_array().unwrap();
        assert!(
            checks.len() > 8 && checks.iter().all(|check| check["worst"].is_null()),
            "{report}"
        );
    }
    let info = folder.join("motion/meta/info.json");
    let text = fs::read_to_string(&info).unwrap();
    fs::write(&info, text.replace("\"fps\": 4", "\"fps\": 5")).unwrap();
    let report = expect(folder, 1, &["dataset", "lint", "motion"]);
    assert!(
        report.contains("timestamp") && report.contains("ERROR"),
        "{report}"
    );

    let refused = |arguments: &str| complaint(folder, 2, arguments);
    assert!(refused(&format!("{export} --out decisions")).contains("is there already"));
    // What an interrupted export left is begun anew, and what is somebody else's stays.
    fs::create_dir_all(folder.join("again.part/meta")).unwrap();
    fs::write(folder.join("again.part/note.txt"), "mine").unwrap();
    assert!(refused(&format!("{export} --out again")).contains("move it away"));
    assert!(folder.join("again.part/note.txt").exists());
    fs::remove_dir_all(folder.join("again.part")).unwrap();
    for part in ["meta", "data", "videos"] {
        fs::create_dir_all(folder.join("again.part").join(part)).unwrap();
    }
    fs::write(folder.join("again.part/data/rest.parquet"), "torn").unwrap();
    reel!(folder, "{export} --out again");
    assert!(
        !folder.join("again.part").exists() && !folder.join("again/data/rest.parquet").exists()
    );
    assert!(
        refused("export lerobot traces --camera-size 65x48 --out odd").contains("two even numbers")
    );
    assert!(
        refused("export lerobot traces --fps 4 --turn-speed 0 --out slow")
            .contains("--turn-speed is from")
    );
    // A trace that says of itself what it did not do adds nothing.
    let trace = fs::read_dir(folder.join("traces"))
        .unwrap()
        .next()
        .unwrap()
        .unwrap()
        .path();
    fs::create_dir(folder.join("broken")).unwrap();
    let bytes = fs::read(&trace).unwrap();
    fs::write(folder.join("broken/a.mcap"), &bytes[..bytes.len() / 2]).unwrap();
    complaint(folder, 2, "export lerobot broken --out none");
    assert!(!folder.join("none/meta/info.json").exists());
}

/// LeRobot 0.6 and lerobot-doctor.
#[test]
fn lerobots_own_readers_agree() {
    crate::service::script("formats/robot_datasets.py", reel_vectors::form());
}
