//! Claims counted anew over a store, and the gate that they make.

use std::{fs, path::Path};

use serde_json::{Value, json};

use crate::{complaint, expect};

/// Eight tasks, played by a policy that solves them and by one that takes the wrong object.
fn store(folder: &Path) {
    reel!(
        folder,
        "task draw --count 8 --families FDP --seed 4 --out tasks"
    );
    for policy in ["oracle", "wrong-object"] {
        reel!(
            folder,
            "run --tasks tasks --policy {policy} --out traces --no-images"
        );
    }
    reel!(folder, "ingest traces");
}

fn claim(folder: &Path, name: &str, title: &str, claim: Value) {
    fs::create_dir_all(folder.join("claims")).unwrap();
    let text = json!({"title": title, "claim": claim}).to_string();
    fs::write(folder.join("claims").join(name), text).unwrap();
}

fn checked(folder: &Path, code: i32, arguments: &str) -> Vec<Value> {
    let told = expect(folder, code, &format!("claims check {arguments} --json"));
    let told: Value = serde_json::from_str(&told).unwrap();
    assert_eq!(told["passed"], code == 0);
    told["claims"].as_array().unwrap().clone()
}

#[test]
fn claims_are_counted_anew_and_gate_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    store(folder);
    let solved = json!({"holds": "success", "at_least": 0.2, "at_most": 0.8});
    claim(folder, "a.json", "Half of them succeed", solved);
    claim(
        folder,
        "b.json",
        "Whoever fails takes the wrong thing",
        json!({"of": "NOT success -- all of them", "holds": "class = 'Object Confusion'", "at_least": 0.5}),
    );
    claim(
        folder,
        "c.json",
        "Nobody picks before a look",
        json!({"pattern": "^ !show_object_by_category* pick", "at_most": 0.5}),
    );
    // A folder of definitions holds more than claims.
    fs::write(
        folder.join("claims/view.json"),
        r#"{"title": "a", "view": "/episodes"}"#,
    )
    .unwrap();
    // Before the taxonomy looked, a class is no reason to believe anything.
    let unseen = complaint(folder, 1, "claims check claims/b.json");
    assert!(
        unseen.contains("8 failed episodes") && unseen.contains("reel taxonomy"),
        "{unseen}"
    );
    reel!(folder, "taxonomy");
    let all = checked(folder, 0, "claims");
    assert_eq!(all[1]["unclassified"], 0);
    let counts = |claim: &Value| (claim["holding"].clone(), claim["episodes"].clone());
    assert_eq!(counts(&all[0]), (8.into(), 16.into()));
    assert_eq!(all[0]["verdict"], "holds");
    let runs: Vec<(&str, &Value, &Value)> = all[0]["runs"]
        .as_array()
        .unwrap()
        .iter()
        .map(|run| {
            (
                run["run_id"].as_str().unwrap(),
                &run["share"],
                &run["verdict"],
            )
        })
        .collect();
    assert_eq!(
        runs,
        [
            ("oracle-0", &json!(1.0), &json!("open")),
            ("wrong-object-0", &json!(0.0), &json!("open"))
        ]
    );
    assert_eq!(all[0]["examples"].as_array().unwrap().len(), 3);
    assert!(
        all[0]["counter_examples"]
            .as_array()
            .unwrap()
            .iter()
            .all(|one| one["success"] == false && one["policy"] == "wrong-object")
    );
    let failed =
        "query --format csv | SELECT count(*) FROM classes WHERE class = 'Object Confusion'";
    let confused: u64 = expect(folder, 0, failed)
        .lines()
        .nth(1)
        .unwrap()
        .parse()
        .unwrap();
    assert_eq!(counts(&all[1]), (confused.into(), 8.into()));
    assert_eq!(counts(&all[2]), (0.into(), 16.into()));
    assert_eq!(all[2]["verdict"], "holds");

    // The gate: a run that breaks a promise, one that no interval decides, one that is not there.
    claim(
        folder,
        "d.json",
        "Nearly all succeed",
        json!({"holds": "success", "at_least": 0.9}),
    );
    assert_eq!(checked(folder, 1, "claims/d.json")[0]["verdict"], "fails");
    let run = "claims/d.json --run oracle-0";
    let of_run = &checked(folder, 0, run)[0];
    assert_eq!(of_run["verdict"], "open");
    assert_eq!(counts(of_run), (8.into(), 8.into()));
    assert_eq!(of_run["counter_examples"], json!([]));
    checked(folder, 1, &format!("{run} --strict"));
    let told = expect(folder, 1, "claims check claims/d.json");
    assert!(
        told.contains("FAILS") && told.contains("8 of 16") && told.contains("at least 90%"),
        "{told}"
    );
    let missing = complaint(folder, 2, "claims check claims --run nobody");
    assert!(missing.contains("nobody"), "{missing}");
}

#[test]
fn what_is_no_claim_is_told_with_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 1 --seed 4 --out tasks");
    reel!(folder, "run --tasks tasks --out traces --no-images");
    reel!(folder, "ingest traces");
    let problem = |name: &str, text: &str| {
        fs::write(folder.join(name), text).unwrap();
        let told = complaint(folder, 2, &format!("claims check {name}"));
        assert!(told.contains(name), "{told}");
        told
    };
    assert!(problem("a.json", "{").contains("not a definition"));
    let view = r#"{"title": "a", "view": "/episodes"}"#;
    assert!(problem("b.json", view).contains("no claim"));
    let share = r#"{"title": "a", "claim": {"holds": "success", "at_most": 20}}"#;
    assert!(problem("c.json", share).contains("0 to 1"));
    let key = r#"{"title": "a", "clam": {"holds": "success"}}"#;
    assert!(problem("f.json", key).contains("`clam`"));
    let both = r#"{"title": "a", "view": "/episodes", "claim": {"holds": "success"}}"#;
    assert!(problem("g.json", both).contains("`view`"));
    let column = r#"{"title": "a", "claim": {"holds": "sucess"}}"#;
    assert!(problem("d.json", column).contains("sucess"));
    let two = r#"{"title": "a", "claim": {"holds": "success); DROP TABLE episodes; --"}}"#;
    problem("e.json", two);
    assert!(complaint(folder, 2, "claims check tasks").contains("no claim"));
}
