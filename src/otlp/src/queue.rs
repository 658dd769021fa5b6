//! Spans that are sent while something else goes on: a bounded queue, and the thread that empties it. Whoever
//! hands something over never waits; what does not fit or does not arrive is counted.

use std::{
    sync::{
        Arc, Mutex, PoisonError,
        mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, channel, sync_channel},
    },
    thread,
    time::{Duration, Instant},
};

use crate::{ExportTraceServiceRequest, Sender};

/// What became of what a queue was given.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Delivery {
    /// Spans that the collector took.
    pub accepted: u64,
    /// Spans that the collector rejected, or that did not reach it.
    pub lost: u64,
    /// Items that did not fit into the queue, or were still in it at the end, or gave no spans.
    pub dropped: u64,
    /// What was last heard of that; `None` if nothing went wrong.
    pub problem: Option<String>,
}

impl std::fmt::Display for Delivery {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} spans sent", self.accepted)?;
        if self.lost > 0 {
            write!(f, ", {} spans lost", self.lost)?;
        }
        if self.dropped > 0 {
            write!(f, ", {} episodes dropped", self.dropped)?;
        }
        match &self.problem {
            Some(problem) => write!(f, ": {problem}"),
            None => Ok(()),
        }
    }
}

impl Delivery {
    /// Whether everything arrived.
    pub fn is_complete(&self) -> bool {
        self.lost == 0 && self.dropped == 0
    }
}

/// A bounded queue of items that a thread turns into spans and sends.
pub struct Queue<T> {
    items: SyncSender<T>,
    shared: Arc<Shared>,
    finished: Receiver<()>,
}

/// What the thread and its owner both know.
#[derive(Default)]
struct Shared {
    delivery: Mutex<Delivery>,
    /// When the thread gives up; `None` while nobody waits for it.
    deadline: Mutex<Option<Instant>>,
}

impl Shared {
    fn note(&self, change: impl FnOnce(&mut Delivery)) {
        // A panic elsewhere leaves counts that are still counts.
        change(&mut self.delivery.lock().unwrap_or_else(PoisonError::into_inner));
    }

    fn remaining(&self) -> Option<Duration> {
        let deadline = *self.deadline.lock().unwrap_or_else(PoisonError::into_inner);
        deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()))
    }

    /// Waits, unless the end comes before; whether to go on.
    fn sleep(&self, pause: Duration) -> bool {
        const SLICE: Duration = Duration::from_millis(50);
        let until = Instant::now() + pause;
        while Instant::now() < until {
            if self.remaining().is_some_and(|left| left.is_zero()) {
                return false;
            }
            thread::sleep(SLICE.min(until.saturating_duration_since(Instant::now())));
        }
        true
    }
}

impl<T: Send + 'static> Queue<T> {
    /// Starts the thread. `spans` makes requests of an item there, so that it costs whoever hands it over nothing.
    pub fn start(
        sender: Sender,
        capacity: usize,
        spans: impl Fn(T) -> Result<Vec<ExportTraceServiceRequest>, String> + Send + 'static,
    ) -> Self {
        let (items, received) = sync_channel(capacity);
        let (finish, finished) = channel();
        let shared = Arc::new(Shared::default());
        let work = Arc::clone(&shared);
        thread::spawn(move || {
            for item in received {
                match spans(item) {
                    Ok(requests) => deliver(&sender, &work, &requests),
                    Err(problem) => work.note(|delivery| {
                        delivery.dropped += 1;
                        delivery.problem = Some(problem);
                    }),
                }
            }
            // Nobody may wait any more.
            let _ = finish.send(());
        });
        Self {
            items,
            shared,
            finished,
        }
    }

    /// Hands an item over, without waiting; one that does not fit is dropped and counted.
    pub fn push(&self, item: T) {
        let problem = match self.items.try_send(item) {
            Ok(()) => return,
            Err(TrySendError::Full(_)) => {
                "the queue was full: the collector is slower than the episodes"
            }
            Err(TrySendError::Disconnected(_)) => "the thread that sends spans ended",
        };
        self.shared.note(|delivery| {
            delivery.dropped += 1;
            delivery.problem = Some(problem.to_owned());
        });
    }

    /// Waits until all is sent, at most so long, and says what became of it.
    pub fn finish(self, patience: Duration) -> Delivery {
        let Self {
            items,
            shared,
            finished,
        } = self;
        *shared
            .deadline
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = Some(Instant::now() + patience);
        drop(items);
        // The last try may take as long as one may.
        if let Err(RecvTimeoutError::Timeout) = finished.recv_timeout(patience) {
            shared.note(|delivery| {
                delivery.dropped += 1;
                delivery.problem = Some(format!(
                    "the collector did not take everything within {} s after the end",
                    patience.as_secs()
                ));
            });
        }
        let delivery = shared
            .delivery
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        delivery.clone()
    }
}

fn deliver(sender: &Sender, shared: &Shared, requests: &[ExportTraceServiceRequest]) {
    for request in requests {
        let count = crate::span_count(request);
        if shared.remaining().is_some_and(|left| left.is_zero()) {
            shared.note(|delivery| delivery.lost += count);
            continue;
        }
        let sent = sender.send(request, |pause| shared.sleep(pause));
        shared.note(|delivery| match sent {
            Ok(taken) => {
                delivery.accepted += taken.accepted;
                delivery.lost += taken.rejected;
                if !taken.message.is_empty() {
                    delivery.problem = Some(taken.message);
                }
            }
            Err(error) => {
                delivery.lost += count;
                delivery.problem = Some(error.to_string());
            }
        });
    }
}
