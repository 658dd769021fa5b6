//! A server that speaks over standard input and output, offered over Streamable HTTP: one process a
//! session, each on its own. Only the recorder calls it, from this machine, so that what goes by is
//! read and recorded in one place.
//!
//! A line of the server's that answers a request ends the stream of that request; any other goes
//! to the session's own stream (`GET`), else to the request that waits longest, else waits for
//! the next of them.

use std::{
    collections::{BTreeMap, VecDeque},
    convert::Infallible,
    io::{self, BufRead, BufReader, Write},
    net::{Ipv4Addr, SocketAddr, TcpListener},
    process::{Child, ChildStdin, Command, Stdio},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    thread,
    time::{Duration, Instant},
};

use axum::{
    Router,
    body::Bytes,
    extract::{DefaultBodyLimit, State},
    http::{HeaderMap, HeaderName, StatusCode, header},
    response::{
        IntoResponse, Response,
        sse::{Event, KeepAlive, Sse},
    },
    routing,
};
use serde_json::{Value, json};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio_stream::{StreamExt, wrappers::UnboundedReceiverStream};

use crate::{ProxyError, Setup};

/// Where it is reached.
const PATH: &str = "/mcp";
const SESSION: HeaderName = HeaderName::from_static("mcp-session-id");
/// How long a server may take to end when its standard input is closed.
const END_PATIENCE: Duration = Duration::from_secs(2);
/// Lines kept for a session that listens to nothing; the oldest go first.
const UNHEARD_MAX: usize = 1000;
/// JSON-RPC: an error of the implementation.
const SERVER_ERROR: i64 = -32000;

/// Servers of sessions, by the id of the session.
pub struct Bridge {
    command: Vec<String>,
    /// The command without its secrets.
    shown: String,
    /// As the recorder's requests name it in `Host`. A page that reaches this port past the
    /// recorder names another (DNS rebinding).
    authority: String,
    links: Mutex<BTreeMap<String, Arc<Link>>>,
}

impl Bridge {
    /// Listens on this machine, at a port that is free, and gives the address.
    ///
    /// # Errors
    /// When there is no command, or the system refuses.
    pub fn start(command: &[String], setup: &Setup) -> Result<(Arc<Self>, String), ProxyError> {
        let (message_max, idle) = (setup.message_max, setup.idle);
        if command.is_empty() {
            return Err(ProxyError::Spawn {
                command: String::new(),
                source: io::ErrorKind::InvalidInput.into(),
            });
        }
        let listener = TcpListener::bind(SocketAddr::from((Ipv4Addr::LOCALHOST, 0)))?;
        let address = listener.local_addr()?;
        listener.set_nonblocking(true)?;
        let bridge = Arc::new(Self {
            command: command.to_owned(),
            shown: setup.rules.without_secrets(&command.join(" ")),
            authority: address.to_string(),
            links: Mutex::default(),
        });
        let methods = routing::post(post).get(listen).delete(end);
        let routes = Router::new()
            .route(PATH, methods)
            .layer(DefaultBodyLimit::max(message_max))
            .with_state(bridge.clone());
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()?;
        thread::spawn(move || {
            runtime.block_on(async {
                let listener = tokio::net::TcpListener::from_std(listener)?;
                axum::serve(listener, routes).await
            })
        });
        let tended = bridge.clone();
        thread::spawn(move || {
            loop {
                thread::sleep(idle.min(Duration::from_secs(5)));
                tended.end_where(|link| link.is_over() || link.silent_for() > idle);
            }
        });
        Ok((bridge, format!("http://{address}{PATH}")))
    }

    /// Ends the server process of every session.
    pub fn end_all(&self) {
        self.end_where(|_| true);
    }

    fn end_where(&self, which: impl Fn(&Link) -> bool) {
        let mut links = lock(&self.links);
        let ended: Vec<String> = links
            .iter()
            .filter(|(_, link)| which(link))
            .map(|(id, _)| id.clone())
            .collect();
        let ended: Vec<Arc<Link>> = ended.iter().filter_map(|id| links.remove(id)).collect();
        drop(links);
        for link in ended {
            link.end();
        }
    }

