//! What a History adds to the scheduler's memory that is empty.

use reel_prompt::published::SchedulerMemory;
use reel_vectors::{Report, items, load};
use serde_json::{Value, json};

const FILE: &str = "memory.json";

#[test]
fn real_contract_history() {
    let Some(document) = load(FILE) else { return };
    let mut report = Report::new(FILE, "history");
    for case in items(&document["history"]) {
        let answer = json!({ "summary": { "History": case["history"] }, "next action": "look" });
        let mut memory = SchedulerMemory::default();
        memory.update(&answer.to_string(), &crate::tokens());
        let line = memory.lines().first().map(String::as_str);
        let ours = json!({
            "history": case["history"],
            "new_step": line.map(|line| line.strip_prefix("0) ")),
            "formatted": line.unwrap_or_default(),
            "progress": memory.task_progress(),
        });
        report.compare(&case["history"].to_string(), case, &ours);
    }
    report.finish();
    assert_eq!(
        SchedulerMemory::default().last_action(),
        &Value::Object(serde_json::Map::new())
    );
}
