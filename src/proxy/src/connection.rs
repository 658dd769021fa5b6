//! One connection of an agent and the one to the server that belongs to it: requests one way,
//! responses the other. A message that may be a call is held until it is recorded, one that may be
//! its result too; everything else passes as it comes.

use std::{
    cell::Cell,
    collections::{HashMap, VecDeque},
    io::{self, Read, Write},
    net::{Shutdown, TcpStream},
    ops::Range,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread,
};

use serde_json::Value;

use crate::{
    events::Events,
    http::Shared,
    session::{RejectedRequest, Session},
    sessions::Key,
    tap,
    wire::{Body, Head, Start, Unreadable},
};

/// Open streams of HTTP+SSE, by the target for messages: what is refused there is
/// said on the stream.
pub(crate) type Streams = Mutex<HashMap<String, Arc<Connection>>>;

/// Bytes read at a time.
const PIECE: usize = 64 << 10;

/// A connection of an agent and the one to the server.
pub(crate) struct Connection {
    pub(crate) shared: Arc<Shared>,
    /// The agent's address, without its port.
    client: String,
    /// Requests that were passed on and not answered, in their order.
    exchanges: Mutex<VecDeque<Exchange>>,
    pub(crate) agent: Mutex<Outlet>,
    /// Whether bytes pass without a look from here on.
    blind: AtomicBool,
}

/// A request that was passed on.
#[derive(Default)]
pub(crate) struct Exchange {
    to_head: bool,
    pub(crate) target: String,
    pub(crate) session: Option<Arc<Session>>,
    /// Under which the session is found if the response names no id for it.
    keep_as: Option<Key>,
    /// The id of the call in it, if its result is awaited.
    call: Option<Value>,
    /// The session that it ends.
    ends: Option<Key>,
    /// Whether the server knows no session of it, so that only its events tell whose stream is resumed.
    pub(crate) is_sessionless: bool,
    /// Whether an event of the response has an id, from which another stream may go on.
    pub(crate) is_resumable: Cell<bool>,
}

/// The way to the agent.
pub(crate) struct Outlet {
    stream: TcpStream,
    /// Whether events are being passed in chunks.
    pub(crate) chunked: bool,
    /// Whether an event of ours may stand here.
    pub(crate) between: bool,
    waiting: Vec<String>,
}

impl Connection {
    pub(crate) fn new(
        shared: &Arc<Shared>,
        agent: &TcpStream,
        server: &TcpStream,
    ) -> io::Result<Arc<Self>> {
        let _ = server.peer_addr()?;
        let outlet = Outlet {
            stream: agent.try_clone()?,
            chunked: false,
            between: false,
            waiting: Vec::new(),
        };
        Ok(Arc::new(Self {
            shared: shared.clone(),
            client: agent.peer_addr()?.ip().to_string(),
            exchanges: Mutex::default(),
            agent: Mutex::new(outlet),
            blind: AtomicBool::new(false),
        }))
    }

    /// Passes on until one side is gone.
    pub(crate) fn run(self: Arc<Self>, agent: &TcpStream, server: &TcpStream) {
        let (back, Ok(from_server)) = (self.clone(), server.try_clone()) else {
            return;
        };
        let (Ok(agent_too), Ok(server_too)) = (agent.try_clone(), server.try_clone()) else {
            return;
        };
        let backward = thread::spawn(move || {
            let _both = Ends([agent_too, server_too]);
            drop(back.responses(from_server));
        });
        if self.requests(agent, server).is_err() {
            let _ = server.shutdown(Shutdown::Both);
        }
        // The agent has said everything, and may still listen.
        let _ = server.shutdown(Shutdown::Write);
        let _ = backward.join();
        for exchange in lock(&self.exchanges).drain(..) {
            exchange.adrift();
        }
    }

