//! Hundreds of sessions in one process: each used by one call at a time, few at work at once, the
//! idle ones put aside.

use std::{
    collections::BTreeMap,
    panic::resume_unwind,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use reel_world::Frame;
use serde::Serialize;
use tokio::{
    sync::{Mutex as AsyncMutex, OwnedMutexGuard},
    time::Instant,
};

use crate::{
    Lease, LiveError, Owner, Session, SessionStatus, Setup, Situation, check_name,
    turns::{Turn, Turns},
};

/// How much a pool may take.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Limits {
    /// Sessions open at once.
    pub sessions: usize,
    /// Sessions of one owner at once, leases among them.
    pub sessions_each: usize,
    /// Simulators in memory at once; the others are snapshots.
    pub in_memory: usize,
    /// Calls at work at once: as many threads are busy.
    pub workers: usize,
    /// How long after its last call a session is put aside.
    pub suspend_after: Duration,
    /// How long after its last call a session is closed.
    pub close_after: Duration,
    /// How long a call waits for a worker before it is refused.
    pub worker_timeout: Duration,
}

/// Sessions by name, with limits on their number and on busy workers.
pub struct SessionPool {
    setup: Arc<Setup>,
    limits: Limits,
    sessions: Mutex<BTreeMap<String, Arc<Slot>>>,
    work: Arc<Turns>,
    closing: AtomicBool,
}

struct Slot {
    name: String,
    owner: Owner,
    lease: Option<Lease>,
    session: Arc<AsyncMutex<Session>>,
    seen: Mutex<SessionInfo>,
}

/// What is known of a session without asking it.
struct SessionInfo {
    state: SessionStatus,
    used: Instant,
}

/// A session, as people see it.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct SessionEntry {
    /// Name of the session in the pool.
    pub session: String,
    /// Status of the session: its state, task, step count and last trace.
    #[serde(flatten)]
    pub state: SessionStatus,
    /// Name of the token that opened it, if tokens are demanded.
    pub owner: Option<String>,
    /// Seconds since its last call.
    pub idle_s: u64,
    /// The prompt group it is let for, if any.
    pub group_id: Option<String>,
}

impl SessionPool {
    /// Creates a pool that has no session yet.
    pub fn new(setup: Setup, limits: Limits) -> Self {
        Self {
            setup: Arc::new(setup),
            work: Turns::new(limits.workers, limits.workers),
            limits,
            sessions: Mutex::default(),
            closing: AtomicBool::new(false),
        }
    }

    /// What all sessions play.
    pub fn setup(&self) -> &Arc<Setup> {
        &self.setup
    }

    /// How much it may take.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Opens a session, or finds the one of that name. Who opened it is the only one to use it.
    ///
    /// # Errors
    /// When the name is none, the pool is full or closing, or the session is somebody else's.
    pub fn open(&self, name: &str, owner: &Owner) -> Result<(), LiveError> {
        self.open_for(name, owner, None)
    }

    /// [`SessionPool::open`] for a prompt group.
    ///
    /// # Errors
    /// As [`SessionPool::open`], and when the task is unknown or the name is taken.
    pub fn open_for(
        &self,
        name: &str,
        owner: &Owner,
        lease: Option<Lease>,
    ) -> Result<(), LiveError> {
        self.slot(name, owner, lease).map(drop)
    }

    /// The session of that name, which is opened where there is none.
    fn slot(
        &self,
        name: &str,
        owner: &Owner,
        lease: Option<Lease>,
    ) -> Result<Arc<Slot>, LiveError> {
        check_name(name)?;
        if let Some(lease) = &lease
            && self.setup.task(&lease.task_id).is_none()
        {
            return Err(LiveError::UnknownTask(lease.task_id.clone()));
        }
        let mut sessions = self.lock();
        if self.closing.load(Ordering::Acquire) {
            return Err(LiveError::Closing);
        }
        if let Some(slot) = sessions.get(name) {
            return if !slot.owner.lets(owner) {
                Err(LiveError::OtherOwner(name.to_owned()))
            } else if lease.is_some() && slot.lease != lease {
                Err(LiveError::Taken(name.to_owned()))
            } else {
                Ok(slot.clone())
            };
        }
        if sessions.len() >= self.limits.sessions {
            return Err(LiveError::Full(self.limits.sessions));
        }
        let own = sessions.values().filter(|slot| slot.owner == *owner);
        if owner.name().is_some() && own.count() >= self.limits.sessions_each {
            return Err(LiveError::Quota {
                owner: owner.to_string(),
                limit: self.limits.sessions_each,
            });
        }
        let session = Session::new(name, self.setup.clone(), lease.clone());
        let seen = Mutex::new(SessionInfo {
            state: session.state(),
            used: Instant::now(),
        });
        let slot = Slot {
            name: name.to_owned(),
            owner: owner.clone(),
            lease,
            session: Arc::new(AsyncMutex::new(session)),
            seen,
        };
        let slot = Arc::new(slot);
        sessions.insert(name.to_owned(), slot.clone());
        Ok(slot)
    }

