//! What clients that were cut off may still ask for: the events of Streamable HTTP,
//! found again by `Last-Event-ID`.
//!
//! rmcp stores every event of a session here, hands it to the connection that waits for it, and
//! forgets it; a resume is answered from here alone. Answers hold images, a thousand sessions are
//! open at once, and most of them idle, so little is kept:
//!
//! * what no connection took, for [`UNTAKEN_FOR`]: its client was cut off, and may
//!   come back for it;
//! * what a connection took, for [`TAKEN_FOR`], because it may have been lost on the way.
//!   The answer of a request only until the next request of its session: a client that goes
//!   on has its answer;
//! * of a stream, of a session and of all of them at most [`OF_STREAM`], [`OF_SESSION`] and
//!   [`OF_ALL`]; the oldest goes first;
//! * nothing of sessions that ended, and no event without a message: nobody misses one.
//!
//! Bytes are those of the JSON that goes out. A message is kept as the tree that rmcp sends, never
//! copied: texts and images take as much there, numbers and names some times more.

use std::{
    collections::{BTreeMap, HashMap, VecDeque},
    fmt, io,
    str::FromStr,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use async_trait::async_trait;
use futures_util::stream;
use rmcp::{
    model::{JsonRpcMessage, ServerJsonRpcMessage},
    transport::streamable_http_server::session::{
        EventStore, EventStoreError, EventStream, ServerSseMessage,
    },
};
use tokio::{sync::Notify, time::Instant};

const UNTAKEN_FOR: Duration = Duration::from_secs(600);
const TAKEN_FOR: Duration = Duration::from_secs(30);
const OF_STREAM: EventStoreUsage = EventStoreUsage {
    events: 8,
    bytes: 2 << 20,
};
const OF_SESSION: EventStoreUsage = EventStoreUsage {
    events: 32,
    bytes: 2 << 20,
};
const OF_ALL: EventStoreUsage = EventStoreUsage {
    events: 1 << 14,
    bytes: 64 << 20,
};
/// Streams of a session that can be resumed: the standalone one, and those of its last requests.
const STREAMS: usize = 32;
/// The stream of a session that belongs to no request.
const STANDALONE: u64 = 0;

/// How much is kept.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct EventStoreUsage {
    pub events: usize,
    pub bytes: usize,
}

impl EventStoreUsage {
    fn fits(self, bound: Self) -> bool {
        self.events <= bound.events && self.bytes <= bound.bytes
    }

    fn add(&mut self, event: &Event) {
        self.events += 1;
        self.bytes += event.bytes;
    }

    fn remove(&mut self, other: Self) {
        self.events -= other.events;
        self.bytes -= other.bytes;
    }
}

/// The events of all sessions.
#[derive(Clone, Default)]
pub(crate) struct Events(Arc<Mutex<Logs>>);

impl Events {
    /// A store for one more session, until [`SessionEvents::close`].
    pub fn open(&self) -> SessionEvents {
        let session = self.lock().open();
        SessionEvents {
            all: self.clone(),
            session,
            changed: Arc::default(),
        }
    }

    /// Forgets what has been kept for long enough. To be called now and then.
    pub fn expire(&self, now: Instant) {
        self.lock().expire(now);
    }

    #[cfg(test)]
    pub fn usage(&self) -> EventStoreUsage {
        self.lock().kept
    }

    fn lock(&self) -> MutexGuard<'_, Logs> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The events of one session. Ids of other sessions mean nothing here.
#[derive(Clone)]
pub(crate) struct SessionEvents {
    all: Events,
    session: u64,
    changed: Arc<Notify>,
}

impl SessionEvents {
    /// Forgets the answers that the client has, because it goes on.
    pub fn begin_request(&self) {
        self.all.lock().begin_request(self.session);
    }

    /// Notes that a connection took an event.
    pub fn taken(&self, event: &ServerSseMessage) {
        if let Some(id) = event.event_id.as_deref().and_then(|id| id.parse().ok()) {
            self.all.lock().take(self.session, id, Instant::now());
        }
    }

    /// What the standalone stream had to say while nobody listened.
    pub fn missed(&self) -> Vec<ServerSseMessage> {
        let logs = self.all.lock();
        let Some(stream) = logs.stream(self.session, STANDALONE) else {
            return Vec::new();
        };
        let missed = stream
            .events
            .iter()
            .filter(|event| event.index > stream.taken);
        missed.map(|event| event.message(STANDALONE)).collect()
    }

    /// Forgets everything, and ends the streams that are being replayed.
    pub fn close(&self) {
        self.all.lock().close(self.session);
        self.changed.notify_waiters();
    }

