//! The client against an endpoint that answers, hesitates, breaks off, and tells nonsense.

use reel_vectors::scripted;
use std::{
    fs,
    io::{Read, Write},
    net::TcpListener,
    path::Path,
    sync::Arc,
    thread,
    time::Duration,
};

use reel_llm::client::{
    ApiKey, Cache, CallLog, Client, Endpoint, LoggedCall, Message, ModelError, Part, Request, Role,
};
use scripted::{Act, Scripted, TestClock, completion, no_endpoint};
use serde_json::json;

const SECRET: &str = "sk-very-secret-0123456789";

fn endpoint(base_url: &str) -> Endpoint {
    Endpoint {
        api_key: Some(ApiKey::new(SECRET).unwrap()),
        retries: 3,
        timeout: Duration::from_secs(20),
        ..Endpoint::new(base_url, "judge-1")
    }
}

fn client(base_url: &str) -> (Client, Arc<TestClock>) {
    let clock = Arc::new(TestClock::default());
    (
        Client::new(endpoint(base_url), clock.clone()).unwrap(),
        clock,
    )
}

fn ask(text: &str) -> Request {
    Request {
        messages: vec![
            Message::text(Role::System, "be short"),
            Message::text(Role::User, text),
        ],
        ..Request::default()
    }
}

