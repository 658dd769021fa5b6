//! Tests of the module above.

use std::net::SocketAddr;

use axum::Router;
use rmcp::{
    ErrorData, RoleServer, ServerHandler,
    model::{CallToolRequestParams, CallToolResponse, CallToolResult, ContentBlock},
    service::RequestContext,
};
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::{TcpListener, TcpStream},
    time::timeout,
};
use tokio_util::sync::CancellationToken;

use super::*;
use crate::router::serve;

const FRAME: usize = 130_000;
const PATIENCE: Duration = Duration::from_secs(20);
const PING: &str = r#"{"jsonrpc":"2.0","id":8,"method":"ping"}"#;
/// The last of an answer to a call.
const ANSWERED: &str = "AnswerEnds";

/// Answers `now` at once, and `slow` when the test lets it; `tell` tells the client, on no
/// stream of a request.
struct Slow(Arc<Semaphore>);

impl ServerHandler for Slow {
    async fn call_tool(
        &self,
        request: CallToolRequestParams,
        context: RequestContext<RoleServer>,
    ) -> Result<CallToolResponse, ErrorData> {
        match &*request.name {
            "slow" => self.0.acquire().await.unwrap().forget(),
            "tell" => context.peer.notify_tool_list_changed().await.unwrap(),
            _ => {}
        }
        let frame = ContentBlock::image("p".repeat(FRAME), "image/png");
        Ok(CallToolResult::success(vec![frame, ContentBlock::text(ANSWERED)]).into())
    }
}

struct Server {
    address: SocketAddr,
    sessions: Arc<Sessions>,
    gate: Arc<Semaphore>,
}

impl Server {
    async fn new(limit: usize) -> Self {
        let (sessions, gate) = (
            Sessions::new(limit, limit, Duration::from_secs(3_600)),
            Arc::new(Semaphore::new(0)),
        );
        let factory = {
            let gate = gate.clone();
            move || Slow(gate.clone())
        };
        let service = serve(sessions.clone(), factory, 1 << 20, CancellationToken::new());
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        tokio::spawn(
            async move { axum::serve(listener, Router::new().route("/mcp", service)).await },
        );
        Self {
            address,
            sessions,
            gate,
        }
    }

    /// A request as it goes over the wire. Of HTTP/1.0, so that the answer comes as it is.
    async fn send(&self, method: &str, headers: &str, body: &str) -> TcpStream {
        let length = body.len();
        let request = format!(
            "{method} /mcp HTTP/1.0\r\nHost: localhost\r\nAccept: application/json, text/event-stream\r\n\
             Content-Type: application/json\r\nContent-Length: {length}\r\n{headers}\r\n{body}"
        );
        let mut stream = TcpStream::connect(self.address).await.unwrap();
        stream.write_all(request.as_bytes()).await.unwrap();
        stream
    }

    /// What comes in answer to `initialize`.
    async fn initialize(&self) -> String {
        let body = r#"{"jsonrpc":"2.0","id":1,"method":"initialize","params":{"protocolVersion":"2025-11-25",
            "capabilities":{},"clientInfo":{"name":"raw","version":"1"}}}"#;
        read(&mut self.send("POST", "", body).await, None).await
    }

    async fn open(&self) -> Client<'_> {
        let answer = self.initialize().await;
        let (_, rest) = answer
            .split_once("mcp-session-id: ")
            .unwrap_or_else(|| panic!("{answer}"));
        let id = rest.split_once("\r\n").unwrap().0.to_owned();
        let client = Client { server: self, id };
        let answer = client
            .post(r#"{"jsonrpc":"2.0","method":"notifications/initialized"}"#)
            .await;
        assert!(answer.contains(" 202 "), "{answer}");
        client
    }

    fn kept(&self) -> usize {
        self.sessions.events.usage().events
    }

    /// Waits until an answer more is kept.
    async fn answered(&self, kept: usize) {
        let waits = async {
            while self.kept() <= kept {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        };
        timeout(PATIENCE, waits).await.expect("an answer");
    }
}

struct Client<'a> {
    server: &'a Server,
    id: String,
}