    /// Forwards the agent's requests to the server until the connection closes.
    fn requests(&self, mut agent: &TcpStream, mut server: &TcpStream) -> io::Result<()> {
        let mut buffer = Vec::new();
        loop {
            let head = loop {
                match Head::request(&buffer) {
                    Ok(Some(head)) => break head,
                    Ok(None) => {}
                    Err(Unreadable) => return self.go_blind(&buffer, agent, server),
                }
                if !fill(agent, &mut buffer)? {
                    return server.write_all(&buffer);
                }
            };
            let Ok(mut body) = head.body(false) else {
                return self.go_blind(&buffer, agent, server);
            };
            buffer.drain(..head.bytes.len());
            if let Some(why) = self.shared.rejected_client(&head) {
                return answer(agent, "403 Forbidden", "text/plain", &why);
            }
            let Start::Request { method, target } = &head.start else {
                return Ok(());
            };
            let mut exchange = Exchange {
                to_head: method == "HEAD",
                target: target.clone(),
                ..Exchange::default()
            };
            let key = self.key(&head, target);
            let (mut wire, mut message) = (self.shared.for_the_server(&head), Vec::new());
            if method == "POST" {
                if head.says("expect", "100-continue") {
                    agent.write_all(b"HTTP/1.1 100 Continue\r\n\r\n")?;
                }
                let limit = self.shared.setup.message_max;
                while take(&mut body, &mut buffer, &mut wire, &mut message)?
                    && message.len() <= limit
                {
                    if !fill(agent, &mut buffer)? {
                        return server.write_all(&wire);
                    }
                }
                let session = self.session(key.as_ref(), &head, &message, &mut exchange);
                let said = if message.len() > limit {
                    session.too_large("a request");
                    Ok(None)
                } else {
                    session.agent_says(&message)
                };
                match said {
                    Ok(call) => exchange.call = call,
                    Err(refusal) => {
                        self.refuse(key.as_ref(), &refusal, agent)?;
                        continue;
                    }
                }
            } else {
                exchange.session = match &key {
                    Some(key) => self.shared.sessions.find(key),
                    None => head
                        .value("last-event-id")
                        .and_then(|id| self.shared.sessions.of_event(id)),
                };
                exchange.is_sessionless = key.is_none() && exchange.session.is_some();
                exchange.ends = key.filter(|_| method == "DELETE");
            }
            lock(&self.exchanges).push_back(exchange);
            server.write_all(&wire)?;
            while !body.is_whole() {
                let mut rest = Vec::new();
                if take(&mut body, &mut buffer, &mut rest, &mut Vec::new())?
                    && !fill(agent, &mut buffer)?
                {
                    return server.write_all(&rest);
                }
                server.write_all(&rest)?;
            }
        }
    }

    /// What a request says of its session.
    fn key(&self, head: &Head, target: &str) -> Option<Key> {
        if let Some(id) = head.value("mcp-session-id") {
            return Some(Key::Id(id.to_owned()));
        }
        let messages = Key::Messages(target.to_owned());
        self.shared.sessions.find(&messages).map(|_| messages)
    }

    /// The session of a message; one that says hello begins a new one, and others without a session
    /// belong to their client.
    fn session(
        &self,
        key: Option<&Key>,
        head: &Head,
        message: &[u8],
        exchange: &mut Exchange,
    ) -> Arc<Session> {
        let session = match key {
            Some(key) => self.shared.sessions.find_or_begin(key.clone()),
            None => {
                let who = tap::client_of(message).unwrap_or_default();
                let authorization = head.value("authorization").unwrap_or_default();
                let client = Key::Client(format!(
                    "{} {} {authorization} {who}",
                    self.client, exchange.target
                ));
                exchange.is_sessionless = true;
                if tap::is_hello(message) {
                    exchange.keep_as = Some(client);
                    self.shared.sessions.begin()
                } else {
                    let session = self.shared.sessions.find_or_begin(client);
                    if !who.is_empty() {
                        session.set_client(&who);
                    }
                    session
                }
            }
        };
        session.learn(&head.secrets());
        exchange.session = Some(session.clone());
        session
    }