fn calls(path: &Path) -> Vec<LoggedCall> {
    fs::read_to_string(path)
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

#[test]
fn a_plain_answer() {
    let server = Scripted::start(vec![Act::Reply("fine".to_owned())]);
    let (client, clock) = client(&server.base_url);
    let reply = client.complete(&ask("how?")).unwrap();
    assert_eq!(
        (reply.text.as_str(), reply.truncated, reply.cached),
        ("fine", false, false)
    );
    assert_eq!(
        (reply.tokens_read, reply.tokens_written, reply.latency_ns),
        (Some(11), Some(3), 1_000_000)
    );
    assert!(clock.pauses_s().is_empty());
    let [received] = server.received().try_into().ok().unwrap();
    assert!(
        received
            .head
            .starts_with("POST /v1/chat/completions HTTP/1.1\r\n"),
        "{}",
        received.head
    );
    assert!(
        received.head.contains(&format!("Bearer {SECRET}")),
        "{}",
        received.head
    );
    let messages =
        json!([{"role": "system", "content": "be short"}, {"role": "user", "content": "how?"}]);
    assert_eq!(
        received.body,
        json!({"model": "judge-1", "messages": messages, "temperature": 0.0, "max_tokens": 2048})
    );
}

#[test]
fn without_a_key_none_is_sent_and_extra_fields_replace_ours() {
    let server = Scripted::start(vec![Act::Reply("fine".to_owned())]);
    let extra = json!({"seed": 7, "max_tokens": null, "max_completion_tokens": 9});
    let endpoint = Endpoint {
        extra: extra.as_object().unwrap().clone(),
        ..Endpoint::new(&server.base_url, "m")
    };
    Client::new(endpoint, Arc::new(TestClock::default()))
        .unwrap()
        .complete(&ask("how?"))
        .unwrap();
    let received = &server.received()[0];
    assert!(
        !received.head.to_lowercase().contains("authorization"),
        "{}",
        received.head
    );
    assert_eq!(
        (
            &received.body["seed"],
            &received.body["max_completion_tokens"]
        ),
        (&json!(7), &json!(9))
    );
    assert!(
        received.body.get("max_tokens").is_none(),
        "{}",
        received.body
    );
}

#[test]
fn images_go_as_data_urls() {
    let server = Scripted::start(vec![Act::Reply("a mug".to_owned())]);
    let image = Part::Image {
        media_type: "image/png".to_owned(),
        bytes: b"\x89PNG\x00\xff".to_vec(),
    };
    let message = Message::new(Role::User, vec![Part::Text("what?".to_owned()), image]);
    client(&server.base_url)
        .0
        .complete(&Request {
            messages: vec![message],
            ..Request::default()
        })
        .unwrap();
    let expected = json!([
        {"type": "text", "text": "what?"},
        {"type": "image_url", "image_url": {"url": "data:image/png;base64,iVBORwD/"}},
    ]);
    assert_eq!(
        server.received()[0].body["messages"][0]["content"],
        expected
    );
}

#[test]
fn a_limit_is_waited_for_as_the_endpoint_asks_but_not_for_ever() {
    let limit = |headers| Act::Status(429, headers, r#"{"error": "slow down"}"#.to_owned());
    let server = Scripted::start(vec![
        limit("Retry-After: 7\r\n"),
        limit("Retry-After: 86400\r\n"),
        limit("Retry-After: Fri, 31 Dec 1999 23:59:59 GMT\r\n"),
        Act::Reply("now".to_owned()),
    ]);
    let (client, clock) = client(&server.base_url);
    assert_eq!(client.complete(&ask("how?")).unwrap().text, "now");
    assert_eq!(clock.pauses_s(), [7, 60, 4]);
}

#[test]
fn trouble_of_the_endpoint_is_tried_again_until_it_is_enough() {
    let server = Scripted::answering(|_| Act::Status(503, "", "overloaded\n\x1b[31m".to_owned()));
    let (client, clock) = client(&server.base_url);
    let error = client.complete(&ask("how?")).unwrap_err();
    assert!(
        matches!(
            &error,
            ModelError::Status {
                status: 503,
                attempts: 4,
                ..
            }
        ),
        "{error:?}"
    );
    let message = error.to_string();
    for word in [
        "503",
        "4 tries",
        "overloaded",
        "see its log",
        &server.base_url,
    ] {
        assert!(message.contains(word), "{word}: {message}");
    }
    assert!(!message.contains(char::is_control), "{message:?}");
    assert_eq!(clock.pauses_s(), [1, 2, 4]);
    assert_eq!(server.received().len(), 4);
}

#[test]
fn a_no_is_not_asked_again() {
    for (status, word) in [
        (400, "max_tokens"),
        (401, "key"),
        (404, "/v1"),
        (307, "leads"),
    ] {
        let server = Scripted::answering(move |_| {
            Act::Status(
                status,
                "Location: http://127.0.0.1:9/v1\r\n",
                "no".to_owned(),
            )
        });
        let (client, clock) = client(&server.base_url);
        let message = client.complete(&ask("how?")).unwrap_err().to_string();
        assert!(
            message.contains(&status.to_string()) && message.contains(word),
            "{message}"
        );
        assert!(
            clock.pauses_s().is_empty() && server.received().len() == 1,
            "{status}"
        );
    }
}

#[test]
fn a_cut_answer_is_asked_for_again() {
    let body = completion("whole");
    let head = |rest: &str| format!("HTTP/1.1 200 OK\r\n{rest}\r\n");
    let server = Scripted::start(vec![
        Act::Raw(String::new()),
        Act::Raw(format!(
            "{}{}",
            head(&format!("Content-Length: {}\r\n", body.len())),
            &body[..40]
        )),
        Act::Raw(format!("{}{}", head("Connection: close\r\n"), &body[..40])),
        Act::Reply("whole".to_owned()),
    ]);
    let (retrying, clock) = client(&server.base_url);
    assert_eq!(retrying.complete(&ask("how?")).unwrap().text, "whole");
    assert_eq!(clock.pauses_s(), [1, 2, 4]);

    let server = Scripted::answering(move |_| {
        Act::Raw(format!("{}5\r\nab", head("Transfer-Encoding: chunked\r\n")))
    });
    let error = client(&server.base_url)
        .0
        .complete(&ask("how?"))
        .unwrap_err();
    assert!(
        matches!(error, ModelError::Cut { attempts: 4, .. }),
        "{error:?}"
    );
}

#[test]
fn gibberish_is_said_to_be_that() {
    for body in [
        "<html>welcome</html>",
        r#"{"choices": "none"}"#,
        r#"{"error": {"message": "no such model"}}"#,
    ] {
        let server = Scripted::answering(move |_| Act::Status(200, "", body.to_owned()));
        let error = client(&server.base_url)
            .0
            .complete(&ask("how?"))
            .unwrap_err();
        assert!(matches!(error, ModelError::Answer { .. }), "{error:?}");
        assert!(error.to_string().contains(body), "{error}");
        assert_eq!(server.received().len(), 1);
    }
}

#[test]
fn nobody_there() {
    let (client, clock) = client(&no_endpoint());
    let error = client.complete(&ask("how?")).unwrap_err();
    assert!(
        error.is_unreachable() && error.to_string().contains("4 tries"),
        "{error:?}"
    );
    assert_eq!(clock.pauses_s(), [1, 2, 4]);
}

#[test]
fn an_endpoint_that_never_answers_costs_the_timeout() {
    let server = Scripted::answering(|_| Act::Hang);
    let endpoint = Endpoint {
        timeout: Duration::from_millis(50),
        retries: 1,
        ..endpoint(&server.base_url)
    };
    let clock = Arc::new(TestClock::default());
    let error = Client::new(endpoint, clock.clone())
        .unwrap()
        .complete(&ask("how?"))
        .unwrap_err();
    assert!(
        matches!(
            error,
            ModelError::Timeout {
                attempts: 2,
                timeout_s: 0.05,
                ..
            }
        ),
        "{error:?}"
    );
    assert_eq!(clock.pauses_s(), [1]);
}

/// Also that the cryptography behind `https` is there at all: it is chosen when the
/// first connection is made.
#[test]
fn an_endpoint_that_does_not_speak_tls_is_not_asked_again() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let base_url = format!("https://{}/v1", listener.local_addr().unwrap());
    thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = stream.unwrap();
            let _hello = stream.read(&mut [0; 4096]);
            stream
                .write_all(b"HTTP/1.1 400 Bad Request\r\n\r\n")
                .unwrap();
        }
    });
    let (client, clock) = client(&base_url);
    let error = client.complete(&ask("how?")).unwrap_err();
    assert!(
        matches!(error, ModelError::Tls { .. }) && clock.pauses_s().is_empty(),
        "{error:?}"
    );
}