impl Client<'_> {
    async fn send(&self, method: &str, headers: &str, body: &str) -> TcpStream {
        self.server
            .send(
                method,
                &format!("Mcp-Session-Id: {}\r\n{headers}", self.id),
                body,
            )
            .await
    }

    async fn post(&self, body: &str) -> String {
        read(&mut self.send("POST", "", body).await, None).await
    }

    /// Posts a call, and waits for its first event.
    async fn call(&self, tool: &str) -> (TcpStream, String) {
        let body = format!(
            r#"{{"jsonrpc":"2.0","id":7,"method":"tools/call","params":{{"name":"{tool}","arguments":{{}}}}}}"#
        );
        let mut stream = self.send("POST", "", &body).await;
        let event = read(&mut stream, Some("\n\n")).await;
        (stream, id(&event))
    }

    async fn resume(&self, last: &str) -> TcpStream {
        self.send("GET", &format!("Last-Event-ID: {last}\r\n"), "")
            .await
    }
}

/// What comes up to a text, or to the end.
async fn read(stream: &mut TcpStream, end: Option<&str>) -> String {
    let mut said = Vec::new();
    let reads = async {
        // The head has an end of its own.
        while end.is_none_or(|end| !String::from_utf8_lossy(&said).contains(end)) {
            match stream.read_buf(&mut said).await {
                Ok(0) | Err(_) => break,
                Ok(_) => {}
            }
        }
    };
    timeout(PATIENCE, reads).await.expect("an answer");
    String::from_utf8(said).unwrap()
}

/// Cuts a connection, and waits until the server has noticed.
async fn cut(mut stream: TcpStream) {
    stream.shutdown().await.unwrap();
    let rest = read(&mut stream, None).await;
    assert!(!rest.contains(ANSWERED), "it was not cut before the answer");
}

/// The id of the last event.
fn id(events: &str) -> String {
    events
        .rsplit_once("id: ")
        .unwrap_or_else(|| panic!("{events}"))
        .1
        .lines()
        .next()
        .unwrap()
        .to_owned()
}