    /// The events of a stream after one of them: those kept, then those that come,
    /// up to the answer.
    fn follow(self, after: EventId) -> EventStream {
        Box::pin(stream::unfold(
            (self, after),
            |(events, after)| async move {
                loop {
                    let changed = events.changed.notified();
                    let next = events.all.lock().next(events.session, after);
                    match next {
                        Next::Event(index, event) => {
                            drop(changed);
                            return Some((event, (events, EventId { index, ..after })));
                        }
                        Next::Wait => changed.await,
                        Next::End => return None,
                    }
                }
            },
        ))
    }
}

#[async_trait]
impl EventStore for SessionEvents {
    async fn store_event(
        &self,
        stream_id: &str,
        event: &ServerSseMessage,
    ) -> Result<String, EventStoreError> {
        let message = event
            .message
            .as_ref()
            .map(|message| (message.clone(), json_bytes(message)));
        let id = self
            .all
            .lock()
            .store(self.session, stream_id, message, Instant::now());
        self.changed.notify_waiters();
        Ok(id.to_string())
    }

    async fn replay_events_after(
        &self,
        last_event_id: &str,
    ) -> Result<EventStream, EventStoreError> {
        let after: EventId = last_event_id
            .parse()
            .map_err(|()| format!("{last_event_id:?} is not an event id"))?;
        if self.all.lock().stream(self.session, after.stream).is_none() {
            return Err(format!("nothing is kept of the stream of event {last_event_id:?}").into());
        }
        Ok(self.clone().follow(after))
    }
}

/// Which event of a session: `index` of the standalone stream, from 1, or `index/stream` of
/// another. rmcp primes the standalone stream with `0`.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct EventId {
    stream: u64,
    index: u64,
}

impl fmt::Display for EventId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.stream {
            STANDALONE => write!(f, "{}", self.index),
            stream => write!(f, "{}/{stream}", self.index),
        }
    }
}

impl FromStr for EventId {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        let (index, stream) = text
            .split_once('/')
            .map_or((text, None), |(index, stream)| (index, Some(stream)));
        let number = |text: &str| text.parse::<u64>().map_err(drop);
        Ok(Self {
            stream: stream.map_or(Ok(STANDALONE), number)?,
            index: number(index)?,
        })
    }
}

/// What a replay has to do.
enum Next {
    Event(u64, ServerSseMessage),
    Wait,
    End,
}

/// All that is kept. Reads no clock.
#[derive(Default)]
struct Logs {
    sessions: HashMap<u64, Log>,
    opened: u64,
    stored: u64,
    kept: EventStoreUsage,
}

#[derive(Default)]
struct Log {
    streams: BTreeMap<u64, Stream>,
    named: u64,
}

#[derive(Default)]
struct Stream {
    /// What rmcp calls it.
    name: String,
    /// Index of its last event, kept or not.
    last: u64,
    /// Index of the last event that a connection took.
    taken: u64,
    taken_at: Option<Instant>,
    /// Whether nothing will come any more.
    answered: bool,
    events: VecDeque<Event>,
}

struct Event {
    index: u64,
    /// When, among the events of all sessions.
    order: u64,
    stored_at: Instant,
    bytes: usize,
    message: Arc<ServerJsonRpcMessage>,
}

impl Event {
    fn message(&self, stream: u64) -> ServerSseMessage {
        let mut message = ServerSseMessage::default();
        message.event_id = Some(
            EventId {
                stream,
                index: self.index,
            }
            .to_string(),
        );
        message.message = Some(self.message.clone());
        message
    }
}

impl Stream {
    fn kept(&self) -> EventStoreUsage {
        let mut kept = EventStoreUsage::default();
        self.events.iter().for_each(|event| kept.add(event));
        kept
    }

    /// Whether anybody could still ask for something of it.
    fn is_of_use(&self, number: u64) -> bool {
        number == STANDALONE || !self.answered || !self.events.is_empty()
    }
}

impl Log {
    fn kept(&self) -> EventStoreUsage {
        let mut kept = EventStoreUsage::default();
        self.streams
            .values()
            .flat_map(|stream| &stream.events)
            .for_each(|event| kept.add(event));
        kept
    }

    /// Place among the events of all sessions, and stream, of the oldest event.
    fn oldest(&self) -> Option<(u64, u64)> {
        self.streams
            .iter()
            .filter_map(|(number, stream)| Some((stream.events.front()?.order, *number)))
            .min()
    }

    /// Number of a stream that rmcp names; a new one, if need be.
    fn number(&mut self, name: &str) -> u64 {
        // rmcp calls it `<session>:common`, and those of requests by random numbers.
        if name.ends_with(":common") {
            return STANDALONE;
        }
        if let Some((number, _)) = self.streams.iter().find(|(_, stream)| stream.name == name) {
            return *number;
        }
        self.named += 1;
        self.streams.insert(
            self.named,
            Stream {
                name: name.to_owned(),
                ..Stream::default()
            },
        );
        self.named
    }
}

impl Logs {
    fn open(&mut self) -> u64 {
        self.opened += 1;
        let mut log = Log::default();
        log.streams.insert(STANDALONE, Stream::default());
        self.sessions.insert(self.opened, log);
        self.opened
    }

    fn close(&mut self, session: u64) {
        if let Some(log) = self.sessions.remove(&session) {
            self.kept.remove(log.kept());
        }
    }

    fn stream(&self, session: u64, stream: u64) -> Option<&Stream> {
        self.sessions.get(&session)?.streams.get(&stream)
    }