#[test]
fn an_equal_request_is_not_asked_twice() {
    let folder = tempfile::tempdir().unwrap();
    let server = Scripted::start(vec![
        Act::Reply("one".to_owned()),
        Act::Reply("two".to_owned()),
        Act::Reply("three".to_owned()),
    ]);
    let log = folder.path().join("calls.jsonl");
    let cache = Cache::open(folder.path().join("cache")).unwrap();
    let (client, _) = client(&server.base_url);
    let client = client
        .with_cache(cache.clone())
        .with_log(CallLog::append(&log).unwrap());

    let first = client.complete(&ask("a")).unwrap();
    let again = client.complete(&ask("a")).unwrap();
    assert_eq!(
        again,
        reel_llm::client::Reply {
            cached: true,
            ..first.clone()
        }
    );
    assert_eq!(
        (client.cached(&ask("a")), client.cached(&ask("b"))),
        (Some(again.clone()), None)
    );
    assert_eq!(client.complete(&ask("b")).unwrap().text, "two");
    assert_eq!(server.received().len(), 2);

    // one flipped letter of the answer, and a torn file, are as good as nothing and are mended
    let path = cache.path(&first.request);
    let whole = fs::read_to_string(&path).unwrap();
    fs::write(&path, whole.replace("\"one\"", "\"ome\"")).unwrap();
    assert_eq!(client.complete(&ask("a")).unwrap().text, "three");
    assert_eq!(client.complete(&ask("a")).unwrap().text, "three");
    fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    assert!(matches!(
        client.complete(&ask("a")),
        Err(ModelError::Status { status: 501, .. })
    ));
    fs::write(&path, whole).unwrap();
    assert_eq!(client.complete(&ask("a")).unwrap(), again);

    let calls = calls(&log);
    assert_eq!(
        calls.iter().map(|call| call.cached).collect::<Vec<_>>(),
        [false, true, false, false, true, false, true]
    );
    assert_eq!(
        calls.iter().map(|call| call.attempts).collect::<Vec<_>>(),
        [1, 0, 1, 1, 0, 4, 0]
    );
    assert_eq!(
        (
            calls[0].request,
            calls[0].prompt_tokens,
            calls[0].model.as_str()
        ),
        (first.request, Some(11), "judge-1")
    );
    assert!(
        calls[5].error.as_ref().unwrap().contains("501"),
        "{:?}",
        calls[5]
    );
    assert!(
        calls
            .windows(2)
            .all(|pair| pair[0].time_ns < pair[1].time_ns)
    );
}

#[test]
fn parameters_make_another_request_and_the_address_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let server = Scripted::answering(|_| Act::Reply("x".to_owned()));
    let other = Scripted::answering(|_| Act::Reply("y".to_owned()));
    let cached = |endpoint: Endpoint| {
        let client = Client::new(endpoint, Arc::new(TestClock::default())).unwrap();
        client
            .with_cache(Cache::open(folder.path()).unwrap())
            .complete(&ask("a"))
            .unwrap()
            .cached
    };
    assert!(!cached(endpoint(&server.base_url)));
    assert!(cached(Endpoint {
        api_key: None,
        retries: 0,
        ..endpoint(&other.base_url)
    }));
    assert!(!cached(Endpoint {
        temperature: 0.5,
        ..endpoint(&server.base_url)
    }));
    assert!(!cached(Endpoint {
        model: "judge-2".to_owned(),
        ..endpoint(&server.base_url)
    }));
}

