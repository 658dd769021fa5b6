//! What becomes of messages, call by call.

use std::path::Path;

use reel_redact::Rules;
use reel_trace::Trace;
use reel_world::ErrorCode;
use serde_json::json;

use super::*;
use crate::tests::setup;

fn session(out: &Path, on_full: OnFull) -> (Arc<Setup>, Arc<Session>) {
    let setup = Arc::new(Setup {
        on_full,
        ..setup(out, Rules::built_in())
    });
    (setup.clone(), Session::new(setup, 1))
}

fn call(
    session: &Session,
    id: u32,
    name: &str,
    arguments: &Value,
) -> Result<Option<Value>, RejectedRequest> {
    let params = json!({"name": name, "arguments": arguments});
    session.agent_says(
        json!({"jsonrpc": "2.0", "id": id, "method": "tools/call", "params": params})
            .to_string()
            .as_bytes(),
    )
}

fn says(session: &Session, id: u32, texts: &[String]) -> Result<(), RejectedRequest> {
    let content: Vec<Value> = texts
        .iter()
        .map(|text| json!({"type": "text", "text": text}))
        .collect();
    session.server_says(
        json!({"jsonrpc": "2.0", "id": id, "result": {"content": content}})
            .to_string()
            .as_bytes(),
    )
}

fn debug_info(held: Option<&str>) -> String {
    let table: &[&str] = if held.is_some() {
        &[]
    } else {
        &["cup_on_table_1_at_t"]
    };
    let graph = json!({"table_1": {"content": table}, "shelf_2": {"content": []}});
    format!(
        "Debug Info:\n{}",
        json!({"CURRENT_INV": held, "CURRENT_MARKER_MAP": {"1": "cup_on_table_1_at_t"}, "world_graph": graph})
    )
}

fn payload(id: &str) -> String {
    json!({
        "task_id": id, "family": "FDP", "task_description": "Bring the cup.", "scene_id": "s",
        "rooms_and_furniture": {"kitchen": ["table_1", "shelf_2"]},
        "initial_world_graph": {"table_1": {"content": ["cup_on_table_1_at_t"]}, "shelf_2": {"content": []}},
        "target_object": {"id": "cup", "name": "cup_on_table_1_at_t", "category": "cup"},
        "source_furniture": "table_1", "destination_furniture": "shelf_2",
    })
    .to_string()
}

fn traces(setup: &Setup) -> Vec<Trace> {
    setup.endings.wait();
    let mut paths: Vec<_> = std::fs::read_dir(&setup.out)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    paths.sort();
    paths
        .iter()
        .map(|path| Trace::read(path).unwrap())
        .collect()
}

#[test]
fn the_published_flow() {
    let folder = tempfile::tempdir().unwrap();
    let (setup, session) = session(folder.path(), OnFull::Stop);
    call(&session, 1, "finish", &json!({})).unwrap();
    says(&session, 1, &[payload("FDP/a"), debug_info(None)]).unwrap();
    call(&session, 2, "pick", &json!({"marker_id": 1})).unwrap();
    says(&session, 2, &[debug_info(Some("cup_on_table_1_at_t"))]).unwrap();
    call(&session, 3, "list_receptacles", &json!({})).unwrap();
    says(&session, 3, &["Room: kitchen".to_owned()]).unwrap();
    call(&session, 4, "finish", &json!({})).unwrap();
    says(&session, 4, &[payload("FDP/b"), debug_info(None)]).unwrap();
    session.end("the test is over");
    let [first, second] = &traces(&setup)[..] else {
        panic!("two episodes")
    };
    assert_eq!(
        (
            first.header.task_id.as_str(),
            second.header.task_id.as_str()
        ),
        ("FDP/a", "FDP/b")
    );
    let tools: Vec<&str> = first.steps.iter().map(|step| step.tool_name()).collect();
    assert_eq!(tools, ["pick", "list_receptacles", "finish"]);
    assert_eq!(first.steps[0].held, Some("cup_on_table_1_at_t".into()));
    assert_eq!(first.steps[0].changes.registry.len(), 1);
    // What the last result shows is of the next episode.
    assert_eq!(first.steps[2].held, Some("cup_on_table_1_at_t".into()));
    assert_eq!(first.end.as_ref().unwrap().reason, EndReason::Finished);
    assert_eq!(
        (second.steps.len(), second.end.as_ref().unwrap().reason),
        (0, EndReason::Aborted)
    );
    assert_eq!(first.timings.len(), 3);
}

#[test]
fn calls_without_results_and_servers_without_tasks() {
    let folder = tempfile::tempdir().unwrap();
    let (setup, session) = session(folder.path(), OnFull::Stop);
    assert_eq!(
        call(&session, 1, "drive", &json!({"to": "there"})),
        Ok(Some(json!(1)))
    );
    session.adrift(&json!(1), false);
    call(&session, 2, "drive", &json!({})).unwrap();
    session
        .agent_says(
            br#"{"jsonrpc":"2.0","method":"notifications/cancelled","params":{"requestId":2}}"#,
        )
        .unwrap();
    call(&session, 3, "drive", &json!({})).unwrap();
    session
        .server_says(br#"{"jsonrpc":"2.0","id":3,"result":{"content":[{"type":"text","text":"stuck"}],"isError":true}}"#)
        .unwrap();
    call(&session, 4, "drive", &json!({})).unwrap();
    says(&session, 4, &["there".to_owned()]).unwrap();
    session.end("the test is over");
    let [trace] = &traces(&setup)[..] else {
        panic!("one episode")
    };
    let errors: Vec<Option<ErrorCode>> =
        trace.steps.iter().map(|step| step.outcome.error).collect();
    let failed = Some(ErrorCode::BackendError);
    assert_eq!(errors, [failed, failed, failed, None]);
    let success = trace.end.as_ref().unwrap().success(&trace.task);
    assert_eq!(success, None, "nobody knows");
}

#[test]
fn what_cannot_be_written() {
    let folder = tempfile::tempdir().unwrap();
    let gone = folder.path().join("gone");
    let (_, stops) = session(&gone, OnFull::Stop);
    let refusal = call(&stops, 1, "drive", &json!({})).unwrap_err();
    assert!(refusal.json(None).unwrap().contains("cannot record this"));
    call(&stops, 2, "finish", &json!({})).unwrap();
    assert!(
        says(&stops, 2, &[payload("FDP/a"), debug_info(None)]).is_err(),
        "an episode that is not recorded was begun"
    );
    let (setup, goes_on) = session(&gone, OnFull::Continue);
    assert_eq!(call(&goes_on, 1, "drive", &json!({})), Ok(None));
    says(&goes_on, 1, &["there".to_owned()]).unwrap();
    assert_eq!(setup.report.counts().unrecorded, 1);
    let batch =
        br#"[{"id":1,"method":"tools/call","params":{"name":"a"}},{"id":2,"method":"tools/call","params":{"name":"b"}}]"#;
    assert!(stops.agent_says(batch).is_err() && goes_on.agent_says(batch) == Ok(None));
}
