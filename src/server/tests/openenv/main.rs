//! The service as an environment of OpenEnv, over sockets of this machine: roles, broken messages,
//! sessions that end with their socket, and episodes that start from a recorded call.

use std::{collections::BTreeSet, future::Future, net::SocketAddr, path::Path, time::Duration};

use futures_util::{SinkExt as _, StreamExt as _};
use reel_replay::{verify_branch, verify_trace};
use reel_server::{AnswerSources, Config, Limits, Play, Role, Service, Tokens};
use reel_trace::{Trace, TraceFiles};
use serde_json::{Value, json};
use tempfile::TempDir;
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::TcpStream,
    sync::oneshot,
    time::{sleep, timeout},
};
use tokio_tungstenite::{
    WebSocketStream, client_async,
    tungstenite::{Message, client::IntoClientRequest as _},
};

/// How long anything may take on a machine that is busy.
const PATIENCE: Duration = Duration::from_secs(60);

/// A client of the WebSocket.
struct Client(WebSocketStream<TcpStream>);

impl Client {
    async fn connect(address: SocketAddr, token: Option<&str>) -> Result<Self, String> {
        let mut request = format!("ws://{address}/ws").into_client_request().unwrap();
        if let Some(token) = token {
            let bearer = format!("Bearer {token}").parse().unwrap();
            request.headers_mut().insert("authorization", bearer);
        }
        let stream = TcpStream::connect(address).await.unwrap();
        let connected = client_async(request, stream).await;
        connected
            .map(|(stream, _)| Self(stream))
            .map_err(|error| error.to_string())
    }

    /// What a text is answered with.
    async fn say(&mut self, text: &str) -> Value {
        self.0.send(Message::text(text)).await.unwrap();
        let answer = timeout(PATIENCE, self.0.next()).await;
        let answer = answer.expect("an answer in time").expect("an open socket");
        serde_json::from_str(answer.unwrap().to_text().unwrap()).unwrap()
    }

    async fn ask(&mut self, message: Value) -> Value {
        self.say(&message.to_string()).await
    }

    async fn reset(&mut self, data: Value) -> Value {
        self.ask(json!({"type": "reset", "data": data})).await["data"].take()
    }

    async fn step(&mut self, name: &str, arguments: Value) -> Value {
        let data = json!({"name": name, "arguments": arguments});
        self.ask(json!({"type": "step", "data": data})).await["data"].take()
    }
}

/// Serves a folder while `client` talks to the server, which has room for so many sessions.
fn serving<C: Future<Output = ()>>(
    folder: &Path,
    sessions: usize,
    client: impl FnOnce(SocketAddr) -> C,
) {
    let config = Config {
        listen: SocketAddr::from(([127, 0, 0, 1], 0)),
        data: folder.to_owned(),
        ingest_new: Some(false),
        play: Play {
            run: Some("test".to_owned()),
            images: false,
            ..Play::default()
        },
        limits: Limits {
            sessions,
            ..Limits::default()
        },
        ..Config::default()
    };
    let runtime = tokio::runtime::Builder::new_multi_thread();
    let runtime = { runtime }.worker_threads(2).enable_all().build().unwrap();
    runtime.block_on(async {
        let service = Service::start(config, TraceFiles::default(), AnswerSources::default());
        let service = service.await.unwrap();
        let address = service.address().unwrap();
        let (stop, stopped) = oneshot::channel::<()>();
        let serving = tokio::spawn(service.run(async { drop(stopped.await) }));
        client(address).await;
        drop(stop);
        serving.await.unwrap();
    });
}

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn token(folder: &Path, name: &str, roles: &[Role]) -> String {
    let tokens = Tokens::open(&folder.join("tokens.toml")).unwrap();
    let roles: BTreeSet<Role> = roles.iter().copied().collect();
    tokens.create(name, roles).unwrap()
}

