//! The sessions of Streamable HTTP: so many and no more, and none that does nothing for long.
//!
//! Each is a session of rmcp with an event store of its own, so that no client gets what another
//! missed. Never looks into a message further than whether it calls a tool.

use std::{
    cell::Cell,
    collections::HashMap,
    io,
    sync::{Arc, Mutex, MutexGuard, Once, PoisonError, Weak},
    time::Duration,
};

use axum::{
    extract::Request,
    http::{Method, StatusCode},
    middleware::Next,
    response::{IntoResponse, Response},
};
use futures_util::{Stream, StreamExt as _, future, stream};
use rmcp::{
    model::{ClientJsonRpcMessage, ClientRequest, JsonRpcMessage, ServerJsonRpcMessage},
    transport::{
        WorkerTransport,
        streamable_http_server::{
            SessionId, SessionManager,
            session::{
                EventStream, ServerSseMessage,
                local::{
                    LocalSessionManager, LocalSessionManagerError, LocalSessionWorker,
                    SessionConfig, SessionError,
                },
            },
        },
    },
};
use tokio::{
    sync::{OwnedSemaphorePermit, Semaphore},
    time::Instant,
};

use crate::{
    Caller, as_it_came,
    event_store::{Events, SessionEvents},
};

/// How long a session lives that called no tool yet, without a request and without a stream that
/// its client listens to.
const SILENT_FOR: Duration = Duration::from_secs(120);
const TEND_EVERY: Duration = Duration::from_secs(10);

tokio::task_local! {
    /// Why the request that is being answered got no session, or ended none.
    static REFUSED: Cell<Option<Refusal>>;
}

type Error = LocalSessionManagerError;

/// Why a request got no session, or ended none.
#[derive(Clone, Copy)]
enum Refusal {
    /// As many are open as may be.
    Full,
    /// The token has as many as it may have.
    Quota(usize),
    /// There is none of the id that was to be ended.
    Unknown,
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        let advice = "end one with DELETE, or come back later";
        match self {
            Refusal::Full => {
                let text = format!("as many sessions are open as may be: {advice}");
                (StatusCode::SERVICE_UNAVAILABLE, text).into_response()
            }
            Refusal::Quota(limit) => {
                let text = format!("your token has {limit} sessions, as many as it may: {advice}");
                (StatusCode::TOO_MANY_REQUESTS, text).into_response()
            }
            Refusal::Unknown => {
                (StatusCode::NOT_FOUND, "Not Found: Session not found").into_response()
            }
        }
    }
}

/// The open MCP sessions, and the limit on their number.
pub(crate) struct Sessions {
    this: Weak<Self>,
    open: Mutex<HashMap<SessionId, Arc<Session>>>,
    limit: usize,
    limit_each: usize,
    places: Arc<Semaphore>,
    config: SessionConfig,
    events: Events,
    tended: Once,
}

/// One open MCP session, with its events and its slot under the limit.
struct Session {
    local: LocalSessionManager,
    events: SessionEvents,
    life: Arc<Mutex<Life>>,
    caller: Caller,
    _place: OwnedSemaphorePermit,
}

/// What is known of a client.
struct Life {
    heard: Instant,
    calls: bool,
    listens: usize,
}

impl Sessions {
    /// Room for `limit` sessions, `limit_each` of one token, each of which ends when nothing came
    /// or went for `keep_alive`.
    pub fn new(limit: usize, limit_each: usize, keep_alive: Duration) -> Arc<Self> {
        let mut config = SessionConfig::default();
        config.keep_alive = Some(keep_alive);
        Arc::new_cyclic(|this| Self {
            this: this.clone(),
            open: Mutex::default(),
            limit,
            limit_each,
            places: Arc::new(Semaphore::new(limit.min(Semaphore::MAX_PERMITS))),
            config,
            events: Events::default(),
            tended: Once::new(),
        })
    }

