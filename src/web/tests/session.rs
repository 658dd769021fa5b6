//! What a browser asks, asked natively: the same code responds.

use std::{fs, path::PathBuf};

use reel_trace::Trace;
use reel_web::Session;
use serde_json::{Value, json};

fn golden(part: &str) -> PathBuf {
    let mut golden = reel_vectors::golden_traces().into_iter();
    golden
        .find(|path| path.to_string_lossy().contains(part))
        .unwrap()
}

fn ask(session: &mut Session, request: &Value, bytes: &[u8]) -> (Value, Vec<u8>) {
    let (response, bytes) = session.respond_json(request.to_string().as_bytes(), bytes);
    (serde_json::from_slice(&response).unwrap(), bytes)
}

fn opened(path: &PathBuf) -> (Session, Value) {
    let mut session = Session::default();
    let bytes = fs::read(path).unwrap();
    let (response, _) = ask(
        &mut session,
        &json!({"request": "open", "name": "a.mcap"}),
        &bytes,
    );
    (session, response)
}

fn verified(session: &mut Session) -> Value {
    loop {
        let (response, _) = ask(session, &json!({"request": "verify"}), &[]);
        if !response["verdict"].is_null() || response["response"] == "failed" {
            return response;
        }
    }
}

#[test]
fn every_golden_trace_is_verified_call_by_call_with_the_verdict_of_a_replay() {
    let every = if reel_vectors::is_long() { 1 } else { 7 };
    for path in reel_vectors::golden_traces().iter().step_by(every) {
        let (mut session, response) = opened(path);
        assert_eq!(response["response"], "opened");
        let found = verified(&mut session);
        let replayed = reel_replay::verify(path);
        assert_eq!(found["verdict"], json!(replayed), "{}", path.display());
        assert_eq!(found["text"], json!(replayed.to_string()));
    }
}

#[test]
fn an_image_is_that_of_the_moment_whichever_way_it_was_reached() {
    let path = golden("FODP_workshop_fall--oracle--0");
    let trace = Trace::read(&path).unwrap();
    let view = |session: &mut Session, at: usize, name: &str| {
        let request = json!({"request": "view", "at": at, "camera": {"name": name}});
        let (response, bytes) = ask(session, &request, &[]);
        assert_eq!(
            response,
            json!({"response": "image", "width": 640, "height": 480})
        );
        assert_eq!(bytes.len(), 640 * 480 * 4);
        bytes
    };
    // Executed to there before anything was verified; forwards, backwards, and from kept states.
    let (mut session, _) = opened(&path);
    let last = trace.steps.len();
    let moments = [last, 2, 3, 0, last];
    let first: Vec<Vec<u8>> = moments.map(|at| view(&mut session, at, "top-down")).into();
    verified(&mut session);
    let again: Vec<Vec<u8>> = moments.map(|at| view(&mut session, at, "top-down")).into();
    assert!(first == again && first[0] == first[4] && first[1] != first[0]);
    let head = view(&mut session, 2, "head");
    assert_ne!(head, first[1]);

    let far = json!({"request": "view", "at": last + 1, "camera": {"name": "head"}});
    let (response, _) = ask(&mut session, &far, &[]);
    assert_eq!(response["response"], "failed");
    let nowhere = json!({"request": "view", "at": 0, "camera": {"name": "free"}});
    let (response, _) = ask(&mut session, &nowhere, &[]);
    assert!(
        response["reason"].as_str().unwrap().contains("x,y,z"),
        "{response}"
    );
}

#[test]
fn another_future_begins_where_it_is_asked_to() {
    let path = golden("FODP_workshop_fall--oracle--0");
    let trace = Trace::read(&path).unwrap();
    let (mut session, response) = opened(&path);
    assert_eq!(response["tools"].as_array().unwrap().len(), 11);
    let act = |session: &mut Session, call: &Value| {
        ask(session, &json!({"request": "act", "call": call}), &[])
    };
    let recorded = json!(trace.steps[2].input.call);
    let (response, _) = act(&mut session, &recorded);
    assert!(
        response["reason"]
            .as_str()
            .unwrap()
            .contains("no other future"),
        "{response}"
    );
    ask(&mut session, &json!({"request": "branch", "at": 2}), &[]);
    // The recorded call has the recorded outcome, digests of the state and image included.
    let (response, _) = act(&mut session, &recorded);
    let recorded_step = json!(trace.steps[2]);
    for field in ["outcome", "digests", "reward"] {
        assert_eq!(response["step"][field], recorded_step[field], "{field}");
    }
    let (response, _) = act(&mut session, &json!({"name": "finish", "arguments": {}}));
    assert_eq!(response["ended"], "finished");
    assert_eq!(response["success"], false, "nothing was done");
    let (response, _) = act(&mut session, &recorded);
    assert_eq!(response["response"], "failed");
    let (response, _) = ask(
        &mut session,
        &json!({"request": "branch", "at": trace.steps.len()}),
        &[],
    );
    assert!(
        response["reason"].as_str().unwrap().contains("is over"),
        "{response}"
    );
}

#[test]
fn what_cannot_be_done_is_said() {
    let mut session = Session::default();
    for (request, expected) in [
        (json!({"request": "verify"}), "no episode is open"),
        (
            json!({"request": "execute", "episode": 0}),
            "no bundle is open",
        ),
        (json!({"request": "dance"}), "the request cannot be read"),
        (json!({"request": "open", "name": "a.mcap"}), "a.mcap"),
        (json!({"request": "open_bundle"}), "no bundle"),
    ] {
        let (response, _) = ask(&mut session, &request, b"hello");
        let reason = response["reason"].as_str().unwrap();
        assert!(reason.contains(expected), "{request}: {reason}");
    }
    let path = golden("FODP_workshop_fall--oracle--0");
    let (mut session, _) = opened(&path);
    let (response, _) = ask(
        &mut session,
        &json!({"request": "open", "name": "b.mcap"}),
        &fs::read(path).unwrap(),
    );
    assert!(
        response["reason"]
            .as_str()
            .unwrap()
            .contains("open another session"),
        "{response}"
    );
}
