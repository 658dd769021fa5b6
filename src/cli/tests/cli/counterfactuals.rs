//! What plausible other calls come to, from outside.

use serde_json::Value;

use crate::{complaint, failed_episode};

/// It went to the wrong shelf: what a competent agent makes of another call there is what a branch
/// makes of it.
#[test]
fn another_call_rescues_and_its_branch_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    failed_episode(folder);
    let told: Value =
        serde_json::from_str(&reel!(folder, "counterfactuals traces --json")).unwrap();
    assert_eq!(told["success"], false);
    let calls = told["counterfactuals"].as_array().unwrap();
    let rescued = |one: &&Value| one["with_planner"]["success"] == true;
    let one = calls.iter().find(rescued).unwrap();
    let (trace, step) = (told["trace"].as_str().unwrap(), &one["step"]);
    std::fs::write(folder.join("calls.jsonl"), one["call"].to_string()).unwrap();
    let branched = reel!(
        folder,
        "branch {trace} --at {step} --calls calls.jsonl --then planner --out other.mcap --json"
    );
    let branched: Value = serde_json::from_str(&branched).unwrap();
    for field in ["success", "completion", "length"] {
        assert_eq!(branched[field], one["with_planner"][field], "{branched}");
    }
    let said = reel!(folder, "counterfactuals traces");
    assert!(said.contains("a competent agent then succeeds"), "{said}");
    assert!(complaint(folder, 2, "counterfactuals").contains("required"));
}

#[cfg(feature = "analytics")]
#[test]
fn a_store_keeps_them_once_and_the_service_lists_them() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    failed_episode(folder);
    reel!(folder, "ingest traces --store data/store");
    let count = |folder| {
        let all = "SELECT count(*), count(DISTINCT episode_id), count(DISTINCT step) FROM counterfactuals";
        reel!(folder, "query --store data/store --format csv | {all}")
    };
    let none = count(folder);
    reel!(folder, "counterfactuals --store data/store");
    let kept = count(folder);
    assert_ne!(none, kept);
    reel!(folder, "counterfactuals --store data/store traces");
    assert_eq!(kept, count(folder));
    #[cfg(feature = "service")]
    {
        let server = crate::server::Server::start(folder);
        let episodes = server.get("episodes");
        let episode = episodes["episodes"][0]["episode_id"]
            .as_str()
            .unwrap()
            .to_owned();
        let rows = server.get(&format!("counterfactuals?episode={episode}"));
        let rows = rows.as_array().unwrap();
        let number = kept.lines().nth(1).unwrap().split(',').next().unwrap();
        assert_eq!(rows.len().to_string(), number);
        assert!(rows.iter().any(|row| row["with_planner_success"] == true));
        assert!(rows.is_sorted_by_key(|row| row["step"].as_i64()));
        assert_eq!(
            server.get("counterfactuals?episode=nobody"),
            Value::Array(Vec::new())
        );
    }
}