    /// Gives an event its id, and keeps its message, of so many bytes.
    fn store(
        &mut self,
        session: u64,
        name: &str,
        message: Option<(Arc<ServerJsonRpcMessage>, usize)>,
        now: Instant,
    ) -> EventId {
        // What a session says after its end goes to nobody.
        let Some(log) = self.sessions.get_mut(&session) else {
            return EventId {
                stream: STANDALONE,
                index: 0,
            };
        };
        let number = log.number(name);
        let stream = log
            .streams
            .get_mut(&number)
            .expect("a stream with a number");
        stream.last += 1;
        let id = EventId {
            stream: number,
            index: stream.last,
        };
        if let Some((message, bytes)) = message {
            self.stored += 1;
            let is_answer = matches!(
                *message,
                JsonRpcMessage::Response(_) | JsonRpcMessage::Error(_)
            );
            stream.answered |= is_answer && number != STANDALONE;
            let event = Event {
                index: id.index,
                order: self.stored,
                stored_at: now,
                bytes,
                message,
            };
            self.kept.add(&event);
            stream.events.push_back(event);
        }
        self.make_room(session, number);
        id
    }

    /// Drops the oldest of what is more than the bounds allow, now that a stream has grown.
    fn make_room(&mut self, session: u64, number: u64) {
        while self
            .stream(session, number)
            .is_some_and(|stream| !stream.kept().fits(OF_STREAM))
        {
            self.drop_first(session, number);
        }
        while let Some(log) = self.sessions.get_mut(&session) {
            if log.streams.len() > STREAMS {
                let oldest = *log
                    .streams
                    .keys()
                    .find(|number| **number != STANDALONE)
                    .expect("more than one stream");
                let stream = log.streams.remove(&oldest).expect("a stream with a number");
                self.kept.remove(stream.kept());
            } else if log.kept().fits(OF_SESSION) {
                break;
            } else {
                let (_, oldest) = log.oldest().expect("what does not fit is something");
                self.drop_first(session, oldest);
            }
        }
        // A look at each session, for each event while the bound is reached: some
        // microseconds beside an image.
        while !self.kept.fits(OF_ALL) {
            let oldest = self
                .sessions
                .iter()
                .filter_map(|(session, log)| Some((log.oldest()?, *session)))
                .min();
            let ((_, number), session) = oldest.expect("what does not fit is something");
            self.drop_first(session, number);
        }
    }

    fn drop_first(&mut self, session: u64, number: u64) {
        let log = self.sessions.get_mut(&session).expect("an open session");
        let stream = log.streams.get_mut(&number).expect("a stream with events");
        let event = stream.events.pop_front().expect("a stream with events");
        self.kept.remove(EventStoreUsage {
            events: 1,
            bytes: event.bytes,
        });
        if !stream.is_of_use(number) {
            log.streams.remove(&number);
        }
    }

    fn take(&mut self, session: u64, id: EventId, now: Instant) {
        let stream = self
            .sessions
            .get_mut(&session)
            .and_then(|log| log.streams.get_mut(&id.stream));
        if let Some(stream) = stream.filter(|stream| id.index <= stream.last) {
            stream.taken = stream.taken.max(id.index);
            stream.taken_at = Some(now);
        }
    }

    fn begin_request(&mut self, session: u64) {
        self.forget(session, |stream, event| {
            stream.answered && event.index <= stream.taken
        });
    }

    fn expire(&mut self, now: Instant) {
        let is_over = |since: Instant, time: Duration| now.saturating_duration_since(since) >= time;
        let sessions: Vec<u64> = self.sessions.keys().copied().collect();
        for session in sessions {
            self.forget(session, |stream, event| {
                let taken_at = stream.taken_at.filter(|_| event.index <= stream.taken);
                is_over(event.stored_at, UNTAKEN_FOR)
                    || taken_at.is_some_and(|taken_at| is_over(taken_at, TAKEN_FOR))
            });
        }
    }

    /// Forgets the first events of each stream of a session, as long as they are such.
    fn forget(&mut self, session: u64, such: impl Fn(&Stream, &Event) -> bool) {
        let Some(log) = self.sessions.get_mut(&session) else {
            return;
        };
        log.streams.retain(|number, stream| {
            while stream
                .events
                .front()
                .is_some_and(|event| such(stream, event))
            {
                let event = stream.events.pop_front().expect("there is a first one");
                self.kept.remove(EventStoreUsage {
                    events: 1,
                    bytes: event.bytes,
                });
            }
            stream.is_of_use(*number)
        });
    }

    fn next(&self, session: u64, after: EventId) -> Next {
        let Some(stream) = self.stream(session, after.stream) else {
            return Next::End;
        };
        match stream.events.iter().find(|event| event.index > after.index) {
            Some(event) => Next::Event(event.index, event.message(after.stream)),
            None if stream.answered => Next::End,
            None => Next::Wait,
        }
    }
}

/// How long a message is as JSON.
fn json_bytes(message: &ServerJsonRpcMessage) -> usize {
    struct Counted(usize);
    impl io::Write for Counted {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0 += bytes.len();
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }
    let mut counted = Counted(0);
    serde_json::to_writer(&mut counted, message).expect("a message of the protocol is JSON");
    counted.0
}

#[cfg(test)]
mod tests;
