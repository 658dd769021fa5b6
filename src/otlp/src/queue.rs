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
    /// Whether every span reached the collector.
    pub fn is_complete(&self) -> bool {
        self.lost == 0 && self.dropped == 0
    }
}

/// A bounded queue of items that a thread turns into spans and sends.
pub struct Queue<T> {
    /// `None` once nothing more is taken.
    items: Mutex<Option<SyncSender<T>>>,
    shared: Arc<Shared>,
    finished: Mutex<Receiver<()>>,
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
            items: Mutex::new(Some(items)),
            shared,
            finished: Mutex::new(finished),
        }
    }

    /// Hands an item over, without waiting; one that does not fit is dropped and counted.
    pub fn push(&self, item: T) {
        let items = self.items.lock().unwrap_or_else(PoisonError::into_inner);
        let sent = items.as_ref().map(|items| items.try_send(item));
        drop(items);
        let problem = match sent {
            Some(Ok(())) => return,
            Some(Err(TrySendError::Full(_))) => {
                "the queue was full: the collector is slower than the episodes"
            }
            Some(Err(TrySendError::Disconnected(_))) => "the thread that sends spans ended",
            None => "an episode ended after the last spans were sent",
        };
        self.shared.note(|delivery| {
            delivery.dropped += 1;
            delivery.problem = Some(problem.to_owned());
        });
    }

    /// Takes nothing more, waits until all is sent, at most so long, and says what became of it.
    pub fn finish(&self, patience: Duration) -> Delivery {
        let shared = &self.shared;
        *shared
            .deadline
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = Some(Instant::now() + patience);
        let items = self
            .items
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        let is_first = items.is_some();
        drop(items);
        let finished = self.finished.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = is_first.then(|| finished.recv_timeout(patience));
        if let Some(Err(RecvTimeoutError::Timeout)) = waited {
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

#[cfg(test)]
mod tests {
    use std::{
        io::{Read as _, Write as _},
        net::{TcpListener, TcpStream},
        sync::atomic::{AtomicUsize, Ordering},
    };

    use super::*;
    use crate::{Endpoint, InstrumentationScope, Resource, Span, batches};

    fn request(spans: usize) -> ExportTraceServiceRequest {
        let spans = vec![Span::default(); spans];
        let (resource, scope) = (Resource::default(), InstrumentationScope::default());
        batches(&resource, &scope, spans, 1 << 20).remove(0)
    }

    fn sender(address: &str) -> Sender {
        let endpoint = Endpoint::resolve(Some(address), |_| None);
        Sender::new(endpoint.unwrap().unwrap())
    }

    /// Reads a request to the end of its body.
    fn taken(stream: &mut TcpStream) {
        let mut bytes = Vec::new();
        let mut part = [0; 4096];
        loop {
            let text = String::from_utf8_lossy(&bytes).to_lowercase();
            if let Some(head) = text.find("\r\n\r\n") {
                let length = text.split("content-length: ").nth(1).unwrap_or("0");
                let length: usize = length.split("\r\n").next().unwrap().parse().unwrap();
                if bytes.len() >= head + 4 + length {
                    return;
                }
            }
            let count = stream.read(&mut part).unwrap();
            bytes.extend(&part[..count]);
        }
    }

    #[test]
    fn what_is_busy_is_asked_again() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = format!("http://{}", listener.local_addr().unwrap());
        let asked = Arc::new(AtomicUsize::new(0));
        let count = Arc::clone(&asked);
        thread::spawn(move || {
            for stream in listener.incoming() {
                let mut stream = stream.unwrap();
                taken(&mut stream);
                let head = match count.fetch_add(1, Ordering::SeqCst) {
                    0 => "HTTP/1.1 503 Busy\r\nRetry-After: 0\r\n",
                    1 => "HTTP/1.1 200 OK\r\n",
                    _ => "HTTP/1.1 400 Wrong\r\n",
                };
                let rest = "Content-Length: 0\r\nConnection: close\r\n\r\n";
                stream
                    .write_all(format!("{head}{rest}").as_bytes())
                    .unwrap();
            }
        });
        let queue = Queue::start(sender(&address), 8, |count| match count {
            0 => Err("no trace".to_owned()),
            count => Ok(vec![request(count)]),
        });
        for count in [3, 0, 2] {
            queue.push(count);
        }
        let delivery = queue.finish(Duration::from_secs(20));
        assert_eq!(asked.load(Ordering::SeqCst), 3);
        assert_eq!(
            (delivery.accepted, delivery.lost, delivery.dropped),
            (3, 2, 1)
        );
        assert!(!delivery.is_complete());
        let problem = delivery.problem.unwrap();
        assert!(problem.contains("status 400"), "{problem}");
        queue.push(1);
        assert_eq!(queue.finish(Duration::ZERO).dropped, 2);
    }

    #[test]
    fn a_full_queue_drops_and_never_waits() {
        // Nothing listens at the address of a socket that was closed.
        let closed = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = format!("http://{}", closed.local_addr().unwrap());
        drop(closed);
        let queue = Queue::start(sender(&address), 1, |()| Ok(vec![request(1)]));
        (0..100).for_each(|_| queue.push(()));
        let delivery = queue.finish(Duration::from_millis(200));
        assert_eq!(delivery.accepted, 0);
        assert!(delivery.dropped >= 97, "{delivery}");
        assert!(delivery.problem.is_some());
    }
}