/// Status of a request without a body, or with an empty object.
async fn status(address: SocketAddr, request: &str, token: Option<&str>) -> u16 {
    let mut stream = TcpStream::connect(address).await.unwrap();
    let proof = token.map_or(String::new(), |it| {
        format!("authorization: Bearer {it}\r\n")
    });
    let body = if request.starts_with("POST") {
        "{}"
    } else {
        ""
    };
    let length = body.len();
    let head = format!(
        "{request} HTTP/1.1\r\nhost: {address}\r\n{proof}content-length: {length}\r\nconnection: close\r\n\r\n{body}"
    );
    stream.write_all(head.as_bytes()).await.unwrap();
    let mut answer = Vec::new();
    timeout(PATIENCE, stream.read_to_end(&mut answer))
        .await
        .expect("an answer in time")
        .unwrap();
    let answer = String::from_utf8_lossy(&answer);
    answer.split(' ').nth(1).unwrap().parse().unwrap()
}

fn traces(folder: &Path) -> Vec<Trace> {
    let files = std::fs::read_dir(folder.join("traces")).unwrap();
    let mut paths: Vec<_> = files.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    assert!(
        paths.iter().all(|path| path.extension().unwrap() == "mcap"),
        "{paths:?}"
    );
    paths
        .iter()
        .map(|path| Trace::read(path).unwrap())
        .collect()
}

#[test]
fn every_route_but_health_wants_the_role_act() {
    let folder = folder();
    let act = token(folder.path(), "actor", &[Role::Act]);
    let read = token(folder.path(), "reader", &[Role::Read]);
    serving(folder.path(), 20, |address| async move {
        assert_eq!(status(address, "GET /health", None).await, 200);
        let routes = [
            "GET /ws",
            "GET /metadata",
            "GET /schema",
            "GET /state",
            "POST /reset",
            "POST /step",
        ];
        for route in routes {
            assert_eq!(status(address, route, None).await, 401, "{route}");
            assert_eq!(status(address, route, Some("reel_0")).await, 401, "{route}");
            assert_eq!(status(address, route, Some(&read)).await, 403, "{route}");
            let found = status(address, route, Some(&act)).await;
            assert!(
                ![401, 403].contains(&found) && found < 500,
                "{route}: {found}"
            );
        }
        assert!(Client::connect(address, None).await.is_err());
        assert!(Client::connect(address, Some(&read)).await.is_err());
        assert!(Client::connect(address, Some(&act)).await.is_ok());
    });
}

#[test]
fn rewards_and_recorded_episodes_want_the_role_read() {
    let folder = folder();
    let act = token(folder.path(), "actor", &[Role::Act]);
    let both = token(folder.path(), "trainer", &[Role::Act, Role::Read]);
    serving(folder.path(), 20, |address| async move {
        let mut trace = Value::Null;
        for (token, sees) in [(&act, false), (&both, true)] {
            let mut client = Client::connect(address, Some(token)).await.unwrap();
            let begun = client.reset(json!({"seed": 1, "image": true})).await;
            trace = begun["observation"]["metadata"]["trace"].clone();
            let looked = client.step("show_receptacles", json!({})).await;
            let boxes = &looked["observation"]["metadata"]["marker_boxes"];
            let told: Vec<&Value> = boxes
                .as_array()
                .into_iter()
                .flatten()
                .map(|it| &it["id"])
                .collect();
            let markers: Vec<&Value> = looked["observation"]["markers"]
                .as_array()
                .unwrap()
                .iter()
                .collect();
            assert_eq!(told, if sees { markers } else { Vec::new() }, "{boxes}");
            let made = client.step("finish", json!({})).await;
            assert_eq!(made["reward"].is_number(), sees, "{made}");
            assert_eq!(made["done"], true);
        }
        let begin = json!({"type": "reset", "data": {"trace": trace}});
        let mut client = Client::connect(address, Some(&act)).await.unwrap();
        let refused = client.ask(begin.clone()).await;
        let message = refused["data"]["message"].as_str().unwrap();
        assert!(message.contains("role 'read'"), "{refused}");
        let named = json!({"type": "reset", "data": {"seed": 1, "policy": "person-ann"}});
        let refused = client.ask(named.clone()).await;
        let message = refused["data"]["message"].as_str().unwrap();
        assert!(message.contains("to name the policy"), "{refused}");
        drop(client);
        let mut client = Client::connect(address, Some(&both)).await.unwrap();
        let begun = client.ask(begin).await;
        assert_eq!(begun["type"], "observation", "{begun}");
        let wrong = json!({"type": "reset", "data": {"policy": "a b"}});
        assert_eq!(client.ask(wrong).await["type"], "error");
        let begun = client.ask(named).await;
        assert_eq!(begun["type"], "observation", "{begun}");
        client.step("finish", json!({})).await;
    });
    let policies: Vec<String> = traces(folder.path())
        .into_iter()
        .map(|trace| trace.header.policy.name)
        .collect();
    assert!(
        policies.iter().any(|name| name == "person-ann"),
        "{policies:?}"
    );
}

