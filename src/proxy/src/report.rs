//! What went by, in numbers, and what is still being finished.

use std::{
    sync::{Mutex, PoisonError},
    thread::{self, JoinHandle},
};

use serde::Serialize;

/// Numbers of a whole run.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize)]
pub struct Counts {
    /// Sessions that agents began with the recorder.
    pub sessions: u64,
    /// Episodes whose traces are whole.
    pub episodes: u64,
    /// Calls that were recorded as decisions.
    pub calls: u64,
    /// Calls around episodes (`finish` without one, `finish_with_id`, `list_tasks`,
    /// `list_receptacles`): passed on, no decisions.
    pub session_calls: u64,
    /// Calls whose results never came, or could not be read: recorded as failed.
    pub unanswered: u64,
    /// Calls and results that went by unrecorded because of write trouble (`--on-full continue`).
    pub unrecorded: u64,
    /// Calls and results that were refused because of write trouble (`--on-full stop`).
    pub refused: u64,
    /// Messages larger than the limit: passed on unrecorded.
    pub too_large: u64,
    /// Messages that are not JSON-RPC, and calls whose arguments are no object, which servers
    /// refuse unread: passed on.
    pub strange: u64,
    /// Integers of more than 64 bits in calls and results: written as the nearest fraction.
    pub rounded_integers: u64,
    /// Connections whose bytes are not HTTP/1.1: passed on without a look.
    pub opaque_connections: u64,
    /// Secrets that were replaced by labels in what was written.
    pub redacted: u64,
    /// Images that cannot stand in a trace.
    pub images_rejected: u64,
    /// Episodes whose reward depends on what the camera saw, or on which objects fit the words of a
    /// task without a file: no server tells either.
    pub open_rewards: u64,
}

/// Traces that are being made whole beside what goes by.
#[derive(Debug, Default)]
pub struct PendingTraces(Mutex<Vec<JoinHandle<()>>>);

impl PendingTraces {
    pub(crate) fn add(&self, work: impl FnOnce() + Send + 'static) {
        let mut running = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        running.retain(|ending| !ending.is_finished());
        running.push(thread::spawn(work));
    }

    /// Waits for all of them.
    pub(crate) fn wait(&self) {
        let running = std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner));
        running.into_iter().for_each(|ending| drop(ending.join()));
    }
}

/// Numbers that are being counted.
#[derive(Debug, Default)]
pub struct Report(Mutex<Counts>);

impl Report {
    pub(crate) fn count(&self, change: impl FnOnce(&mut Counts)) {
        change(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner));
    }

    /// The numbers so far.
    pub fn counts(&self) -> Counts {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }
}