    /// Opens a session, or finds the one of that name, and does something with it as
    /// [`SessionPool::with_session`] does.
    ///
    /// # Errors
    /// As [`SessionPool::open`] and [`SessionPool::with_session`].
    pub async fn with_own_session<T: Send + 'static>(
        self: &Arc<Self>,
        name: &str,
        owner: &Owner,
        work: impl FnOnce(&mut Session) -> T + Send + 'static,
    ) -> Result<T, LiveError> {
        let slot = self.slot(name, owner, None)?;
        self.with_slot(slot, work).await
    }

    /// Does something with a session, alone with it, on a worker. Once begun it is done to the
    /// end, whoever stops waiting.
    ///
    /// # Errors
    /// When there is no such session, or no worker had time for it; nothing was done then.
    pub async fn with_session<T: Send + 'static>(
        self: &Arc<Self>,
        name: &str,
        work: impl FnOnce(&mut Session) -> T + Send + 'static,
    ) -> Result<T, LiveError> {
        let slot = self.found(name)?;
        self.with_slot(slot, work).await
    }

    fn found(&self, name: &str) -> Result<Arc<Slot>, LiveError> {
        let slot = self.lock().get(name).cloned();
        slot.ok_or_else(|| LiveError::Unknown(name.to_owned()))
    }

    async fn with_slot<T: Send + 'static>(
        self: &Arc<Self>,
        slot: Arc<Slot>,
        work: impl FnOnce(&mut Session) -> T + Send + 'static,
    ) -> Result<T, LiveError> {
        if self.closing.load(Ordering::Acquire) {
            return Err(LiveError::Closing);
        }
        let (session, worker) = self.wait(&slot).await?;
        let pool = self.clone();
        let done = self.setup.host.work.spawn(move || {
            let _worker = worker;
            let mut used = SessionGuard { session, slot };
            let value = work(&mut used.session);
            drop(used);
            pool.make_room();
            value
        });
        match done.await {
            Ok(value) => Ok(value),
            Err(error) if error.is_panic() => {
                let panic = error.into_panic();
                let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
                let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
                Err(LiveError::Broken(
                    text.unwrap_or_else(|| resume_unwind(panic)),
                ))
            }
            Err(_) => Err(LiveError::Closing),
        }
    }

    /// What a session's robot sees now. Who looks uses nothing: the session is put aside and
    /// closed as if nobody had.
    ///
    /// # Errors
    /// When there is no such session, nothing runs in it, or no worker had time.
    pub async fn render_frame(&self, name: &str) -> Result<Frame, LiveError> {
        let slot = self.found(name)?;
        let (session, worker) = self.wait(&slot).await?;
        let looked = self.setup.host.work.spawn(move || {
            let _worker = worker;
            session.render_frame()
        });
        looked.await.unwrap_or(Err(LiveError::Closing))
    }

    /// What there is to know at the step where a session is; the episode stays as it is, awake or
    /// not, and the session counts as unused.
    ///
    /// # Errors
    /// When there is no such session, nothing runs in it, or somebody else used it for too long.
    pub async fn situation(&self, name: &str) -> Result<Situation, LiveError> {
        let slot = self.found(name)?;
        let patience = self.limits.worker_timeout;
        let session = tokio::time::timeout(patience, slot.session.lock()).await;
        session
            .map_err(|_| LiveError::Busy(patience.as_secs()))?
            .situation()
    }

    /// Waits until nobody else uses a session and a worker has time.
    async fn wait(&self, slot: &Slot) -> Result<(OwnedMutexGuard<Session>, Turn), LiveError> {
        let patience = self.limits.worker_timeout;
        let waited = async {
            let session = slot.session.clone().lock_owned().await;
            (session, self.work.take(&slot.owner).await)
        };
        tokio::time::timeout(patience, waited)
            .await
            .map_err(|_| LiveError::Busy(patience.as_secs()))
    }

    /// Closes all sessions of an owner, whose episodes end as aborted; how many there were.
    pub async fn close_of(self: &Arc<Self>, owner: &Owner) -> usize {
        let names: Vec<String> = {
            let slots = self.lock();
            let own = slots.values().filter(|slot| slot.owner == *owner);
            own.map(|slot| slot.name.clone()).collect()
        };
        for name in &names {
            if let Err(error) = self.close(name).await {
                tracing::warn!(session = name, %error, "could not be closed");
            }
        }
        names.len()
    }

    /// Closes a session; what runs in it ends as aborted.
    ///
    /// # Errors
    /// When there is none of that name, or its trace cannot be written.
    pub async fn close(self: &Arc<Self>, name: &str) -> Result<SessionStatus, LiveError> {
        if self.closing.load(Ordering::Acquire) {
            return Err(LiveError::Closing);
        }
        let slot = self.found(name)?;
        let left = self
            .with_slot(slot.clone(), |session| {
                let left = session.abort();
                left.map(|()| session.state())
            })
            .await;
        if !matches!(left, Err(LiveError::Busy(_) | LiveError::Closing)) {
            let mut sessions = self.lock();
            // Somebody else may have closed it, too, and a third opened another of its name.
            if sessions
                .get(name)
                .is_some_and(|now| Arc::ptr_eq(now, &slot))
            {
                sessions.remove(name);
            }
        }
        left?
    }

    /// Puts idle sessions aside and closes forgotten ones. To be called now and then.
    pub async fn reap_idle(self: &Arc<Self>) {
        let idle = |limit: Duration| -> Vec<(String, SessionStatus)> {
            let slots = self.lock();
            let seen = slots.values().map(|slot| (slot.name.clone(), slot.seen()));
            seen.filter(|(_, seen)| seen.used.elapsed() >= limit)
                .map(|(name, seen)| (name, seen.state.clone()))
                .collect()
        };
        for (name, _) in idle(self.limits.close_after) {
            match self.close(&name).await {
                Ok(state) => {
                    tracing::info!(session = name, trace = ?state.trace, "closed: idle for too long")
                }
                Err(error) => tracing::warn!(session = name, %error, "could not be closed"),
            }
        }
        for (name, state) in idle(self.limits.suspend_after) {
            if state.state == "playing" {
                self.park(&name);
            }
        }
    }

    /// Ends every episode and closes every session; no call is taken from now on.
    pub async fn close_all(self: &Arc<Self>) -> usize {
        self.closing.store(true, Ordering::Release);
        let slots: Vec<Arc<Slot>> = std::mem::take(&mut *self.lock()).into_values().collect();
        let count = slots.len();
        for slot in slots {
            let session = slot.session.clone().lock_owned().await;
            let abort = move || SessionGuard { session, slot }.session.abort();
            let left = self.setup.host.work.spawn(abort).await;
            if !matches!(left, Ok(Ok(()))) {
                tracing::warn!(
                    ?left,
                    "an episode could not be ended; `reel trace recover` restores it"
                );
            }
        }
        count
    }

    /// Every session, by name.
    pub fn entries(&self) -> Vec<SessionEntry> {
        self.lock().values().map(|slot| slot.entry()).collect()
    }

    /// One session.
    ///
    /// # Errors
    /// When there is none of that name.
    pub fn entry(&self, name: &str) -> Result<SessionEntry, LiveError> {
        self.lock()
            .get(name)
            .map(|slot| slot.entry())
            .ok_or_else(|| LiveError::Unknown(name.to_owned()))
    }

    /// Puts the longest unused aside while more simulators are awake than may be.
    fn make_room(&self) {
        let mut awake: Vec<(Instant, String)> = {
            let slots = self.lock();
            let seen = slots.values().map(|slot| (slot.name.clone(), slot.seen()));
            seen.filter(|(_, seen)| seen.state.state == "playing")
                .map(|(name, seen)| (seen.used, name))
                .collect()
        };
        let excess = awake.len().saturating_sub(self.limits.in_memory);
        awake.sort_unstable();
        for (_, name) in awake.iter().take(excess) {
            self.park(name);
        }
    }

    /// Puts a session aside, unless somebody is using it.
    fn park(&self, name: &str) {
        let Some(slot) = self.lock().get(name).cloned() else {
            return;
        };
        if let Ok(mut session) = slot.session.clone().try_lock_owned() {
            session.suspend();
            slot.seen().state = session.state();
        }
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, Arc<Slot>>> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Slot {
    fn seen(&self) -> MutexGuard<'_, SessionInfo> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn entry(&self) -> SessionEntry {
        let seen = self.seen();
        SessionEntry {
            session: self.name.clone(),
            state: seen.state.clone(),
            owner: self.owner.name().map(str::to_owned),
            idle_s: seen.used.elapsed().as_secs(),
            group_id: self.lease.as_ref().map(|lease| lease.group_id.clone()),
        }
    }
}

/// A session in use: what is known of it is renewed when that ends, by a panic too.
struct SessionGuard {
    session: OwnedMutexGuard<Session>,
    slot: Arc<Slot>,
}

impl Drop for SessionGuard {
    fn drop(&mut self) {
        *self.slot.seen() = SessionInfo {
            state: self.session.state(),
            used: Instant::now(),
        };
    }
}
