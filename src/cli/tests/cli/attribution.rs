//! What capabilities cost, and why a run regressed, from outside.

use serde_json::Value;

use crate::{complaint, expect, failed_episode};

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap()
}

#[test]
fn a_wrong_object_is_perceptions_and_its_branch_replays() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    failed_episode(folder);
    let told = reel!(folder, "attribute traces --branches rescued");
    assert!(
        told.contains("with perfect perception") && told.contains("-> 100.0%"),
        "{told}"
    );
    let found = json(&reel!(folder, "attribute traces --branches rescued --json"));
    let capabilities = found["episodes"][0]["capabilities"].as_array().unwrap();
    let rescued: Vec<&str> = capabilities
        .iter()
        .filter(|one| one["success"] == true)
        .filter_map(|one| one["capability"].as_str())
        .collect();
    assert_eq!(rescued, ["perception"]);
    assert_eq!(capabilities[0]["verified"], true);
    let branch = capabilities[0]["branch"].as_str().unwrap();
    assert!(reel!(folder, "replay {branch}").contains("exact"));
    assert_eq!(found["estimates"][0]["difference"]["value"], 1.0);
    assert!(complaint(folder, 2, "attribute traces --labels").contains("no label beside"));
    assert!(complaint(folder, 2, "attribute").contains("required"));
}

#[cfg(feature = "analytics")]
#[test]
fn branches_that_were_rescued_are_no_trials_of_the_policy() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    failed_episode(folder);
    reel!(folder, "ingest traces --store store");
    let counts = |told: String| {
        let first = &json(&told)["estimates"][0];
        (first["episodes"].clone(), first["observed"].clone())
    };
    let before = counts(reel!(
        folder,
        "attribute --store store --branches traces --json"
    ));
    reel!(folder, "ingest traces --store store");
    let branches = reel!(
        folder,
        "query --format csv | SELECT count(*) FROM episodes WHERE parent_trace IS NOT NULL"
    );
    assert!(branches.trim_end().ends_with('1'), "{branches}");
    assert_eq!(before, (1.into(), 0.0.into()));
    assert_eq!(
        before,
        counts(reel!(folder, "attribute --store store --json"))
    );
}

#[cfg(all(feature = "analytics", feature = "service"))]
#[test]
fn the_service_tells_what_the_command_estimated() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    failed_episode(folder);
    for policy in ["oracle", "wrong-object"] {
        reel!(
            folder,
            "run --tasks tasks --policy {policy} --out data/traces --no-images"
        );
    }
    reel!(folder, "ingest data/traces --store data/store");
    let server = crate::server::Server::start(folder);
    let counts = |told: &Value| (told["measured"].clone(), told["missing"].clone());
    assert_eq!(counts(&server.get("attribution")), (0.into(), 1.into()));
    let command = json(&reel!(folder, "attribute --store data/store --json"));
    let told = server.get("attribution");
    assert_eq!(counts(&told), (1.into(), 0.into()));
    let (of_all, of_policies) = told["estimates"].as_array().unwrap().split_at(4);
    assert_eq!(command["estimates"], Value::from(of_all));
    let groups: Vec<&Value> = of_policies
        .iter()
        .map(|one| &one["group"])
        .step_by(4)
        .collect();
    assert_eq!(groups, ["oracle", "wrong-object"]);
    let name = |episode: usize| {
        let path = command["episodes"][episode]["trace"].as_str().unwrap();
        let file = path.rsplit('/').next().unwrap();
        file.trim_end_matches(".mcap").to_owned()
    };
    let beside = server.get(&format!("traces/{}/compare/{}", name(0), name(1)));
    assert_eq!(beside["episodes"][0]["trace"], name(0));
    assert_eq!(beside["episodes"][1]["trace"], name(1));
    assert!(!beside["rows"].as_array().unwrap().is_empty());
}

#[test]
fn two_runs_are_paired_and_their_flips_explained() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    failed_episode(folder);
    reel!(
        folder,
        "run --tasks tasks --policy oracle --out old --no-images"
    );
    let told = expect(folder, 1, "diff old traces");
    assert!(told.contains("1 regressed, 0 recovered"), "{told}");
    assert!(told.contains("success -> perception"), "{told}");
    assert!(told.contains("decided at call"), "{told}");
    let found = json(&expect(folder, 1, "diff old traces --json"));
    let flip = &found["flips"][0];
    assert_eq!(flip["is_regression"], true, "{flip}");
    assert_eq!(flip["sides"][0]["class"], "success");
    assert_eq!(found["summary"]["p"], 1.0);
    assert!(reel!(folder, "diff old old").contains("0 regressed"));
}
