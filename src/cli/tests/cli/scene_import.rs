//! Imported scenes from outside: each format becomes a scene in which the oracle succeeds and whose
//! episodes replay exactly.

use std::{fs, path::Path};

use serde_json::Value;

use crate::{complaint, expect};

/// Fixtures of the crate that imports.
const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../scene-import/tests/data");

/// Imports a fixture; the path of the scene and its report.
fn import(folder: &Path, name: &str) -> (String, Value) {
    let printed = reel!(folder, "scene import {DATA}/{name} --out scenes --json");
    let reports: Value = serde_json::from_str(&printed).unwrap();
    let report = reports[0].clone();
    let path = report["scene_file"].as_str().unwrap().to_owned();
    (path, report)
}

/// Plays tasks in a scene: all succeed, all replay exactly. The receptacles that objects were
/// brought from or to.
fn play(folder: &Path, scene: &str, more: &str) -> Vec<String> {
    reel!(
        folder,
        "task generate --scene {scene} --count 4 --seed 3 --out tasks {more}"
    );
    let reports = reel!(folder, "run --tasks tasks --out traces --no-images --json");
    let reports: Vec<Value> = reports
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert!(!reports.is_empty(), "no task in {scene}");
    for report in &reports {
        assert_eq!(report["success"], true, "{report}");
    }
    let replayed = reel!(folder, "replay traces");
    let all = reports.len();
    assert!(
        replayed.starts_with(&format!("{all} of {all} traces replay exactly")),
        "{replayed}"
    );
    let mut used = Vec::new();
    for trace in fs::read_dir(folder.join("traces")).unwrap() {
        let trace = trace.unwrap().path().display().to_string();
        used.push(reel!(folder, "show {trace} --json"));
    }
    used
}

#[test]
fn a_procthor_house_is_played() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, report) = import(folder.path(), "procthor_house.json");
    assert_eq!(report["receptacles"].as_array().unwrap().len(), 11);
    assert!(reel!(folder.path(), "scene check {scene}").contains("0 findings"));
    play(folder.path(), &scene, "");
}

#[test]
fn a_dresser_of_mjcf_is_played_with_its_drawers() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, _) = import(folder.path(), "dresser.xml");
    let shown = play(folder.path(), &scene, "--types articulation");
    assert!(
        shown.iter().all(|episode| episode.contains("drawer_")),
        "no drawer was used"
    );
}

#[test]
fn a_cabinet_of_urdf_is_played_with_its_door_and_drawer() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, _) = import(folder.path(), "cabinet.urdf");
    play(folder.path(), &scene, "");
}

#[test]
fn a_usd_stage_is_played_with_its_drawer() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, _) = import(folder.path(), "living_room.usda");
    let shown = play(folder.path(), &scene, "--types articulation");
    assert!(
        shown.iter().all(|episode| episode.contains("drawer_1")),
        "the drawer was not used"
    );
}

#[test]
fn files_that_fail_are_named_and_the_others_written() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("torn.urdf"), "<robot name=\"a\"><link").unwrap();
    let said = complaint(
        folder,
        3,
        &format!("scene import torn.urdf {DATA}/cabinet.urdf --out scenes"),
    );
    assert!(said.contains("torn.urdf:1:"), "{said}");
    assert!(folder.join("scenes/cabinet.json").is_file());
    complaint(folder, 2, "scene import torn.urdf --out scenes");
    // Two files of one name are two scenes of one name: the first is kept.
    fs::create_dir(folder.join("other")).unwrap();
    fs::copy(
        format!("{DATA}/dresser_drawers.xml"),
        folder.join("other/dresser_drawers.xml"),
    )
    .unwrap();
    fs::copy(
        format!("{DATA}/dresser.xml"),
        folder.join("other/cabinet.xml"),
    )
    .unwrap();
    let said = complaint(
        folder,
        3,
        &format!(
            "scene import {DATA}/cabinet.urdf other/cabinet.xml {DATA}/dresser.xml --out both"
        ),
    );
    assert!(said.contains("is written from"), "{said}");
    assert!(folder.join("both/dresser.json").is_file());
    complaint(
        folder,
        2,
        "scene import torn.urdf --format obj --out scenes",
    );
    let printed = expect(
        folder,
        0,
        &format!("scene import {DATA}/dresser.xml --out scenes"),
    );
    assert!(
        printed.contains("4 receptacles, 4 of them reached")
            && printed.contains("the top drawer of the chest of drawers"),
        "{printed}"
    );
}
