//! Which sessions wait for an answer from outside, a model's or whoever looks queries up.

use std::{
    collections::BTreeSet,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use reel_live::LiveError;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// The sessions that wait for an answer from outside: each for one, and so many at a time, so that a
/// slow endpoint takes no thread from those who simulate.
#[derive(Debug)]
pub struct WaitingSessions {
    places: Arc<Semaphore>,
    sessions: Mutex<BTreeSet<String>>,
}

/// So many sessions may wait for an answer from outside at a time.
const WAITING_MAX: usize = 64;

impl Default for WaitingSessions {
    fn default() -> Self {
        Self {
            places: Arc::new(Semaphore::new(WAITING_MAX)),
            sessions: Mutex::default(),
        }
    }
}

impl WaitingSessions {
    /// Waits until the session may ask somebody outside.
    pub(crate) async fn wait(
        self: Arc<Self>,
        session: &str,
        patience: Duration,
    ) -> Result<WaitingTurn, LiveError> {
        let first = self.lock().insert(session.to_owned());
        if !first {
            return Err(LiveError::Busy(0));
        }
        let session = RemoveOnDrop {
            all: self.clone(),
            session: session.to_owned(),
        };
        let place = tokio::time::timeout(patience, self.places.clone().acquire_owned()).await;
        match place {
            Ok(Ok(place)) => Ok(WaitingTurn {
                _session: session,
                _place: place,
            }),
            Ok(Err(_)) | Err(_) => Err(LiveError::Busy(patience.as_secs())),
        }
    }

    fn lock(&self) -> MutexGuard<'_, BTreeSet<String>> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A session that waits for an answer.
pub(crate) struct WaitingTurn {
    _session: RemoveOnDrop,
    _place: OwnedSemaphorePermit,
}

/// Lets a session wait again when it is dropped.
struct RemoveOnDrop {
    all: Arc<WaitingSessions>,
    session: String,
}

impl Drop for RemoveOnDrop {
    fn drop(&mut self) {
        self.all.lock().remove(&self.session);
    }
}
