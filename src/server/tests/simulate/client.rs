//! Clients of a world: agents that play over MCP, and people that upload, delete and look around
//! over REST. What they were answered goes into the ledger; they know nothing of the disk.

use std::{
    sync::{Arc, Mutex, MutexGuard},
    time::Duration,
};

use axum::body::{Body, Bytes, to_bytes};
use hyper::{Request, StatusCode, client::conn::http1};
use hyper_util::rt::TokioIo;
use serde_json::{Value, json};

use crate::{
    ledger::{Ledger, SentCall},
    network::{Network, Wire},
    rng::SeededRng,
};

/// How long a client waits for an answer.
const PATIENCE: Duration = Duration::from_secs(200);
/// How long after its last call a session is closed.
pub const FORGOTTEN_AFTER: Duration = Duration::from_secs(60);
/// Receptacles of the scene, and one that is not there.
const RECEPTACLES: [&str; 4] = ["table_1", "couch_1", "counter_1", "nowhere"];
/// Categories of things that may be in view.
const CATEGORIES: [&str; 3] = ["cup", "book", "alarm clock"];

/// A client, and all that it needs.
pub struct Client {
    pub network: Network,
    pub ledger: Arc<Mutex<Ledger>>,
    pub rng: SeededRng,
    /// Whether the wires have faults.
    pub faults: bool,
}

/// An answer that came whole.
struct Answer {
    status: StatusCode,
    session: Option<String>,
    body: Bytes,
}

impl Answer {
    fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_default()
    }
}

