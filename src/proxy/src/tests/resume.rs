//! Streams that break and go on: the trace is the one of a session in which nothing broke.

use std::{
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
    time::Duration,
};

use reel_redact::Rules;
use serde_json::json;

use super::{Recording, Request, Response, call, result, serve, steps};

fn told(tool: &str, text: &str) -> (String, String) {
    (tool.to_owned(), text.to_owned())
}

/// A server of protocol 2025-11-25 that ends each stream after the event with which it begins, and gives the result on the
/// stream that goes on from there.
fn polling(request: &Request, response: &Response<'_>) {
    response.stream();
    if request.method == "GET" {
        let last = request
            .header("last-event-id")
            .unwrap_or_default()
            .to_owned();
        let id = last.split('/').next().unwrap_or_default();
        response.chunks(
            &format!(
                "id: {id}/1\ndata: {}\n\n",
                result(&json!(id.parse::<u32>().unwrap()), &format!("result {id}"))
            ),
            9,
        );
    } else {
        let id = &request.json()["id"];
        response.chunks(&format!("id: {id}/0\nretry: 10\ndata: \n\n"), 5);
    }
    response.end();
}

#[test]
fn a_stream_that_the_server_ends_goes_on_elsewhere() {
    let recording = Recording::of(serve(polling), Rules::built_in());
    for id in 1..=3 {
        let primed = recording.call(id, "drive", json!({"arguments": {"to": id}}));
        assert!(primed.contains("retry: 10"), "{primed}");
        let last = format!("{id}/0");
        // Asked for twice: the connection broke while the result was on its way.
        for _ in 0..2 {
            let resumed = recording.ask("GET", &[("last-event-id", last.as_str())], "");
            assert!(resumed.contains(&format!("result {id}")), "{resumed}");
        }
    }
    let traces = recording.end();
    let texts: Vec<_> = (1..=3)
        .map(|id| told("drive", &format!("result {id}")))
        .collect();
    assert_eq!((traces.len(), steps(&traces[0])), (1, texts));
    let counts = recording.setup.report.counts();
    assert_eq!(
        (counts.calls, counts.unanswered, counts.sessions),
        (3, 0, 1)
    );
}

/// A server without session ids: only the id of the last event tells whose stream goes on.
#[test]
fn a_stream_without_a_session_goes_on_elsewhere() {
    let recording = Recording::of(serve(polling), Rules::built_in());
    let read = |stream| super::read(&stream, false).unwrap();
    read(recording.send("POST", &[], &call(5, "drive", json!({})).to_string()));
    read(recording.send("GET", &[("last-event-id", "5/0")], ""));
    let traces = recording.end();
    assert_eq!(steps(&traces[0]), [told("drive", "result 5")]);
}

/// A call of another task of the agent waits while the stream of the first is resumed.
#[test]
fn the_next_call_waits_for_a_stream_that_goes_on() {
    let recording = Arc::new(Recording::of(serve(polling), Rules::built_in()));
    recording.call(1, "drive", json!({}));
    let other = recording.clone();
    let second = thread::spawn(move || other.call(2, "look", json!({})));
    thread::sleep(Duration::from_millis(300));
    recording.ask("GET", &[("last-event-id", "1/0")], "");
    second.join().unwrap();
    recording.ask("GET", &[("last-event-id", "2/0")], "");
    let traces = recording.end();
    assert_eq!(
        steps(&traces[0]),
        [told("drive", "result 1"), told("look", "result 2")]
    );
}

#[test]
fn a_call_that_is_sent_again_is_one_call() {
    let tries = Arc::new(AtomicUsize::new(0));
    let server = serve(move |request, response| {
        // The first connection breaks before there is an answer.
        if tries.fetch_add(1, Ordering::Relaxed) > 0 {
            response.json(200, &result(&request.json()["id"], "there"));
        }
    });
    let recording = Recording::of(server, Rules::built_in());
    recording.call(1, "drive", json!({}));
    recording.call(1, "drive", json!({}));
    let traces = recording.end();
    assert_eq!(steps(&traces[0]), [told("drive", "there")]);
}

#[test]
fn a_stream_that_is_refused_ends_no_call() {
    let server = serve(|request, response| {
        if request.method == "GET" {
            response.json(405, "{\"error\": \"no stream here\"}");
        } else {
            thread::sleep(Duration::from_millis(400));
            response.json(200, &result(&request.json()["id"], "there"));
        }
    });
    let recording = Arc::new(Recording::of(server, Rules::built_in()));
    let caller = recording.clone();
    let called = thread::spawn(move || caller.call(1, "drive", json!({})));
    thread::sleep(Duration::from_millis(150));
    let refused = recording.ask("GET", &[], "");
    assert!(refused.contains("no stream here"), "{refused}");
    called.join().unwrap();
    let traces = recording.end();
    assert_eq!(steps(&traces[0]), [told("drive", "there")]);
}

/// What cannot be recorded is not to be had by resuming its stream, either.
#[test]
fn a_refused_result_stays_refused() {
    let task = json!({"task_id": "FDP/a", "task_description": "b", "scene_id": "s"}).to_string();
    let server = serve(move |request, response| {
        let id = request
            .header("last-event-id")
            .map_or_else(|| request.json()["id"].clone(), |_| json!(1));
        response.stream();
        response.chunks(&format!("id: 1/1\ndata: {}\n\n", result(&id, &task)), 40);
        response.end();
    });
    let recording = Recording::of(server, Rules::built_in());
    std::fs::remove_dir(&recording.setup.out).unwrap();
    let first = recording.call(1, "finish", json!({}));
    let again = recording.ask("GET", &[("last-event-id", "1/0")], "");
    for content in [first, again] {
        assert!(
            content.contains("not recorded") || content.contains("cannot record"),
            "{content}"
        );
        assert!(!content.contains("FDP/a"), "{content}");
    }
    assert_eq!(recording.setup.report.counts().refused, 1);
}

/// A server that sends the agent elsewhere on itself does not send it past the recorder.
#[test]
fn a_redirection_leads_through_the_recorder() {
    let server = serve(|request, response| {
        let host = request.header("host").unwrap_or_default().to_owned();
        let wanted = request.json()["id"].clone();
        let to = match wanted.as_u64() {
            Some(1) => format!("http://{host}/mcp/?a=1"),
            Some(2) => "http://elsewhere.example/mcp/".to_owned(),
            _ => "/mcp/".to_owned(),
        };
        response.write(&format!(
            "HTTP/1.1 307 X\r\nLocation: {to}\r\ncontent-length: 0\r\n\r\n"
        ));
    });
    let recording = Recording::of(server, Rules::built_in());
    let location = |id: u32| {
        let stream = recording.send("POST", &[], &call(id, "drive", json!({})).to_string());
        let (head, _) = super::read(&stream, false).unwrap();
        head.value("location").unwrap().to_owned()
    };
    assert_eq!(location(1), "/mcp/?a=1");
    assert_eq!(location(2), "http://elsewhere.example/mcp/");
    assert_eq!(location(3), "/mcp/");
}