    /// Says that a call is not passed on: in the place of the response, or on the stream
    /// where results are awaited.
    fn refuse(
        &self,
        key: Option<&Key>,
        refusal: &RejectedRequest,
        agent: &TcpStream,
    ) -> io::Result<()> {
        let error = refusal.json(None).unwrap_or_default();
        if !lock(&self.exchanges).is_empty() {
            // Responses before it are still to come; there is no place for this one.
            return Err(io::Error::other(
                "refused between requests that are not answered",
            ));
        }
        let stream = match key {
            Some(Key::Messages(target)) => lock(&self.shared.streams).get(target).cloned(),
            _ => None,
        };
        match stream {
            Some(stream) => {
                lock(&stream.agent).say(error)?;
                respond(agent, "202 Accepted", "text/plain", "Accepted", true)
            }
            None => respond(agent, "200 OK", "application/json", &error, true),
        }
    }

    /// Forwards the server's responses to the agent until the connection closes.
    fn responses(self: &Arc<Self>, server: TcpStream) -> io::Result<()> {
        let mut buffer = Vec::new();
        loop {
            let head = loop {
                match Head::response(&buffer) {
                    _ if self.blind.load(Ordering::Acquire) => {
                        return self.copy(&mut buffer, &server);
                    }
                    Ok(Some(head)) => break head,
                    Ok(None) => {}
                    Err(Unreadable) => return self.copy(&mut buffer, &server),
                }
                if !fill(&server, &mut buffer)? {
                    return lock(&self.agent).pass(&buffer);
                }
            };
            let Start::Response { status } = head.start else {
                return Ok(());
            };
            if (100..200).contains(&status) && status != 101 {
                lock(&self.agent).pass(&head.bytes)?;
                buffer.drain(..head.bytes.len());
                continue;
            }
            let exchange = lock(&self.exchanges).pop_front();
            let (Some(exchange), true) = (exchange, status != 101) else {
                return self.copy(&mut buffer, &server);
            };
            let Ok(body) = head.body(exchange.to_head) else {
                return self.copy(&mut buffer, &server);
            };
            buffer.drain(..head.bytes.len());
            let head = self.shared.for_the_agent(head);
            if let (Some(session), Some(client)) = (&exchange.session, exchange.keep_as.clone()) {
                let key = head
                    .value("mcp-session-id")
                    .map_or(client, |id| Key::Id(id.to_owned()));
                self.shared.sessions.keep(key, session);
            }
            let readable = head
                .value("content-encoding")
                .is_none_or(|coding| coding.eq_ignore_ascii_case("identity"));
            let kind = head.content_type();
            let passed = match kind.as_str() {
                "text/event-stream" if readable => Events::new(
                    self,
                    &exchange,
                    body,
                    head.says("transfer-encoding", "chunked"),
                )
                .pass(&head.bytes, &mut buffer, &server),
                "application/json" if readable => {
                    self.json(&exchange, &head, status, body, &mut buffer, &server)
                }
                _ => self.plain(&exchange, &head, status, body, &mut buffer, &server),
            };
            exchange.adrift();
            if !passed? {
                return Ok(());
            }
            if let Some(key) = exchange
                .ends
                .as_ref()
                .filter(|_| status < 300 || status == 404)
            {
                self.shared.sessions.end(key, "the agent ended the session");
            }
        }
    }