#[test]
fn broken_messages_are_answered_and_the_session_goes_on() {
    let folder = folder();
    serving(folder.path(), 20, |address| async move {
        let mut client = Client::connect(address, None).await.unwrap();
        client.reset(json!({"seed": 1})).await;
        let messages = [
            ("", "INVALID_JSON"),
            ("{\"type\": \"step\"", "INVALID_JSON"),
            ("[]", "VALIDATION_ERROR"),
            ("{\"type\": \"dance\"}", "UNKNOWN_TYPE"),
            ("{\"data\": {}}", "UNKNOWN_TYPE"),
            ("{\"type\": \"step\"}", "VALIDATION_ERROR"),
            (
                "{\"type\": \"step\", \"data\": {\"name\": 3}}",
                "VALIDATION_ERROR",
            ),
            ("{\"type\": \"state\", \"data\": {}}", "VALIDATION_ERROR"),
            (
                "{\"type\": \"reset\", \"data\": {\"tsak\": 1}}",
                "VALIDATION_ERROR",
            ),
            (
                "{\"type\": \"reset\", \"data\": {\"call\": 1}}",
                "VALIDATION_ERROR",
            ),
            (
                "{\"type\": \"reset\", \"data\": {\"task\": \"x\"}}",
                "EXECUTION_ERROR",
            ),
            (
                "{\"type\": \"reset\", \"data\": {\"trace\": \"x\"}}",
                "EXECUTION_ERROR",
            ),
        ];
        for (text, code) in messages {
            let answer = client.say(text).await;
            assert_eq!(
                (&answer["type"], &answer["data"]["code"]),
                (&json!("error"), &json!(code)),
                "{text}"
            );
        }
        let state = client.ask(json!({"type": "state"})).await;
        assert_eq!(state["data"]["status"], "playing", "{state}");
        let made = client.step("walk_around", json!({})).await;
        assert_eq!(made["observation"]["decision"], 1, "{made}");
        client.step("finish", json!({})).await;
        let over = client
            .ask(json!({"type": "step", "data": {"name": "finish"}}))
            .await;
        assert_eq!(over["data"]["code"], "EXECUTION_ERROR");
    });
}