    /// Only the recorder gets through, and no page that posts a form: its content
    /// type would be another.
    fn admit(&self, headers: &HeaderMap, with_body: bool) -> Result<(), RejectedRequest> {
        let is = |name: HeaderName, wanted: &str| {
            let value = headers
                .get(name)
                .and_then(|value| value.to_str().ok())
                .unwrap_or_default();
            value
                .split(';')
                .next()
                .unwrap_or_default()
                .trim()
                .eq_ignore_ascii_case(wanted)
        };
        if !is(header::HOST, &self.authority) {
            return Err(RejectedRequest::new(
                StatusCode::FORBIDDEN,
                "only reel record speaks to this port",
            ));
        }
        if with_body && !is(header::CONTENT_TYPE, "application/json") {
            return Err(RejectedRequest::new(
                StatusCode::UNSUPPORTED_MEDIA_TYPE,
                "a message is application/json; say so in Content-Type",
            ));
        }
        Ok(())
    }

    /// The server of a request's session.
    fn link(&self, headers: &HeaderMap) -> Result<Arc<Link>, RejectedRequest> {
        self.admit(headers, false)?;
        let id = headers.get(SESSION).and_then(|id| id.to_str().ok());
        let id = id.ok_or_else(|| {
            RejectedRequest::new(StatusCode::BAD_REQUEST, "a session begins with initialize")
        })?;
        let link = lock(&self.links)
            .get(id)
            .filter(|link| !link.is_over())
            .cloned();
        link.ok_or_else(|| {
            RejectedRequest::new(
                StatusCode::NOT_FOUND,
                "the session is over: initialize again",
            )
        })
    }

    /// Starts the server of a new session.
    fn begin(&self) -> io::Result<(String, Arc<Link>)> {
        let id = format!("{:032x}", u128::from_le_bytes(random()?));
        let link = Link::spawn(&self.command)?;
        lock(&self.links).insert(id.clone(), link.clone());
        Ok((id, link))
    }
}

/// Session ids are secrets.
fn random() -> io::Result<[u8; 16]> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(io::Error::other)?;
    Ok(bytes)
}

/// The server of a session.
struct Link {
    child: Mutex<Child>,
    state: Mutex<Listeners>,
    to_server: Mutex<Option<ChildStdin>>,
}

/// Who listens to a server.
struct Listeners {
    /// By the request's id as JSON, in the order in which they came.
    requests: Vec<(String, UnboundedSender<String>)>,
    /// The session's own stream.
    stream: Option<UnboundedSender<String>>,
    unheard: VecDeque<String>,
    heard: Instant,
    over: bool,
}

impl Link {
    fn spawn(command: &[String]) -> io::Result<Arc<Self>> {
        let mut child = Command::new(&command[0])
            .args(&command[1..])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()?;
        let (to_server, from_server) = (child.stdin.take(), child.stdout.take());
        let state = Listeners {
            requests: Vec::new(),
            stream: None,
            unheard: VecDeque::new(),
            heard: Instant::now(),
            over: false,
        };
        let link = Arc::new(Self {
            child: Mutex::new(child),
            state: Mutex::new(state),
            to_server: Mutex::new(to_server),
        });
        let reading = link.clone();
        thread::spawn(move || {
            let lines = from_server
                .into_iter()
                .flat_map(|output| BufReader::new(output).split(b'\n'));
            for line in lines.map_while(Result::ok) {
                // A carriage return is white space between tokens here, and the end of a
                // line in an event.
                let line = String::from_utf8_lossy(&line).replace('\r', " ");
                if !line.trim().is_empty() {
                    lock(&reading.state).hears(line);
                }
            }
            reading.gone();
        });
        Ok(link)
    }

