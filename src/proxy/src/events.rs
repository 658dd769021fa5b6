//! A response of server-sent events: each is held until it is whole and, where it is a result,
//! recorded. What has to be said in an event's place is as long as the event, so that the framing
//! around it stays as it came.

use std::{io, mem, net::TcpStream, ops::Range, sync::Arc};

use crate::{
    connection::{Connection, Exchange, fill, lock, overwrite},
    session::Session,
    sessions::Key,
    sse::{self, Byte, Event, Scanner},
    wire::Body,
};

/// A response of server-sent events on its way.
pub(crate) struct Events<'a> {
    connection: &'a Arc<Connection>,
    exchange: &'a Exchange,
    body: Body,
    chunked: bool,
    scanner: Scanner,
    /// What has come on the wire and was not passed on.
    held: Vec<u8>,
    /// The event that is not whole.
    event: Vec<u8>,
    /// Where it stands in what is held.
    places: Vec<Range<usize>>,
    /// Whether the event is too large and passes as it comes.
    too_large: bool,
    /// The session whose stream this is, and its target for messages.
    stream: Option<(Arc<Session>, String)>,
}

impl<'a> Events<'a> {
    pub(crate) fn new(
        connection: &'a Arc<Connection>,
        exchange: &'a Exchange,
        body: Body,
        chunked: bool,
    ) -> Self {
        Self {
            connection,
            exchange,
            body,
            chunked,
            scanner: Scanner::default(),
            held: Vec::new(),
            event: Vec::new(),
            places: Vec::new(),
            too_large: false,
            stream: None,
        }
    }

    /// Passes everything on, each event as soon as it is whole and recorded. Gives whether
    /// the connection goes on.
    pub(crate) fn pass(
        mut self,
        head: &[u8],
        buffer: &mut Vec<u8>,
        server: &TcpStream,
    ) -> io::Result<bool> {
        {
            let mut agent = lock(&self.connection.agent);
            agent.chunked = self.chunked;
            agent.pass(head)?;
        }
        let passed = self.pass_body(buffer, server);
        lock(&self.connection.agent).between = false;
        if let Some((_, target)) = &self.stream {
            lock(&self.connection.shared.streams).remove(target);
            self.connection
                .shared
                .sessions
                .end(&Key::Messages(target.clone()), "its stream was closed");
        }
        passed
    }

    fn pass_body(&mut self, buffer: &mut Vec<u8>, server: &TcpStream) -> io::Result<bool> {
        loop {
            let (used, content) = self
                .body
                .take(buffer)
                .map_err(|_| io::Error::other("the stream is not HTTP/1.1"))?;
            let before = self.held.len();
            self.held.extend(buffer.drain(..used));
            // Up to where it may be passed on: nothing of an event that is not whole.
            let mut end = 0;
            for range in content {
                end = self
                    .look(range.start + before..range.end + before)
                    .unwrap_or(end);
            }
            if self.event.is_empty() || self.too_large {
                end = self.held.len();
            }
            if end > 0 {
                let between = self.event.is_empty() && !self.too_large && self.body.is_between();
                let held: Vec<u8> = self.held.drain(..end).collect();
                lock(&self.connection.agent).pass_events(&held, between)?;
                self.places
                    .iter_mut()
                    .for_each(|place| *place = place.start - end..place.end - end);
            }
            if self.body.is_whole() {
                return Ok(true);
            }
            if !fill(server, buffer)? {
                lock(&self.connection.agent).pass(&self.held)?;
                return Ok(false);
            }
        }
    }

    /// Looks at content; gives where the last event in it ends.
    fn look(&mut self, range: Range<usize>) -> Option<usize> {
        let (mut start, mut at, mut end) = (range.start, range.start, None);
        while at < range.end {
            match self.scanner.take(self.held[at]) {
                Byte::Behind => {
                    start = at + 1;
                    end = Some(start);
                }
                Byte::Ends => {
                    self.keep(start..at + 1);
                    self.whole();
                    start = at + 1;
                    end = Some(start);
                }
                Byte::Within => {
                    // The rest of the line says nothing of its end.
                    let rest = &self.held[at + 1..range.end];
                    if !matches!(self.held[at], b'\n' | b'\r') {
                        at += memchr::memchr2(b'\n', b'\r', rest).unwrap_or(rest.len());
                    }
                }
            }
            at += 1;
        }
        self.keep(start..range.end);
        end
    }

    fn keep(&mut self, range: Range<usize>) {
        if range.is_empty() || self.too_large {
            return;
        }
        self.event.extend_from_slice(&self.held[range.clone()]);
        self.places.push(range);
        if self.event.len() > self.connection.shared.setup.message_max {
            if let Some(session) = self.session() {
                session.too_large("an event");
                session.unanswered(None, "it was too large to be read");
            }
            self.event.clear();
            self.places.clear();
            self.too_large = true;
        }
    }

    fn session(&self) -> Option<Arc<Session>> {
        self.stream
            .as_ref()
            .map(|(session, _)| session.clone())
            .or_else(|| self.exchange.session.clone())
    }

    /// Takes an event that is whole, before it is passed on.
    fn whole(&mut self) {
        if mem::take(&mut self.too_large) {
            return;
        }
        let (bytes, places) = (mem::take(&mut self.event), mem::take(&mut self.places));
        let Event { name, data, id } = Event::read(&bytes);
        if !id.is_empty() {
            self.exchange.is_resumable.set(true);
            if let Some(session) = self.session().filter(|_| self.exchange.is_sessionless) {
                let sessions = &self.connection.shared.sessions;
                sessions.note_event(&String::from_utf8_lossy(&id), &session);
            }
        }
        if name == "endpoint" && self.stream.is_none() && self.exchange.session.is_none() {
            let reference = String::from_utf8_lossy(&data).into_owned();
            self.opens(&reference);
            if let Some(path) = sse::behind_the_server(&reference)
                && let Some(event) = sse::fitted("endpoint", path, bytes.len())
            {
                overwrite(&mut self.held, &places, event.into_iter());
            }
            return;
        }
        let Some(session) = self.session().filter(|_| !data.is_empty()) else {
            return;
        };
        if let Err(refusal) = session.server_says(&data) {
            // The stream goes on, and so its framing has to: what is said instead is as long.
            let fits =
                |most: usize| sse::fitted("message", &refusal.json(Some(most))?, bytes.len());
            let event = [bytes.len(), bytes.len().saturating_sub(32)]
                .into_iter()
                .find_map(fits);
            let event = event.unwrap_or_else(|| {
                sse::fitted("message", "", bytes.len()).unwrap_or_else(|| vec![b'\n'; bytes.len()])
            });
            overwrite(&mut self.held, &places, event.into_iter());
        }
    }

    /// A stream of HTTP+SSE says where messages go: the session begins.
    fn opens(&mut self, reference: &str) {
        let shared = &self.connection.shared;
        let target = sse::resolve(&self.exchange.target, reference);
        let session = shared.sessions.begin();
        session.set_stream();
        shared
            .sessions
            .keep(Key::Messages(target.clone()), &session);
        lock(&shared.streams).insert(target.clone(), self.connection.clone());
        self.stream = Some((session, target));
    }
}