    /// Answers 503 or 429 to who wanted one session too many, where rmcp answers 500. Where rmcp answers 202 to who ends
    /// one, this is 204, for of 202 the official client says that it could not end it, and 404 if it was not there.
    pub async fn set_status(request: Request, next: Next) -> Response {
        let ends = request.method() == Method::DELETE;
        let answered = async {
            let mut response = next.run(request).await;
            if ends && response.status() == StatusCode::ACCEPTED {
                *response.status_mut() = StatusCode::NO_CONTENT;
            }
            REFUSED
                .with(Cell::get)
                .map_or(response, IntoResponse::into_response)
        };
        REFUSED.scope(Cell::new(None), answered).await
    }

    /// Forgets what nobody will ask for, and ends sessions that do nothing or whose token is gone.
    async fn tend(&self, now: Instant) {
        self.events.expire(now);
        let why = |session: &Session| {
            if session.caller.revoked.is_cancelled() {
                Some("closed: its token was revoked")
            } else {
                let silent = session.life().is_silent(now);
                silent.then_some("closed: it called no tool")
            }
        };
        let over: Vec<(SessionId, &str)> = self
            .lock()
            .iter()
            .filter_map(|(id, session)| Some((id.clone(), why(session)?)))
            .collect();
        for (id, why) in over {
            tracing::info!(session = &*id, why);
            if let Err(error) = self.close_session(&id).await {
                tracing::warn!(session = &*id, %error, "could not be closed");
            }
        }
    }

    fn session(&self, id: &SessionId) -> Result<Arc<Session>, Error> {
        self.lock()
            .get(id)
            .filter(|session| session.caller.lets_current())
            .cloned()
            .ok_or_else(|| Error::SessionNotFound(id.clone()))
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<SessionId, Arc<Session>>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// How many sessions the owner of a caller has; none where it has no name.
fn owned(open: &HashMap<SessionId, Arc<Session>>, caller: &Caller) -> usize {
    let own = |session: &&Arc<Session>| session.caller.owner == caller.owner;
    match caller.owner.name() {
        Some(_) => open.values().filter(own).count(),
        None => 0,
    }
}

async fn tend(sessions: Weak<Sessions>) {
    loop {
        tokio::time::sleep(TEND_EVERY).await;
        let Some(sessions) = sessions.upgrade() else {
            return;
        };
        sessions.tend(Instant::now()).await;
    }
}

impl Session {
    fn life(&self) -> MutexGuard<'_, Life> {
        lock(&self.life)
    }

    /// A stream that tells the events what its connection took, and the session for
    /// how long somebody listened.
    fn watched<S>(&self, stream: S, listening: Option<Listening>) -> EventStream
    where
        S: Stream<Item = ServerSseMessage> + Send + Sync + 'static,
    {
        let events = self.events.clone();
        let taken = stream.inspect(move |event| {
            let _listening = &listening;
            events.taken(event);
        });
        Box::pin(taken.map(as_it_came::outgoing_event))
    }

    fn listen(&self) -> Listening {
        self.life().listens += 1;
        Listening(self.life.clone())
    }
}

impl Life {
    fn is_silent(&self, now: Instant) -> bool {
        !self.calls && self.listens == 0 && now.saturating_duration_since(self.heard) >= SILENT_FOR
    }
}

/// Lives as long as a client listens.
struct Listening(Arc<Mutex<Life>>);

impl Drop for Listening {
    fn drop(&mut self) {
        let mut life = lock(&self.0);
        life.listens -= 1;
        life.heard = Instant::now();
    }
}

fn lock(life: &Mutex<Life>) -> MutexGuard<'_, Life> {
    life.lock().unwrap_or_else(PoisonError::into_inner)
}

impl SessionManager for Sessions {
    type Error = Error;
    type Transport = WorkerTransport<LocalSessionWorker>;