    /// Passes a message on as a line. What comes back for a request comes through the channel.
    fn say(
        &self,
        message: &[u8],
        request: Option<&Value>,
    ) -> io::Result<Option<UnboundedReceiver<String>>> {
        let mut state = lock(&self.state);
        if state.over {
            // Whoever comes after the end would wait in vain.
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        state.heard = Instant::now();
        let heard = request.map(|id| {
            let (tell, told) = unbounded_channel();
            state
                .unheard
                .drain(..)
                .for_each(|line| drop(tell.send(line)));
            state.requests.push((id.to_string(), tell));
            told
        });
        drop(state);
        // Line ends stand between tokens alone: inside of strings JSON has them escaped.
        let mut line: Vec<u8> = message
            .iter()
            .map(|byte| {
                if matches!(byte, b'\n' | b'\r') {
                    b' '
                } else {
                    *byte
                }
            })
            .collect();
        line.push(b'\n');
        let mut to_server = lock(&self.to_server);
        let to_server = to_server.as_mut().ok_or(io::ErrorKind::BrokenPipe)?;
        to_server
            .write_all(&line)
            .and_then(|()| to_server.flush())?;
        Ok(heard)
    }

    fn is_over(&self) -> bool {
        lock(&self.state).over
    }

    fn silent_for(&self) -> Duration {
        lock(&self.state).heard.elapsed()
    }

    /// The server's output ended: whoever waits is told.
    fn gone(&self) {
        let how = match lock(&self.child).try_wait() {
            Ok(Some(status)) => format!("the server ended: {status}"),
            _ => "the server closed its output".to_owned(),
        };
        let mut state = lock(&self.state);
        state.over = true;
        state.stream = None;
        for (id, tell) in state.requests.drain(..) {
            let id = serde_json::from_str(&id).unwrap_or(Value::Null);
            let _ = tell.send(error(&id, &how).to_string());
        }
    }

    /// As the protocol ends a server: its input is closed, and it has a moment to end by itself.
    fn end(&self) {
        lock(&self.to_server).take();
        let until = Instant::now() + END_PATIENCE;
        let mut child = lock(&self.child);
        while Instant::now() < until {
            if !matches!(child.try_wait(), Ok(None)) {
                return;
            }
            thread::sleep(Duration::from_millis(10));
        }
        let _ = child.kill().and_then(|()| child.wait());
    }
}

impl Listeners {
    fn hears(&mut self, line: String) {
        self.heard = Instant::now();
        let message: Value = serde_json::from_str(&line).unwrap_or(Value::Null);
        let answers = message
            .get("id")
            .filter(|_| message.get("method").is_none())
            .map(Value::to_string);
        let mut unheard = Some(line);
        if let Some(place) = self
            .requests
            .iter()
            .position(|(id, _)| Some(id) == answers.as_ref())
            && let Some(line) = unheard.take()
        {
            // The end of the channel is the end of the request's stream. Where its connection broke, the answer goes
            // where the session listens next.
            unheard = self
                .requests
                .remove(place)
                .1
                .send(line)
                .err()
                .map(|error| error.0);
        }
        let listeners = self
            .stream
            .iter()
            .chain(self.requests.iter().map(|(_, tell)| tell));
        for listener in listeners {
            let Some(line) = unheard.take() else { break };
            unheard = listener.send(line).err().map(|error| error.0);
        }
        self.unheard.extend(unheard);
        while self.unheard.len() > UNHEARD_MAX {
            self.unheard.pop_front();
        }
    }
}

async fn post(
    State(bridge): State<Arc<Bridge>>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Response, RejectedRequest> {
    bridge.admit(&headers, true)?;
    // A server that does not read holds its writer up.
    let passed = tokio::task::spawn_blocking(move || pass(&bridge, &headers, &body)).await;
    passed.unwrap_or_else(|_| {
        Err(RejectedRequest::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            "the recorder failed",
        ))
    })
}

fn pass(bridge: &Bridge, headers: &HeaderMap, body: &[u8]) -> Result<Response, RejectedRequest> {
    let message: Value = match serde_json::from_slice(body) {
        Ok(message @ Value::Object(_)) => message,
        Ok(_) => {
            return Err(RejectedRequest::new(
                StatusCode::BAD_REQUEST,
                "a message is one JSON object",
            ));
        }
        Err(error) => {
            return Err(RejectedRequest::new(
                StatusCode::BAD_REQUEST,
                format!("the message is not JSON: {error}"),
            ));
        }
    };
    let method = message.get("method").and_then(Value::as_str);
    let request = message.get("id").filter(|_| method.is_some());
    let failed = |what: String| RejectedRequest {
        status: StatusCode::BAD_GATEWAY,
        id: request.cloned(),
        what,
    };
    let (begun, link) = if method == Some("initialize") && !headers.contains_key(SESSION) {
        let (session, link) = bridge.begin().map_err(|error| {
            let command = &bridge.shown;
            failed(format!(
                "cannot start the server: {error}; check the words behind --stdio: {command}"
            ))
        })?;
        (Some([(SESSION, session)]), link)
    } else {
        (None, bridge.link(headers)?)
    };
    let told = link
        .say(body, request)
        .map_err(|error| failed(format!("the server takes nothing more: {error}")))?;
    Ok((
        begun,
        told.map_or_else(|| StatusCode::ACCEPTED.into_response(), stream),
    )
        .into_response())
}

/// The session's own stream; a newer one takes the place of an older.
async fn listen(
    State(bridge): State<Arc<Bridge>>,
    headers: HeaderMap,
) -> Result<Response, RejectedRequest> {
    let link = bridge.link(&headers)?;
    let (tell, told) = unbounded_channel();
    let mut state = lock(&link.state);
    state
        .unheard
        .drain(..)
        .for_each(|line| drop(tell.send(line)));
    state.stream = Some(tell);
    Ok(stream(told))
}

async fn end(
    State(bridge): State<Arc<Bridge>>,
    headers: HeaderMap,
) -> Result<StatusCode, RejectedRequest> {
    let ended = bridge.link(&headers)?;
    tokio::task::spawn_blocking(move || {
        bridge.end_where(|link| std::ptr::eq(link, Arc::as_ptr(&ended)))
    });
    Ok(StatusCode::NO_CONTENT)
}

fn stream(told: UnboundedReceiver<String>) -> Response {
    let events = UnboundedReceiverStream::new(told)
        .map(|line| Ok::<_, Infallible>(Event::default().event("message").data(line)));
    Sse::new(events)
        .keep_alive(KeepAlive::default())
        .into_response()
}

/// Why a request goes no further; an error of JSON-RPC.
struct RejectedRequest {
    status: StatusCode,
    id: Option<Value>,
    what: String,
}

impl RejectedRequest {
    fn new(status: StatusCode, what: impl Into<String>) -> Self {
        Self {
            status,
            id: None,
            what: what.into(),
        }
    }
}

impl IntoResponse for RejectedRequest {
    fn into_response(self) -> Response {
        (
            self.status,
            axum::Json(error(&self.id.unwrap_or(Value::Null), &self.what)),
        )
            .into_response()
    }
}

fn error(id: &Value, what: &str) -> Value {
    json!({"jsonrpc": "2.0", "id": id, "error": {"code": SERVER_ERROR, "message": what}})
}

/// Nothing here is left half done by a panic.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_whose_connection_broke_goes_to_the_next_stream() {
        let listeners = |stream| {
            let (tell, told) = unbounded_channel();
            drop(told);
            Listeners {
                requests: vec![("1".to_owned(), tell)],
                stream,
                unheard: VecDeque::new(),
                heard: Instant::now(),
                over: false,
            }
        };
        let answer = r#"{"id":1,"result":{}}"#.to_owned();
        let (tell, mut told) = unbounded_channel();
        let mut listening = listeners(Some(tell));
        listening.hears(answer.clone());
        assert_eq!(told.try_recv().unwrap(), answer);
        let mut deaf = listeners(None);
        deaf.hears(answer.clone());
        assert_eq!(deaf.unheard, [answer], "it is kept for who listens next");
    }
}