#[tokio::test]
async fn an_answer_that_came_while_the_client_was_cut_off_is_fetched() {
    let server = Server::new(9).await;
    let (client, other) = (server.open().await, server.open().await);
    let (stream, primed) = client.call("slow").await;
    cut(stream).await;
    server.gate.add_permits(1);
    server.answered(0).await;
    assert!(client.post(PING).await.contains(r#""id":8"#));
    assert_eq!(server.kept(), 2, "the answer, and that to the ping");
    assert!(
        !read(&mut other.resume(&primed).await, None)
            .await
            .contains(ANSWERED),
        "the answer of somebody else"
    );
    let answer = read(&mut client.resume(&primed).await, None).await;
    assert!(
        answer.contains(ANSWERED) && answer.contains(r#""id":7"#) && answer.len() > FRAME,
        "{answer:.300}"
    );
    assert_eq!(id(&answer), "2/1");
    // It may have been lost again, until the client goes on.
    assert!(
        read(&mut client.resume(&primed).await, None)
            .await
            .contains(ANSWERED)
    );
    client.post(PING).await;
    assert!(
        !read(&mut client.resume(&primed).await, None)
            .await
            .contains(ANSWERED)
    );
    assert_eq!(server.kept(), 1, "the ping");
}

#[tokio::test]
async fn an_answer_that_comes_after_the_client_has_come_back_is_fetched_as_well() {
    let server = Server::new(9).await;
    let client = server.open().await;
    let (stream, primed) = client.call("slow").await;
    cut(stream).await;
    let mut resumed = client.resume(&primed).await;
    read(&mut resumed, Some("\r\n\r\n")).await;
    server.gate.add_permits(1);
    assert!(read(&mut resumed, None).await.contains(ANSWERED));
    // Also on a connection that nobody knows to be cut: the client is never asked whether
    // it has the answer.
    let (stream, primed) = client.call("slow").await;
    server.gate.add_permits(1);
    server.answered(0).await;
    drop(stream);
    assert!(
        read(&mut client.resume(&primed).await, None)
            .await
            .contains(ANSWERED)
    );
}

#[tokio::test]
async fn what_was_said_while_nobody_listened_is_heard_once() {
    let server = Server::new(9).await;
    let client = server.open().await;
    for round in 1..=2 {
        let answer = read(&mut client.call("tell").await.0, Some(ANSWERED)).await;
        assert!(answer.contains(ANSWERED));
        let mut listening = client.send("GET", "", "").await;
        let heard = read(&mut listening, Some("list_changed")).await;
        assert_eq!(
            (id(&heard), heard.matches("list_changed").count()),
            (round.to_string(), 1),
            "{heard}"
        );
        cut(listening).await;
    }
    let heard = read(&mut client.resume("1").await, Some("list_changed")).await;
    assert_eq!(id(&heard), "2", "{heard}");
}

#[tokio::test]
async fn answers_take_a_bounded_memory() {
    let server = Server::new(9).await;
    let mut clients = Vec::new();
    for _ in 0..3 {
        clients.push(server.open().await);
    }
    // Of clients that go on, no more than the last answer.
    for _ in 0..12 {
        for client in &clients {
            assert!(
                read(&mut client.call("now").await.0, None)
                    .await
                    .contains(ANSWERED)
            );
        }
        assert!(server.kept() <= clients.len(), "{}", server.kept());
    }
    // Of one that is cut off again and again, what a session may have.
    for _ in 0..24 {
        cut(clients[0].call("slow").await.0).await;
    }
    server.gate.add_permits(24);
    let all = async {
        while server.gate.available_permits() > 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    timeout(PATIENCE, all).await.expect("every answer");
    for client in &clients {
        client.post(PING).await;
    }
    let kept = server.sessions.events.usage();
    assert!(
        kept.bytes > FRAME && kept.bytes <= (2 << 20) + 3 * 100,
        "{kept:?}"
    );
    for client in &clients {
        read(&mut client.send("DELETE", "", "").await, None).await;
    }
    assert_eq!((server.kept(), server.sessions.lock().len()), (0, 0));
}

#[tokio::test]
async fn there_are_so_many_sessions_and_no_more() {
    let server = Server::new(2).await;
    let (first, second) = (server.open().await, server.open().await);
    let refused = server.initialize().await;
    assert!(
        refused.contains(" 503 ") && refused.ends_with("or come back later"),
        "{refused}"
    );
    assert!(
        second.post(PING).await.contains(r#""id":8"#),
        "the others go on"
    );
    // What needs no session is answered as ever.
    let body = r#"{"jsonrpc":"2.0","id":3,"method":"tools/list","params":{"_meta":{
        "io.modelcontextprotocol/protocolVersion":"2026-07-28",
        "io.modelcontextprotocol/clientInfo":{"name":"raw","version":"1"},
        "io.modelcontextprotocol/clientCapabilities":{}}}}"#;
    let headers = "MCP-Protocol-Version: 2026-07-28\r\nMcp-Method: tools/list\r\n";
    let answer = read(&mut server.send("POST", headers, body).await, None).await;
    assert!(
        answer.contains(" 200 ") && answer.contains(r#""id":3"#),
        "{answer}"
    );
    assert!(
        read(&mut first.send("DELETE", "", "").await, None)
            .await
            .contains(" 204 ")
    );
    let third = server.open().await;
    assert!(server.initialize().await.contains(" 503 "));
    assert!(third.post(PING).await.contains(r#""id":8"#));
    assert!(first.post(PING).await.contains(" 404 "));
}

#[tokio::test]
async fn sessions_that_do_nothing_end_soon() {
    let server = Server::new(9).await;
    let (silent, calls, listens) = (
        server.open().await,
        server.open().await,
        server.open().await,
    );
    read(&mut calls.call("now").await.0, None).await;
    let mut listening = listens.send("GET", "", "").await;
    read(&mut listening, Some("\r\n\r\n")).await;
    server.sessions.tend(Instant::now()).await;
    assert!(
        silent.post(PING).await.contains(r#""id":8"#),
        "it has only begun"
    );
    server.sessions.tend(Instant::now() + SILENT_FOR).await;
    assert!(silent.post(PING).await.contains(" 404 "));
    for client in [&calls, &listens] {
        assert!(client.post(PING).await.contains(r#""id":8"#));
    }
    cut(listening).await;
    server.sessions.tend(Instant::now() + SILENT_FOR).await;
    assert!(listens.post(PING).await.contains(" 404 "));
    assert!(calls.post(PING).await.contains(r#""id":8"#));
}