    /// Passes a body of JSON on as soon as it is whole and recorded. Gives whether
    /// the connection goes on.
    fn json(
        &self,
        exchange: &Exchange,
        head: &Head,
        status: u16,
        mut body: Body,
        buffer: &mut Vec<u8>,
        server: &TcpStream,
    ) -> io::Result<bool> {
        let (mut wire, mut message, mut places) = (head.bytes.clone(), Vec::new(), Vec::new());
        let mut goes_on = true;
        while goes_on && !take_places(&mut body, buffer, &mut wire, &mut message, &mut places)? {
            if message.len() > self.shared.setup.message_max {
                if let Some(session) = &exchange.session {
                    session.too_large("a response");
                    if exchange.call.is_some() {
                        session.unanswered(exchange.call.as_ref(), "it was too large to be read");
                    }
                }
                lock(&self.agent).pass(&wire)?;
                return self.rest(body, buffer, server);
            }
            goes_on = fill(server, buffer)?;
        }
        if let Some(session) = &exchange.session {
            if let Err(refusal) = session.server_says(&message) {
                let error = refusal
                    .json(Some(message.len()))
                    .ok_or_else(|| io::Error::other("no room for an error"))?;
                // White space behind JSON means nothing, and so the length stays.
                let padded = error.bytes().chain(std::iter::repeat(b' '));
                overwrite(&mut wire, &places, padded);
            }
            // A stream that is refused, for example, says nothing of a call.
            if status >= 400 && exchange.call.is_some() {
                session.unanswered(
                    exchange.call.as_ref(),
                    &format!("the server answered with HTTP {status}"),
                );
            }
        }
        lock(&self.agent).pass(&wire)?;
        Ok(goes_on && !matches!(body, Body::UntilClose))
    }

    /// Passes a body on that nothing is read from.
    fn plain(
        &self,
        exchange: &Exchange,
        head: &Head,
        status: u16,
        body: Body,
        buffer: &mut Vec<u8>,
        server: &TcpStream,
    ) -> io::Result<bool> {
        if let Some(session) = exchange
            .session
            .as_ref()
            .filter(|_| exchange.call.is_some())
        {
            let kind = head.content_type();
            if status >= 400 {
                session.unanswered(
                    exchange.call.as_ref(),
                    &format!("the server answered with HTTP {status}"),
                );
            } else if !body.is_whole() && status != 202 {
                session.unanswered(
                    exchange.call.as_ref(),
                    &format!("the server answered with {kind:?}, which is not read"),
                );
            }
        }
        lock(&self.agent).pass(&head.bytes)?;
        self.rest(body, buffer, server)
    }

    /// Passes the rest of a body on as it comes.
    fn rest(&self, mut body: Body, buffer: &mut Vec<u8>, server: &TcpStream) -> io::Result<bool> {
        loop {
            let mut wire = Vec::new();
            let more = take(&mut body, buffer, &mut wire, &mut Vec::new())?;
            lock(&self.agent).pass(&wire)?;
            if !more {
                return Ok(true);
            }
            if !fill(server, buffer)? {
                return Ok(false);
            }
        }
    }

    /// From here on bytes pass as they come, both ways.
    fn go_blind(
        &self,
        buffer: &[u8],
        mut agent: &TcpStream,
        mut server: &TcpStream,
    ) -> io::Result<()> {
        if !self.blind.swap(true, Ordering::AcqRel) {
            self.shared
                .setup
                .report
                .count(|counts| counts.opaque_connections += 1);
        }
        server.write_all(buffer)?;
        io::copy(&mut agent, &mut server).map(drop)
    }

    fn copy(&self, buffer: &mut Vec<u8>, server: &TcpStream) -> io::Result<()> {
        if !self.blind.swap(true, Ordering::AcqRel) {
            self.shared
                .setup
                .report
                .count(|counts| counts.opaque_connections += 1);
        }
        loop {
            lock(&self.agent).pass(buffer)?;
            buffer.clear();
            if !fill(server, buffer)? {
                return Ok(());
            }
        }
    }
}

/// Both sides of a connection, which are closed with this: however passing on ends, both are told.
struct Ends([TcpStream; 2]);

impl Drop for Ends {
    fn drop(&mut self) {
        for stream in &self.0 {
            let _ = stream.shutdown(Shutdown::Both);
        }
    }
}