#[test]
fn the_key_is_nowhere() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("calls.jsonl");
    let acts = ["no such key: ", "your key was "].map(|words| format!("{words}{SECRET}"));
    let [refusal, answer] = acts;
    let server = Scripted::start(vec![
        Act::Status(401, "", refusal),
        Act::Reply(answer),
        Act::Raw(format!("{SECRET}\r\n\r\n")),
    ]);
    let clock = Arc::new(TestClock::default());
    let endpoint = Endpoint {
        retries: 0,
        ..endpoint(&server.base_url)
    };
    assert!(!format!("{endpoint:?}").contains(SECRET));
    let client = Client::new(endpoint, clock)
        .unwrap()
        .with_cache(Cache::open(folder.path().join("cache")).unwrap());
    let client = client.with_log(CallLog::append(&log).unwrap());
    let mut shown = Vec::new();
    for _ in 0..3 {
        shown.push(format!(
            "{:?}",
            client.complete(&ask(&shown.len().to_string()))
        ));
    }
    assert!(
        shown[0].contains("no such key: [redacted:key]")
            && shown[1].contains("your key was [redacted:key]"),
        "{shown:?}"
    );
    shown.push(fs::read_to_string(&log).unwrap());
    let kept: Vec<_> = fs::read_dir(folder.path().join("cache"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    assert_eq!(kept.len(), 1);
    shown.extend(
        kept.iter()
            .map(|path| format!("{} {}", path.display(), fs::read_to_string(path).unwrap())),
    );
    for text in shown {
        assert!(!text.contains(SECRET), "{text}");
    }
}

#[test]
fn many_threads_share_a_client() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("calls.jsonl");
    let server = Scripted::answering(|request| {
        Act::Reply(
            request.body["messages"][1]["content"]
                .as_str()
                .unwrap()
                .to_owned(),
        )
    });
    let (client, _) = client(&server.base_url);
    let client = client
        .with_cache(Cache::open(folder.path()).unwrap())
        .with_log(CallLog::append(&log).unwrap());
    thread::scope(|scope| {
        for thread in 0..8 {
            let client = &client;
            scope.spawn(move || {
                for question in 0..10 {
                    let text = format!("question {}", (question + thread) % 10);
                    assert_eq!(client.complete(&ask(&text)).unwrap().text, text);
                }
            });
        }
    });
    assert_eq!(calls(&log).len(), 80);
}

#[test]
fn what_cannot_be_written_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    for error in [
        Cache::open(file.join("cache")).err().unwrap(),
        CallLog::append(file.join("log")).err().unwrap(),
    ] {
        assert!(matches!(error, ModelError::Write { .. }), "{error:?}");
    }
    let server = Scripted::start(vec![Act::Reply("lost".to_owned())]);
    let cache = Cache::open(folder.path().join("cache")).unwrap();
    fs::remove_dir(folder.path().join("cache")).unwrap();
    let error = client(&server.base_url)
        .0
        .with_cache(cache)
        .complete(&ask("a"))
        .unwrap_err();
    assert!(error.to_string().contains("keep a reply"), "{error}");
}

/// The vector of a text: its length and 1.
fn embedded(received: &scripted::Received) -> Act {
    let texts = received.body["input"].as_array().unwrap();
    let data: Vec<_> = texts
        .iter()
        .map(|text| json!({"embedding": [text.as_str().unwrap().len(), 1]}))
        .collect();
    Act::Status(200, "", json!({"data": data}).to_string())
}

#[test]
fn vectors_are_kept_text_by_text() {
    let folder = tempfile::tempdir().unwrap();
    let server = Scripted::answering(embedded);
    let client = client(&server.base_url)
        .0
        .with_cache(Cache::open(folder.path()).unwrap());
    let asked = || -> Vec<String> {
        let texts = |it: &scripted::Received| it.body["input"].to_string();
        server.received().iter().map(texts).collect()
    };
    assert_eq!(
        client.embed(&["cup", "plate"]).unwrap(),
        [[3.0, 1.0], [5.0, 1.0]]
    );
    assert_eq!(
        client.embed(&["bowl", "cup"]).unwrap(),
        [[4.0, 1.0], [3.0, 1.0]]
    );
    assert_eq!(asked(), [r#"["cup","plate"]"#, r#"["bowl"]"#]);
    // A file that is not as it was written is as good as none.
    for file in fs::read_dir(folder.path()).unwrap() {
        let path = file.unwrap().path();
        let text = fs::read_to_string(&path).unwrap();
        fs::write(&path, text.replace("3.0", "9.0")).unwrap();
    }
    assert_eq!(client.embed(&["cup"]).unwrap(), [[3.0, 1.0]]);
    assert_eq!(asked().len(), 3);
}

#[test]
fn vectors_without_end_are_no_answer() {
    let endless = r#"{"data": [{"embedding": [1e39]}]}"#;
    let server = Scripted::answering(move |_| Act::Status(200, "", endless.to_owned()));
    let error = client(&server.base_url).0.embed(&["cup"]).unwrap_err();
    assert!(error.to_string().contains("finite"), "{error}");
}
