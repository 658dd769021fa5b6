//! Calls whose results come later: tasks of protocol 2025-11-25 and of the extension of 2026-07-28, and calls that are made
//! again with input.

use std::sync::Arc;

use reel_redact::Rules;
use reel_world::ErrorCode;
use serde_json::{Value, json};

use super::{Recording, call, result, serve, steps};

/// A recorder before a server that answers a message as `answer` says.
fn recording(answer: impl Fn(&Value) -> Value + Send + Sync + 'static) -> Recording {
    let answer = Arc::new(answer);
    let server = serve(move |request, response| {
        let message = request.json();
        let mut reply = answer(&message);
        reply["jsonrpc"] = json!("2.0");
        reply["id"] = message["id"].clone();
        response.json(200, &reply.to_string());
    });
    Recording::of(server, Rules::built_in())
}

fn done(text: &str) -> Value {
    json!({"content": [{"type": "text", "text": text}]})
}

fn asks(recording: &Recording, id: u32, method: &str) -> String {
    recording
        .post(&json!({"jsonrpc": "2.0", "id": id, "method": method, "params": {"taskId": "t1"}}))
}

#[test]
fn a_task_of_2025_11_25_has_its_final_result() {
    let recording = recording(|message| match message["method"].as_str() {
        Some("tools/call") if message["params"].get("task").is_some() => {
            json!({"result": {"task": {"taskId": "t1", "status": "working", "pollInterval": 10}}})
        }
        Some("tasks/get") => json!({"result": {"taskId": "t1", "status": "completed"}}),
        Some("tasks/result") => json!({"result": done("there at last")}),
        _ => json!({"result": done("at once")}),
    });
    recording.call(1, "drive", json!({"task": {"ttl": 60000}}));
    asks(&recording, 2, "tasks/get");
    asks(&recording, 3, "tasks/result");
    asks(&recording, 4, "tasks/result");
    recording.call(5, "look", json!({}));
    let traces = recording.end();
    let told = |tool: &str, text: &str| (tool.to_owned(), text.to_owned());
    assert_eq!(
        steps(&traces[0]),
        [told("drive", "there at last"), told("look", "at once")]
    );
    assert_eq!(recording.setup.report.counts().unanswered, 0);
    let answer = &traces[0].mcp_answers[&reel_trace::AnsweredRequest::Step(0)];
    assert!(answer.contains("there at last"), "{answer}");
}

#[test]
fn a_task_of_2026_07_28_has_its_final_result() {
    for ending in ["completed", "failed", "cancelled"] {
        let recording = recording(move |message| match (message["method"].as_str(), ending) {
            (Some("tools/call"), _) if message["id"] == 1 => {
                json!({"result": {"resultType": "task", "taskId": "t1", "status": "working"}})
            }
            (Some("tasks/get"), _) if message["id"] == 2 => {
                json!({"result": {"taskId": "t1", "status": "working"}})
            }
            (Some("tasks/get"), "completed") => {
                json!({"result": {"taskId": "t1", "status": "completed", "result": done("there")}})
            }
            (Some("tasks/get"), "failed") => {
                json!({"result": {"taskId": "t1", "status": "failed", "error": {"code": 1, "message": "stuck"}}})
            }
            (Some("tasks/get"), _) => {
                json!({"result": {"taskId": "t1", "status": "cancelled", "statusMessage": "by hand"}})
            }
            _ => json!({"result": done("at once")}),
        });
        recording.call(1, "drive", json!({}));
        asks(&recording, 2, "tasks/get");
        asks(&recording, 3, "tasks/get");
        let traces = recording.end();
        let step = &traces[0].steps[0];
        match ending {
            "completed" => assert_eq!(
                (step.outcome.text.as_str(), step.outcome.error),
                ("there", None)
            ),
            "failed" => assert_eq!(
                (step.outcome.text.as_str(), step.outcome.error),
                ("stuck", Some(ErrorCode::BackendError))
            ),
            _ => assert!(
                step.outcome
                    .text
                    .contains("its task is cancelled (by hand)"),
                "{}",
                step.outcome.text
            ),
        }
        assert_eq!(traces[0].steps.len(), 1);
    }
}

#[test]
fn a_notification_may_bring_the_result_of_a_task() {
    let server = serve(|request, response| {
        let message = request.json();
        response.stream();
        match message["method"].as_str() {
            Some("subscriptions/listen") => {
                let told = json!({"taskId": "t1", "status": "completed", "result": done("pushed")});
                let note =
                    json!({"jsonrpc": "2.0", "method": "notifications/tasks", "params": told});
                response.chunks(&format!("data: {note}\n\n"), 7);
            }
            _ => {
                let task = json!({"resultType": "task", "taskId": "t1", "status": "working"});
                let reply = json!({"jsonrpc": "2.0", "id": message["id"], "result": task});
                response.chunks(&format!("data: {reply}\n\n"), 7);
            }
        }
        response.end();
    });
    let recording = Recording::of(server, Rules::built_in());
    recording.call(1, "drive", json!({}));
    recording.post(&json!({"jsonrpc": "2.0", "id": 2, "method": "subscriptions/listen", "params": {"taskIds": ["t1"]}}));
    let traces = recording.end();
    assert_eq!(
        steps(&traces[0]),
        [("drive".to_owned(), "pushed".to_owned())]
    );
}

#[test]
fn a_call_that_is_made_again_with_input_is_one_call() {
    let recording = recording(|message| {
        if message["params"].get("inputResponses").is_some() {
            json!({"result": done("driven with consent")})
        } else {
            json!({"result": {"resultType": "input_required", "requestState": "s", "inputRequests": {"a": {"method": "elicitation/create", "params": {}}}}})
        }
    });
    recording.call(1, "drive", json!({"arguments": {"to": "table"}}));
    let input = json!({"a": {"action": "accept", "content": {}}});
    recording.call(
        2,
        "drive",
        json!({"arguments": {"to": "table"}, "inputResponses": input, "requestState": "s"}),
    );
    let traces = recording.end();
    assert_eq!(
        steps(&traces[0]),
        [("drive".to_owned(), "driven with consent".to_owned())]
    );
    let counts = recording.setup.report.counts();
    assert_eq!((counts.calls, counts.unanswered), (1, 0));
}

#[test]
fn batches_of_one_call_are_recorded() {
    let server = serve(|request, response| {
        let id = &request.json()[1]["id"];
        response.json(200, &format!("[{}]", result(id, "there")));
    });
    let recording = Recording::of(server, Rules::built_in());
    let note = json!({"jsonrpc": "2.0", "method": "notifications/initialized"});
    recording.post(&json!([note, call(7, "drive", json!({}))]));
    let traces = recording.end();
    assert_eq!(
        steps(&traces[0]),
        [("drive".to_owned(), "there".to_owned())]
    );
}

#[test]
fn clients_without_sessions_are_named() {
    let server =
        serve(|request, response| response.json(200, &result(&request.json()["id"], "there")));
    let recording = Recording::of(server, Rules::built_in());
    let meta = json!({"io.modelcontextprotocol/clientInfo": {"name": "gym", "version": "1"}});
    let body = call(1, "drive", json!({"_meta": meta})).to_string();
    let stream = recording.send("POST", &[("mcp-protocol-version", "2026-07-28")], &body);
    super::read(&stream, false).unwrap();
    let traces = recording.end();
    assert_eq!(traces[0].header.policy.name, "gym");
    assert_eq!(
        steps(&traces[0]),
        [("drive".to_owned(), "there".to_owned())]
    );
}