impl Exchange {
    /// Notes that the result of its call, if it has not come, will not come with this response.
    fn adrift(&self) {
        // Over HTTP+SSE it comes on the stream.
        if let (Some(session), Some(call)) = (&self.session, &self.call)
            && !session.has_stream()
        {
            session.adrift(call, self.is_resumable.get());
        }
    }
}

impl Outlet {
    pub(crate) fn pass(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.stream.write_all(bytes)
    }

    /// Passes events on; then what waited for its turn.
    pub(crate) fn pass_events(&mut self, bytes: &[u8], between: bool) -> io::Result<()> {
        self.stream.write_all(bytes)?;
        self.between = between;
        while self.between && !self.waiting.is_empty() {
            let error = self.waiting.remove(0);
            self.say(error)?;
        }
        Ok(())
    }

    /// Says something of our own on a stream of events, as soon as there is room for it.
    fn say(&mut self, json: String) -> io::Result<()> {
        if !self.between {
            self.waiting.push(json);
            return Ok(());
        }
        let event = format!("event: message\ndata: {json}\n\n");
        let bytes = if self.chunked {
            format!("{:x}\r\n{event}\r\n", event.len())
        } else {
            event
        };
        self.stream.write_all(bytes.as_bytes())
    }
}

/// Puts other bytes, at least as many, where an event or a message stands.
pub(crate) fn overwrite(
    wire: &mut [u8],
    places: &[Range<usize>],
    mut bytes: impl Iterator<Item = u8>,
) {
    for byte in places.iter().flat_map(|place| place.clone()) {
        if let Some(other) = bytes.next() {
            wire[byte] = other;
        }
    }
}

/// Reads on; false at the end.
pub(crate) fn fill(mut from: &TcpStream, buffer: &mut Vec<u8>) -> io::Result<bool> {
    let before = buffer.len();
    buffer.resize(before + PIECE, 0);
    let read = loop {
        match from.read(&mut buffer[before..]) {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            other => break other,
        }
    };
    buffer.truncate(before + *read.as_ref().unwrap_or(&0));
    read.map(|count| count > 0)
}

/// Takes what belongs to a body; true where more of it is to come.
fn take(
    body: &mut Body,
    buffer: &mut Vec<u8>,
    wire: &mut Vec<u8>,
    message: &mut Vec<u8>,
) -> io::Result<bool> {
    take_places(body, buffer, wire, message, &mut Vec::new()).map(|whole| !whole)
}

/// [`take`], with where the content stands on the wire; true where the body is whole.
fn take_places(
    body: &mut Body,
    buffer: &mut Vec<u8>,
    wire: &mut Vec<u8>,
    message: &mut Vec<u8>,
    places: &mut Vec<Range<usize>>,
) -> io::Result<bool> {
    let (used, content) = body
        .take(buffer)
        .map_err(|_| io::Error::other("the body is not HTTP/1.1"))?;
    let before = wire.len();
    for range in content {
        message.extend_from_slice(&buffer[range.clone()]);
        places.push(range.start + before..range.end + before);
    }
    wire.extend(buffer.drain(..used));
    Ok(body.is_whole())
}

/// Answers in the server's place, and says that the connection ends.
pub(crate) fn answer(agent: &TcpStream, status: &str, kind: &str, text: &str) -> io::Result<()> {
    respond(agent, status, kind, text, false)
}

fn respond(
    mut agent: &TcpStream,
    status: &str,
    kind: &str,
    text: &str,
    stays: bool,
) -> io::Result<()> {
    let connection = if stays { "keep-alive" } else { "close" };
    let length = text.len();
    let response = format!(
        "HTTP/1.1 {status}\r\ncontent-type: {kind}\r\ncontent-length: {length}\r\nconnection: {connection}\r\n\r\n{text}"
    );
    agent.write_all(response.as_bytes())
}

pub(crate) fn lock<T>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}
