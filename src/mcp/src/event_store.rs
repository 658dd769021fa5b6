//! What clients that were cut off may still ask for: the events of Streamable HTTP,
//! found again by `Last-Event-ID`.
//!
//! rmcp stores every event of a session here, hands it to the connection that waits for it, and
//! forgets it; a resume is answered from here alone. Answers hold pictures, a thousand sessions are
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
//! copied: texts and pictures take as much there, numbers and names some times more.

use std::{
    collections::{BTreeMap, HashMap, VecDeque},
    fmt, io,
    str::FromStr,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use async_trait::async_trait;
use futures_util::stream;
use rmcp::{
    model::{JsonRpcMessage, ServerJsonRpcMessage},
    transport::streamable_http_server::session::{
        EventStore, EventStoreError, EventStream, ServerSseMessage,
    },
};
use tokio::sync::Notify;

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
            .map_err(|()| format!("{last_event_id:?} is no id of an event"))?;
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
        // microseconds beside a picture.
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
mod tests {
    use serde_json::json;

    use super::*;

    /// An answer, or something said before one.
    fn message(is_answer: bool) -> Arc<ServerJsonRpcMessage> {
        let message = match is_answer {
            true => json!({"jsonrpc": "2.0", "id": 1, "result": {}}),
            false => json!({"jsonrpc": "2.0", "method": "notifications/tools/list_changed"}),
        };
        Arc::new(serde_json::from_value(message).unwrap())
    }

    /// The same, of so many bytes.
    fn of(is_answer: bool, bytes: usize) -> Option<(Arc<ServerJsonRpcMessage>, usize)> {
        Some((message(is_answer), bytes))
    }

    /// Ids of the events after one of them, as far as they are kept.
    fn after(logs: &Logs, session: u64, id: &str) -> Vec<String> {
        let mut after: EventId = id.parse().unwrap();
        let mut ids = Vec::new();
        while let Next::Event(index, event) = logs.next(session, after) {
            ids.push(event.event_id.unwrap());
            after.index = index;
        }
        ids
    }

    /// That the counts are those of what is there.
    fn check(logs: &Logs) {
        let mut kept = EventStoreUsage::default();
        for log in logs.sessions.values() {
            assert!(
                log.kept().fits(OF_SESSION) && log.streams.len() <= STREAMS,
                "{:?}",
                log.kept()
            );
            assert!(
                log.streams
                    .values()
                    .all(|stream| stream.kept().fits(OF_STREAM))
            );
            log.streams
                .values()
                .flat_map(|stream| &stream.events)
                .for_each(|event| kept.add(event));
        }
        assert_eq!(kept, logs.kept);
        assert!(kept.fits(OF_ALL), "{kept:?}");
    }

    #[test]
    fn ids() {
        for (text, stream, index) in [("0", 0, 0), ("7", 0, 7), ("7/3", 3, 7)] {
            let id = EventId { stream, index };
            assert_eq!((text.parse(), id.to_string().as_str()), (Ok(id), text));
        }
        for text in [
            "",
            "/",
            "7/",
            "/3",
            "7/3/1",
            "-1",
            "7 ",
            "x",
            "18446744073709551616",
            "\u{667}",
        ] {
            assert_eq!(text.parse::<EventId>(), Err(()), "{text}");
        }
    }

    #[test]
    fn an_answer_that_nobody_took_outlives_requests_and_one_that_was_taken_does_not() {
        let (mut logs, now) = (Logs::default(), Instant::now());
        let (session, other) = (logs.open(), logs.open());
        let primed = logs.store(session, "a", None, now);
        assert_eq!(primed.to_string(), "1/1");
        assert_eq!(logs.kept, EventStoreUsage::default());
        logs.store(session, "a", of(false, 9), now);
        let answer = logs.store(session, "a", of(true, 9), now);
        assert_eq!(after(&logs, session, "1/1"), ["2/1", "3/1"]);
        assert_eq!(after(&logs, session, "2/1"), ["3/1"]);
        assert!(matches!(logs.next(session, answer), Next::End));
        assert!(
            matches!(logs.next(other, primed), Next::End),
            "another session's"
        );
        logs.begin_request(session);
        assert_eq!(after(&logs, session, "1/1"), ["2/1", "3/1"]);
        // Also while another request is under way, whose stream goes on.
        let second = logs.store(session, "b", None, now);
        assert!(matches!(logs.next(session, second), Next::Wait));
        logs.take(session, answer, now);
        assert_eq!(
            after(&logs, session, "1/1"),
            ["2/1", "3/1"],
            "it may have been lost on the way"
        );
        logs.begin_request(session);
        assert!(matches!(logs.next(session, primed), Next::End));
        assert!(matches!(logs.next(session, second), Next::Wait));
        assert_eq!(logs.kept, EventStoreUsage::default());
        logs.close(session);
        logs.store(session, "b", of(true, 9), now);
        assert!(matches!(logs.next(session, second), Next::End));
        check(&logs);
    }

    #[test]
    fn nothing_is_kept_for_long() {
        let (mut logs, begun) = (Logs::default(), Instant::now());
        let session = logs.open();
        let taken = logs.store(session, "a", of(true, 9), begun);
        let untaken = logs.store(session, "b", of(true, 9), begun);
        let standalone = logs.store(session, "x:common", of(false, 9), begun);
        logs.take(session, taken, begun);
        logs.take(session, standalone, begun);
        logs.take(
            session,
            EventId {
                stream: 9,
                index: 1,
            },
            begun,
        );
        logs.take(
            session,
            EventId {
                index: 2,
                ..untaken
            },
            begun,
        );
        assert_eq!(logs.kept.events, 3);
        logs.expire(begun + TAKEN_FOR - Duration::from_millis(1));
        assert_eq!(logs.kept.events, 3);
        logs.expire(begun + TAKEN_FOR);
        assert_eq!(
            (after(&logs, session, "0/2"), logs.kept.events),
            (vec!["1/2".to_owned()], 1)
        );
        logs.expire(begun + UNTAKEN_FOR);
        assert_eq!(
            (logs.kept, logs.sessions[&session].streams.len()),
            (EventStoreUsage::default(), 1)
        );
        check(&logs);
        // The standalone stream goes on where it was.
        assert_eq!(
            logs.store(session, "x:common", None, begun).to_string(),
            "2"
        );
    }

    #[test]
    fn a_stream_and_a_session_have_bounds() {
        let (mut logs, now) = (Logs::default(), Instant::now());
        let session = logs.open();
        for _ in 0..20 {
            logs.store(session, "a", of(false, 9), now);
        }
        assert_eq!(
            after(&logs, session, "1/1").len(),
            OF_STREAM.events,
            "the last ones"
        );
        assert_eq!(after(&logs, session, "19/1"), ["20/1"]);
        // Requests that are never answered, and answers that are never taken.
        for number in 0..100 {
            logs.store(session, &format!("open {number}"), None, now);
            logs.store(
                session,
                &format!("answered {number}"),
                of(true, 100_000),
                now,
            );
            check(&logs);
        }
        let kept = logs.sessions[&session].kept();
        assert_eq!(after(&logs, session, "0/201"), ["1/201"], "{kept:?}");
        // An answer larger than a session may have is nowhere, and disturbs
        // nothing that comes later.
        logs.store(session, "large", of(true, OF_SESSION.bytes), now);
        logs.store(session, "small", of(true, 9), now);
        assert_eq!(
            (
                after(&logs, session, "0/202"),
                after(&logs, session, "0/203")
            ),
            (vec![], vec!["1/203".to_owned()])
        );
        check(&logs);
    }

    #[test]
    fn all_sessions_together_have_a_bound() {
        let (mut logs, now) = (Logs::default(), Instant::now());
        let sessions: Vec<u64> = (0..1_000).map(|_| logs.open()).collect();
        for session in &sessions {
            logs.store(*session, "a", of(true, 130_000), now);
        }
        check(&logs);
        let room = OF_ALL.bytes / 130_000;
        assert_eq!(logs.kept.events, room);
        let holds = |session: &u64| logs.sessions[session].kept().events;
        assert!(
            sessions[1_000 - room..]
                .iter()
                .all(|session| holds(session) == 1),
            "the last ones"
        );
        assert!(
            sessions[..1_000 - room]
                .iter()
                .all(|session| holds(session) == 0)
        );
        sessions.iter().for_each(|session| logs.close(*session));
        assert_eq!(
            (logs.kept, logs.sessions.len()),
            (EventStoreUsage::default(), 0)
        );
    }

    #[tokio::test]
    async fn a_replay_goes_on_until_the_answer_or_the_end_of_the_session() {
        use futures_util::StreamExt as _;

        let events = Events::default();
        let session = events.open();
        let say = async |name: &str, message| {
            let event = ServerSseMessage::from_message(Arc::unwrap_or_clone(message));
            session.store_event(name, &event).await.unwrap()
        };
        let primed = session
            .store_event("a", &ServerSseMessage::retry(Duration::from_secs(3)))
            .await
            .unwrap();
        let replay = session.replay_events_after(&primed).await.unwrap();
        let replay = tokio::spawn(
            replay
                .map(|event| event.event_id.unwrap())
                .collect::<Vec<_>>(),
        );
        tokio::task::yield_now().await;
        say("a", message(false)).await;
        tokio::task::yield_now().await;
        say("b", message(true)).await;
        say("a", message(true)).await;
        assert_eq!(replay.await.unwrap(), ["2/1", "3/1"]);
        let mut standalone = session.replay_events_after("0").await.unwrap();
        say("x:common", message(false)).await;
        assert_eq!(
            standalone.next().await.unwrap().event_id.as_deref(),
            Some("1")
        );
        let ended = tokio::spawn(async move { standalone.next().await.is_none() });
        tokio::task::yield_now().await;
        session.close();
        assert!(ended.await.unwrap());
        for id in ["0", "2/1", "1/9", "x"] {
            assert!(session.replay_events_after(id).await.is_err(), "{id}");
        }
        assert_eq!(events.usage(), EventStoreUsage::default());
    }

    #[test]
    fn bytes_are_those_of_the_json() {
        assert_eq!(
            json_bytes(&message(true)),
            r#"{"jsonrpc":"2.0","id":1,"result":{}}"#.len()
        );
    }
}