    async fn create_session(&self) -> Result<(SessionId, Self::Transport), Error> {
        let refuse = |why: Refusal, limit: usize| {
            let _ = REFUSED.try_with(|refused| refused.set(Some(why)));
            let full = io::Error::other(format!("the limit of {limit} open sessions is reached"));
            Err(SessionError::Io(full).into())
        };
        let caller = Caller::current().unwrap_or_default();
        if owned(&self.lock(), &caller) >= self.limit_each {
            return refuse(Refusal::Quota(self.limit_each), self.limit_each);
        }
        let Ok(place) = self.places.clone().try_acquire_owned() else {
            return refuse(Refusal::Full, self.limit);
        };
        self.tended
            .call_once(|| drop(tokio::spawn(tend(self.this.clone()))));
        let events = self.events.open();
        let mut local = LocalSessionManager::default();
        local.session_config = self.config.clone();
        let local = local.with_event_store(Arc::new(events.clone()));
        let (id, transport) = local.create_session().await?;
        let life = Life {
            heard: Instant::now(),
            calls: false,
            listens: 0,
        };
        let session = Session {
            local,
            events,
            life: Arc::new(Mutex::new(life)),
            caller,
            _place: place,
        };
        let mut open = self.lock();
        // Others may have come while this one was made.
        if owned(&open, &session.caller) >= self.limit_each {
            return refuse(Refusal::Quota(self.limit_each), self.limit_each);
        }
        open.insert(id.clone(), Arc::new(session));
        Ok((id, transport))
    }

    async fn initialize_session(
        &self,
        id: &SessionId,
        message: ClientJsonRpcMessage,
    ) -> Result<ServerJsonRpcMessage, Error> {
        self.session(id)?
            .local
            .initialize_session(id, message)
            .await
    }

    async fn has_session(&self, id: &SessionId) -> Result<bool, Error> {
        Ok(self.session(id).is_ok())
    }

    async fn close_session(&self, id: &SessionId) -> Result<(), Error> {
        let found = self.session(id).is_ok();
        let Some(session) = found.then(|| self.lock().remove(id)).flatten() else {
            // A session that ends by itself is closed again by rmcp, in answer to nobody.
            let _ = REFUSED.try_with(|refused| refused.set(Some(Refusal::Unknown)));
            return Ok(());
        };
        session.events.close();
        session.local.close_session(id).await
    }

    async fn create_stream(
        &self,
        id: &SessionId,
        message: ClientJsonRpcMessage,
    ) -> Result<impl Stream<Item = ServerSseMessage> + Send + Sync + 'static, Error> {
        let session = self.session(id)?;
        let calls = matches!(&message, JsonRpcMessage::Request(request) if matches!(request.request, ClientRequest::CallToolRequest(_)));
        {
            let mut life = session.life();
            life.heard = Instant::now();
            life.calls |= calls;
        }
        session.events.begin_request();
        let stream = session.local.create_stream(id, message).await?;
        Ok(session.watched(stream, None))
    }

    async fn accept_message(
        &self,
        id: &SessionId,
        message: ClientJsonRpcMessage,
    ) -> Result<(), Error> {
        let session = self.session(id)?;
        session.life().heard = Instant::now();
        session.local.accept_message(id, message).await
    }

    async fn create_standalone_stream(
        &self,
        id: &SessionId,
    ) -> Result<impl Stream<Item = ServerSseMessage> + Send + Sync + 'static, Error> {
        let session = self.session(id)?;
        let is_alone = session.life().listens == 0;
        let listening = session.listen();
        let stream = session.local.create_standalone_stream(id).await?;
        // What rmcp has said from here on comes in `stream` as well.
        let missed = if is_alone {
            session.events.missed()
        } else {
            Vec::new()
        };
        let known: Vec<Option<String>> =
            missed.iter().map(|event| event.event_id.clone()).collect();
        let stream = stream.filter(move |event| future::ready(!known.contains(&event.event_id)));
        Ok(session.watched(stream::iter(missed).chain(stream), Some(listening)))
    }

    async fn resume(
        &self,
        id: &SessionId,
        last_event_id: String,
    ) -> Result<impl Stream<Item = ServerSseMessage> + Send + Sync + 'static, Error> {
        let session = self.session(id)?;
        let listening = session.listen();
        let stream = session.local.resume(id, last_event_id).await?;
        Ok(session.watched(stream, Some(listening)))
    }
}

#[cfg(test)]
mod tests;