#[test]
fn a_session_ends_with_its_socket_and_its_trace_replays() {
    let folder = folder();
    serving(folder.path(), 2, |address| async move {
        let mut clients = Vec::new();
        for _ in 0..2 {
            let mut client = Client::connect(address, None).await.unwrap();
            client.reset(json!({"seed": 3, "episode_id": "mine"})).await;
            client.step("walk_around", json!({})).await;
            clients.push(client);
        }
        let mut third = Client::connect(address, None).await.unwrap();
        let refused = third.ask(json!({"type": "state"})).await;
        assert_eq!(refused["data"]["code"], "CAPACITY_REACHED", "{refused}");
        assert_eq!(refused["data"]["active_sessions"], 2);
        // One leaves as the contract has it, one just goes.
        let mut polite = clients.pop().unwrap();
        polite
            .0
            .send(Message::text("{\"type\": \"close\"}"))
            .await
            .unwrap();
        drop(clients);
        let freed = async {
            loop {
                let mut client = Client::connect(address, None).await.unwrap();
                if client.ask(json!({"type": "state"})).await["type"] == "state" {
                    return;
                }
                sleep(Duration::from_millis(20)).await;
            }
        };
        timeout(PATIENCE, freed).await.expect("a free session");
    });
    let traces = traces(folder.path());
    assert_eq!(traces.len(), 2);
    for trace in traces {
        assert_eq!(trace.steps.len(), 1);
        assert_eq!(trace.header.policy.parameters["episode_id"], "mine");
        assert!(verify_trace(&trace).is_exact());
    }
}

#[test]
fn episodes_start_from_a_recorded_call_and_are_branches() {
    let folder = folder();
    serving(folder.path(), 20, |address| async move {
        let mut client = Client::connect(address, None).await.unwrap();
        let begun = client.reset(json!({"seed": 2})).await;
        let trace = begun["observation"]["metadata"]["trace"].clone();
        client
            .step("nav_to", json!({"receptacle_name": "table_1"}))
            .await;
        let second = client.step("show_receptacles", json!({})).await;
        client.step("finish", json!({})).await;
        for _ in 0..2 {
            let begun = client
                .reset(json!({"options": {"trace": trace, "call": 1}}))
                .await;
            assert_eq!(begun["observation"]["decision"], 1, "{begun}");
            let again = client.step("show_receptacles", json!({})).await;
            for field in ["text", "markers", "decision"] {
                assert_eq!(again["observation"][field], second["observation"][field]);
            }
            assert_eq!(again["reward"], second["reward"]);
        }
        let late = json!({"type": "reset", "data": {"trace": trace, "call": 3}});
        assert_eq!(client.ask(late).await["data"]["code"], "EXECUTION_ERROR");
    });
    let traces = traces(folder.path());
    let (parents, branches): (Vec<_>, Vec<_>) = traces
        .iter()
        .partition(|trace| trace.header.parent.is_none());
    assert_eq!((parents.len(), branches.len()), (1, 2));
    let mut indices = BTreeSet::new();
    for branch in branches {
        assert!(verify_branch(branch, parents[0]).holds());
        assert_eq!(branch.header.group_id, parents_group(parents[0]));
        indices.extend(branch.header.rollout_index);
    }
    assert_eq!(indices, BTreeSet::from([0, 1]));
}

#[test]
fn who_goes_on_sees_what_the_recorded_agent_saw() {
    let folder = folder();
    serving(folder.path(), 20, |address| async move {
        let mut client = Client::connect(address, None).await.unwrap();
        let begun = client.reset(json!({"seed": 2, "image": true})).await;
        let trace = begun["observation"]["metadata"]["trace"].clone();
        client
            .step("nav_to", json!({"receptacle_name": "table_1"}))
            .await;
        let second = client.step("show_receptacles", json!({})).await;
        client.step("finish", json!({})).await;
        let same = client
            .reset(json!({"trace": trace, "call": 2, "image": true}))
            .await;
        let (seen, recorded) = (&same["observation"], &second["observation"]);
        assert!(recorded["image"].is_string());
        assert_eq!(seen["image"], recorded["image"]);
        let boxes = |observation: &Value| observation["metadata"]["marker_boxes"].clone();
        assert!(boxes(seen).as_array().is_some_and(|it| !it.is_empty()));
        assert_eq!(boxes(seen), boxes(recorded));
        client.step("finish", json!({})).await;
    });
}

/// The prompt group of what starts from call 1 of a trace.
fn parents_group(parent: &Trace) -> Option<String> {
    let name = parent.path.file_stem()?.to_str()?;
    Some(format!("test--{name}--1"))
}
