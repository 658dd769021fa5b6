//! Scenes and tasks made by the command, looked at from outside.

use std::fs;

use crate::{complaint, expect};

#[test]
fn scenes_go_by_name_and_new_ones_are_as_good() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let listed = reel!(folder, "scene list --json");
    let listed: Vec<serde_json::Value> = serde_json::from_str(&listed).unwrap();
    let trained = || {
        listed.iter().filter(|scene| {
            ["S1", "S2", "S3", "S4", "S5", "S6"].contains(&scene["scene"].as_str().unwrap())
        })
    };
    assert_eq!(
        trained()
            .map(|scene| scene["receptacles"].as_u64().unwrap())
            .sum::<u64>(),
        82
    );
    assert!(
        trained()
            .map(|scene| scene["captions"].as_u64().unwrap())
            .sum::<u64>()
            >= 157
    );
    assert!(reel!(folder, "scene check S1 S7").contains("S7: 0 findings"));

    reel!(
        folder,
        "scene generate --seed 7 --rooms 5 --receptacles 9 --out flat.json"
    );
    reel!(folder, "scene check flat.json");
    reel!(folder, "scene plan flat.json --out flat.svg");
    reel!(folder, "scene plan flat.json --out flat.png");
    let plan = fs::read_to_string(folder.join("flat.svg")).unwrap();
    assert!(
        plan.starts_with("<svg") && plan.contains("robot start"),
        "{plan}"
    );
    assert!(
        fs::read(folder.join("flat.png"))
            .unwrap()
            .starts_with(b"\x89PNG")
    );

    // A table in the way of another one.
    let mut scene: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.join("flat.json")).unwrap()).unwrap();
    let twice = scene["receptacles"][0].clone();
    for corner in ["surface_min", "surface_max"] {
        scene["receptacles"][1][corner] = twice[corner].clone();
    }
    fs::write(folder.join("flat.json"), scene.to_string()).unwrap();
    assert!(expect(folder, 1, "scene check flat.json").contains("stands in"));
    assert!(complaint(folder, 2, "scene check S8").contains("home, S1"));
}

/// The short form of `make eval-tasks`.
#[test]
fn made_tasks_mean_what_they_say_and_can_be_done() {
    let Some(python) = reel_vectors::python("yaml") else {
        return;
    };
    let mut script = reel_vectors::script("bash", "generate/run.sh");
    let script = script
        .env("REEL", env!("CARGO_BIN_EXE_reel"))
        .env("REEL_PYTHON", python)
        .env("SCENES", "S3 S7")
        .env("COUNT", "48")
        .env("SOCIAL_COUNT", "16");
    let said = reel_vectors::run(script);
    assert_eq!(
        said.matches("fuzzy instructions, 0 findings").count(),
        2,
        "{said}"
    );
}

#[test]
fn tasks_come_from_a_table_that_people_change() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task compatibility --out table.json");
    let generate = ["task", "generate", "--count", "4", "--seed", "1"];
    let made = |more: &[&str]| {
        expect(folder, 0, &[&generate, more].concat())
            .lines()
            .skip(1)
            .collect::<Vec<_>>()
            .join("\n")
    };
    assert_eq!(
        made(&["--out", "a"]),
        made(&["--out", "b", "--compatibility", "table.json"])
    );

    let mut table: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.join("table.json")).unwrap()).unwrap();
    table["holds"] = serde_json::json!([{ "receptacles": ["table", "desk", "couch", "cabinet"], "what": ["toy"] }]);
    fs::write(folder.join("table.json"), table.to_string()).unwrap();
    let said = made(&[
        "--out",
        "toys",
        "--compatibility",
        "table.json",
        "--json",
        "--families",
        "FODP",
    ]);
    assert_eq!(said, "", "one line of JSON");
    let home = reel_tasks::home_scene();
    let toys = reel_tasks::load(&folder.join("toys"), &home).tasks;
    let is_toy = |asset: &reel_world::AssetId| {
        reel_tasks::library::objects()
            .iter()
            .any(|object| object.asset == *asset && object.purpose == "toy")
    };
    assert!(toys.len() == 4 && toys.iter().all(|task| is_toy(&task.target_object().asset)));

    fs::write(
        folder.join("table.json"),
        r#"{"holds": [{"receptacle": ["table"]}]}"#,
    )
    .unwrap();
    let broken = complaint(
        folder,
        2,
        &[&generate[..], &["--compatibility", "table.json"]].concat(),
    );
    assert!(
        broken.contains("table.json")
            && broken.contains("receptacle")
            && broken.contains("reel task compatibility"),
        "{broken}"
    );
}

#[cfg(feature = "service")]
#[test]
fn a_model_writes_the_table() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let url = super::endpoint::endpoint("Toys, I say: [\"toy\", \"unicorn\"]");
    let asked = [
        "task",
        "compatibility",
        "--scene",
        "S3",
        "--out",
        "table.json",
        "--model",
        "scripted",
        "--endpoint",
    ];
    let said = expect(folder, 0, &[&asked[..], &[&url]].concat());
    assert!(
        said.contains("places by scripted, 0 as they were"),
        "{said}"
    );
    // Nobody is asked a second time, and nobody has to be there.
    let table = fs::read(folder.join("table.json")).unwrap();
    expect(
        folder,
        0,
        &[&asked[..], &["http://127.0.0.1:9/v1"]].concat(),
    );
    assert_eq!(table, fs::read(folder.join("table.json")).unwrap());
    reel!(
        folder,
        "task generate --scene S3 --count 2 --compatibility table.json --out made"
    );

    let url = super::endpoint::endpoint("I would rather not.");
    let asked =
        format!("task compatibility --scene S4 --out other.json --model scripted --endpoint {url}");
    assert!(complaint(folder, 2, &asked).contains("none of the"));
}
