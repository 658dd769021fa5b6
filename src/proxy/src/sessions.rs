//! The sessions that are open, by what tells them apart on the wire.

use std::{
    collections::{HashMap, VecDeque},
    sync::{
        Arc, Mutex, PoisonError, Weak,
        atomic::{AtomicU32, Ordering},
    },
};

use crate::{Setup, session::Session};

/// Ids of events that lead to sessions of servers without session ids; the oldest are forgotten.
const EVENTS_MAX: usize = 4096;

/// What tells a session from all others. Its values are secrets of their owners,
/// and are written nowhere.
#[derive(Clone, PartialEq, Eq, Hash, Debug)]
pub(crate) enum Key {
    /// `Mcp-Session-Id` of Streamable HTTP.
    Id(String),
    /// The target that a stream of HTTP+SSE names for messages.
    Messages(String),
    /// A client of a protocol without sessions: its address, what it calls, who it says it is.
    Client(String),
}

/// The sessions that are open.
pub(crate) struct Sessions {
    setup: Arc<Setup>,
    open: Mutex<HashMap<Key, Arc<Session>>>,
    begun: AtomicU32,
    /// The last events of servers without session ids, and whose they are: a stream that is resumed names the last one
    /// that came.
    events: Mutex<VecDeque<(String, Weak<Session>)>>,
}

impl Sessions {
    pub(crate) fn new(setup: Arc<Setup>) -> Self {
        Self {
            setup,
            open: Mutex::default(),
            begun: AtomicU32::new(0),
            events: Mutex::default(),
        }
    }

    /// A session that nothing leads to yet.
    pub(crate) fn begin(&self) -> Arc<Session> {
        self.setup.report.count(|counts| counts.sessions += 1);
        Session::new(
            self.setup.clone(),
            self.begun.fetch_add(1, Ordering::Relaxed) + 1,
        )
    }

    /// Makes a key lead to a session.
    pub(crate) fn keep(&self, key: Key, session: &Arc<Session>) {
        self.with(|open| open.insert(key, session.clone()));
    }

    pub(crate) fn find(&self, key: &Key) -> Option<Arc<Session>> {
        self.with(|open| open.get(key).cloned())
    }

    /// The session of a key; a new one where there is none, as after a restart.
    pub(crate) fn find_or_begin(&self, key: Key) -> Arc<Session> {
        self.find(&key).unwrap_or_else(|| {
            let session = self.begin();
            self.with(|open| open.entry(key).or_insert(session).clone())
        })
    }

    /// Notes whose an event is, by its id.
    pub(crate) fn note_event(&self, id: &str, session: &Arc<Session>) {
        let mut events = self.events.lock().unwrap_or_else(PoisonError::into_inner);
        if events.len() == EVENTS_MAX {
            events.pop_front();
        }
        events.push_back((id.to_owned(), Arc::downgrade(session)));
    }

    /// The session of an event of which [`Sessions::note_event`] noted the id.
    pub(crate) fn of_event(&self, id: &str) -> Option<Arc<Session>> {
        let events = self.events.lock().unwrap_or_else(PoisonError::into_inner);
        let (_, session) = events.iter().rev().find(|(found, _)| found == id)?;
        session.upgrade()
    }

    /// Ends a session, if it is open.
    pub(crate) fn end(&self, key: &Key, why: &str) {
        if let Some(session) = self.with(|open| open.remove(key)) {
            session.end(why);
        }
    }

    /// Ends those that have been silent for too long.
    pub(crate) fn end_idle(&self) {
        let idle = self.setup.idle;
        let over: Vec<Arc<Session>> = self.with(|open| {
            let silent = |(key, session): (&Key, &Arc<Session>)| {
                // A stream says itself when it ends.
                let ends_itself = matches!(key, Key::Messages(_));
                (!ends_itself && session.idle().is_some_and(|silence| silence > idle))
                    .then(|| key.clone())
            };
            let keys: Vec<Key> = open.iter().filter_map(silent).collect();
            keys.iter().filter_map(|key| open.remove(key)).collect()
        });
        over.iter()
            .for_each(|session| session.end("the session was silent for too long"));
    }

    /// Ends all of them.
    pub(crate) fn end_all(&self, why: &str) {
        let all: Vec<Arc<Session>> =
            self.with(|open| open.drain().map(|(_, session)| session).collect());
        all.iter().for_each(|session| session.end(why));
    }

    fn with<T>(&self, work: impl FnOnce(&mut HashMap<Key, Arc<Session>>) -> T) -> T {
        work(&mut self.open.lock().unwrap_or_else(PoisonError::into_inner))
    }
}