impl Client {
    fn ledger(&self) -> MutexGuard<'_, Ledger> {
        self.ledger.lock().expect("no thread died with it")
    }

    /// One request over a connection of its own; nothing where the answer did not come whole.
    async fn ask(
        &mut self,
        method: &str,
        path: &str,
        headers: &[(&str, &str)],
        body: impl Into<Bytes>,
    ) -> Option<Answer> {
        let wire = if self.faults {
            Wire::any(&mut self.rng)
        } else {
            Wire::GOOD
        };
        let stream = self.network.connect(wire).ok()?;
        let mut request = Request::builder()
            .method(method)
            .uri(path)
            .header("host", "localhost");
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        let request = request.body(Body::from(body.into())).ok()?;
        let answered = tokio::time::timeout(PATIENCE, exchange(stream, request)).await;
        let answer = answered.ok().flatten();
        let mut ledger = self.ledger();
        let seen = answer.as_ref().map(|answer| answer.status.as_u16());
        ledger.saw(&format!("{method} {path} {seen:?}"));
        if let Some(answer) = &answer
            && answer.status.is_server_error()
        {
            ledger.refused(method, path, answer.status, &answer.body);
        }
        drop(ledger);
        answer
    }

    /// One message of MCP; the result of the one of that id, where it came.
    async fn message(
        &mut self,
        worker: &str,
        session: Option<&str>,
        message: &Value,
    ) -> (Option<String>, Option<Value>) {
        let path = format!("/w/{worker}/mcp");
        let mut headers = vec![
            ("content-type", "application/json"),
            ("accept", "application/json, text/event-stream"),
        ];
        headers.extend(session.map(|session| ("mcp-session-id", session)));
        let answer = self.ask("POST", &path, &headers, message.to_string()).await;
        let Some(answer) = answer.filter(|answer| answer.status.is_success()) else {
            return (None, None);
        };
        let text = String::from_utf8_lossy(&answer.body).into_owned();
        let messages = text
            .lines()
            .map(|line| line.strip_prefix("data:").unwrap_or(line).trim())
            .filter_map(|line| serde_json::from_str::<Value>(line).ok());
        let mut own = messages.filter(|found| found["id"] == message["id"]);
        let result = own.find_map(|found| found.get("result").cloned());
        (answer.session, result)
    }

    /// Plays in the session of a worker, and closes it at the end or does not.
    pub async fn play(mut self, worker: String, policy: String, calls: u64) {
        if self.rng.once_in(3) {
            let lease =
                json!({"worker": worker, "task_id": self.ledger().task.clone(), "rollouts": 3});
            let headers = [("content-type", "application/json")];
            self.ask("POST", "/api/leases", &headers, lease.to_string())
                .await;
        }
        let (mut visits, mut left) = (0, calls);
        while left > 0 {
            // Who comes back under a name of its own is told from who was here before.
            let policy = format!("{policy}-{visits}");
            visits += 1;
            let Some(session) = self.initialize(&worker, &policy).await else {
                break;
            };
            let mut id = 0;
            while left > 0 {
                (id, left) = (id + 1, left - 1);
                let sent = self.any_call(id == 1);
                self.call(&worker, &session, &policy, id, sent).await;
                if self.faults && self.rng.once_in(8) {
                    tokio::time::sleep(Duration::from_secs(self.rng.below(50))).await;
                }
                if self.faults && self.rng.once_in(12) {
                    tokio::time::sleep(FORGOTTEN_AFTER + Duration::from_secs(5)).await;
                    break;
                }
            }
        }
        if self.rng.once_in(2) {
            let path = format!("/api/sessions/w-{worker}");
            self.ask("DELETE", &path, &[], "").await;
        }
    }

    async fn initialize(&mut self, worker: &str, policy: &str) -> Option<String> {
        let hello = json!({"jsonrpc": "2.0", "id": 0, "method": "initialize", "params": {
            "protocolVersion": "2025-06-18", "capabilities": {},
            "clientInfo": {"name": policy, "version": "1"}}});
        for _ in 0..4 {
            let (session, result) = self.message(worker, None, &hello).await;
            let (Some(session), Some(_)) = (session, result) else {
                continue;
            };
            let done = json!({"jsonrpc": "2.0", "method": "notifications/initialized"});
            self.message(worker, Some(&session), &done).await;
            return Some(session);
        }
        None
    }

    fn any_call(&mut self, first: bool) -> (&'static str, Value) {
        match self.rng.below(10) {
            _ if first => ("finish", json!({})),
            0 if self.rng.once_in(2) => ("finish", json!({})),
            1 => ("ask", json!({"question": "Which one do you mean?"})),
            2 => ("pick", json!({"marker_id": "1"})),
            3 => {
                let category = *self.rng.pick(&CATEGORIES);
                (
                    "show_object_by_category",
                    json!({"target_category": category}),
                )
            }
            4 => ("walk_around", json!({})),
            _ => {
                let receptacle = *self.rng.pick(&RECEPTACLES);
                ("nav_to", json!({"receptacle_name": receptacle}))
            }
        }
    }

    async fn call(
        &mut self,
        worker: &str,
        session: &str,
        policy: &str,
        id: u64,
        (name, arguments): (&'static str, Value),
    ) {
        let sent = SentCall::new(policy, name, arguments.clone());
        let number = self.ledger().send(worker, sent);
        let message = json!({"jsonrpc": "2.0", "id": id, "method": "tools/call",
            "params": {"name": name, "arguments": arguments}});
        let (_, result) = self.message(worker, Some(session), &message).await;
        if let Some(result) = result {
            let said = &result["structuredContent"];
            // What was refused was not recorded, and has neither.
            let recorded = !said["decision"].is_null() || !said["episode"].is_null();
            let text = said["text"].as_str().unwrap_or_default();
            self.ledger().answered(worker, number, recorded, text);
        }
    }

    /// Uploads, deletes and looks around.
    pub async fn keep_traces(mut self, own: String, times: u64) {
        for _ in 0..times {
            let own = self
                .rng
                .once_in(2)
                .then(|| format!("{own}-{}", self.rng.below(2)));
            match self.rng.below(6) {
                0..=2 => {
                    let name = own.unwrap_or_else(|| format!("shared-{}", self.rng.below(2)));
                    self.upload(&name).await;
                }
                3 => {
                    if let Some(name) = own {
                        self.delete(&name).await;
                    }
                }
                4 => self.look().await,
                _ => {
                    let idle = Duration::from_millis(self.rng.below(2_000));
                    tokio::time::sleep(idle).await;
                }
            }
        }
    }

    async fn upload(&mut self, name: &str) {
        let (content, mut bytes) = {
            let ledger = self.ledger.lock().expect("no thread died with it");
            let content = self.rng.below(ledger.samples.len() as u64) as usize;
            (content, ledger.samples[content].clone())
        };
        let whole = !self.rng.once_in(5);
        if !whole {
            let torn = self.rng.below(bytes.len() as u64) as usize;
            bytes.truncate(torn);
        }
        self.ledger().uploads(name, content);
        let answer = self
            .ask("PUT", &format!("/api/traces/{name}"), &[], bytes)
            .await;
        match answer.map(|answer| answer.status) {
            Some(StatusCode::CREATED) if whole => self.ledger().uploaded(name, content),
            Some(StatusCode::CREATED) => self
                .ledger()
                .violated(format!("{name}: half a trace was taken")),
            _ => {}
        }
    }

    async fn delete(&mut self, name: &str) {
        self.ledger().deletes(name);
        let answer = self
            .ask("DELETE", &format!("/api/traces/{name}"), &[], "")
            .await;
        if answer.is_some_and(|answer| answer.status == StatusCode::NO_CONTENT) {
            self.ledger().deleted(name);
        }
    }

    async fn look(&mut self) {
        let Some(list) = self.ask("GET", "/api/traces", &[], "").await else {
            return;
        };
        let list = list.json();
        let traces: Vec<&Value> = list["traces"].as_array().into_iter().flatten().collect();
        let whole: Vec<&str> = traces
            .into_iter()
            .filter(|trace| trace["recording"] == false)
            .filter_map(|trace| trace["trace"].as_str())
            .collect();
        if let Some(name) = (!whole.is_empty()).then(|| *self.rng.pick(&whole)) {
            self.ask("GET", &format!("/api/traces/{name}/episode"), &[], "")
                .await;
        }
    }
}

/// Sends a request and takes its answer in.
async fn exchange(stream: tokio::io::DuplexStream, request: Request<Body>) -> Option<Answer> {
    let (mut sender, connection) = http1::handshake(TokioIo::new(stream)).await.ok()?;
    let connection = tokio::spawn(connection);
    let taken = async {
        let response = sender.send_request(request).await.ok()?;
        let status = response.status();
        let session = response.headers().get("mcp-session-id");
        let session = session.and_then(|value| value.to_str().ok().map(str::to_owned));
        let body = to_bytes(Body::new(response.into_body()), usize::MAX)
            .await
            .ok()?;
        Some(Answer {
            status,
            session,
            body,
        })
    };
    let answer = taken.await;
    connection.abort();
    answer
}
