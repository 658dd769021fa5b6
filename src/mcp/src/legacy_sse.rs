//! The transport of 2024: `GET /sse` opens a stream of server-sent events and names the path to
//! post messages to. rmcp serves only its successor; REAL's agents and its trainer speak this one.

use std::{
    collections::HashMap,
    convert::Infallible,
    future::Future,
    io,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use axum::{
    body::Bytes,
    http::StatusCode,
    response::{
        IntoResponse, Response,
        sse::{Event, KeepAlive, Sse},
    },
};
use futures_util::{StreamExt as _, stream};
use rmcp::{
    RoleServer, ServerHandler,
    model::{
        ClientJsonRpcMessage, ClientNotification, JsonRpcMessage, JsonRpcNotification, RequestId,
    },
    serve_server,
    service::{RxJsonRpcMessage, TxJsonRpcMessage},
    transport::Transport,
};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio_stream::wrappers::ReceiverStream;
use tokio_util::sync::{CancellationToken, DropGuard};

use crate::{Caller, as_it_came};

/// Messages that may wait in each direction of one connection.
const QUEUE: usize = 64;
/// Requests of one connection whose answers the client has not read yet. Who wants more waits, and
/// is refused after a while: answers hold images, and a client may post without ever reading.
const UNREAD: usize = 32;
/// How long a message waits for room.
const PATIENCE: Duration = Duration::from_secs(15);
const KEEP_ALIVE: Duration = Duration::from_secs(15);

type In = RxJsonRpcMessage<RoleServer>;
type Out = TxJsonRpcMessage<RoleServer>;

/// The open connections, by the id that a client was told.
#[derive(Clone, Default)]
pub(crate) struct Connections(Arc<Mutex<HashMap<String, Client>>>);

/// A client that listens.
#[derive(Clone)]
struct Client {
    caller: Caller,
    to_server: mpsc::Sender<In>,
    places: Arc<Semaphore>,
    /// The places of requests whose answers were not read yet.
    unread: Arc<Mutex<HashMap<RequestId, OwnedSemaphorePermit>>>,
}

impl Client {
    fn new(caller: Caller, to_server: mpsc::Sender<In>) -> Self {
        Self {
            caller,
            to_server,
            places: Arc::new(Semaphore::new(UNREAD)),
            unread: Arc::default(),
        }
    }

    /// Hands a message on, as soon as there is room for it and its answer; false where
    /// the client is gone.
    async fn say(&self, message: In) -> bool {
        match &message {
            JsonRpcMessage::Request(request) => {
                let Ok(place) = self.places.clone().acquire_owned().await else {
                    return false;
                };
                lock(&self.unread).insert(request.id.clone(), place);
            }
            JsonRpcMessage::Notification(JsonRpcNotification {
                notification: ClientNotification::CancelledNotification(cancelled),
                ..
            }) => self.has_read(cancelled.params.request_id.as_ref()),
            _ => {}
        }
        self.to_server.send(message).await.is_ok()
    }

    /// Notes that the answer of a request goes out, or need not.
    fn has_read(&self, request: Option<&RequestId>) {
        if let Some(request) = request {
            lock(&self.unread).remove(request);
        }
    }
}

fn lock<T>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Connections {
    /// Opens a connection, one of at most so many in all and of one token, that `handler` serves as
    /// long as the client reads and its token holds; messages go to `post`.
    pub(crate) fn open(
        &self,
        handler: impl ServerHandler,
        id: String,
        post: &str,
        (limit, limit_each): (usize, usize),
        (caller, closing): (Caller, &CancellationToken),
    ) -> Response {
        let (to_server, from_client) = mpsc::channel(QUEUE);
        let (to_client, from_server) = mpsc::channel::<Out>(QUEUE);
        let gone = closing.child_token();
        let revoked = caller.revoked.clone();
        let client = Client::new(caller, to_server);
        {
            let mut open = lock(&self.0);
            if open.len() >= limit {
                let text = format!("{limit} streams are open, which is the limit");
                return (StatusCode::SERVICE_UNAVAILABLE, text).into_response();
            }
            let owner = &client.caller.owner;
            let own = open.values().filter(|other| other.caller.owner == *owner);
            if owner.name().is_some() && own.count() >= limit_each {
                let text = format!("your token has {limit_each} streams, as many as it may");
                return (StatusCode::TOO_MANY_REQUESTS, text).into_response();
            }
            open.insert(id.clone(), client.clone());
        }
        let transport = Connection {
            from_client,
            to_client: Some(to_client),
            gone: gone.clone(),
        };
        tokio::spawn(async move {
            match serve_server(handler, transport).await {
                Ok(running) => drop(running.waiting().await),
                Err(error) => tracing::debug!(%error, "a client left before its handshake"),
            }
        });
        let hello = Event::default()
            .event("endpoint")
            .data(format!("{post}?session_id={id}"));
        let open = Open {
            connections: self.clone(),
            id,
            client,
            _gone: gone.clone().drop_guard(),
        };
        let messages = ReceiverStream::new(from_server).map(move |message| {
            match &message {
                JsonRpcMessage::Response(answer) => open.client.has_read(Some(&answer.id)),
                JsonRpcMessage::Error(error) => open.client.has_read(error.id.as_ref()),
                _ => {}
            }
            let message = as_it_came::outgoing(message);
            let json = serde_json::to_string(&message).expect("a message of the protocol is JSON");
            Event::default().event("message").data(json)
        });
        let events = stream::once(async { hello })
            .chain(messages)
            .take_until(async move {
                tokio::select! {
                    () = gone.cancelled() => {}
                    () = revoked.cancelled() => {}
                }
            });
        Sse::new(events.map(Ok::<_, Infallible>))
            .keep_alive(KeepAlive::new().interval(KEEP_ALIVE).text("ping"))
            .into_response()
    }

    /// Takes a message that was posted.
    pub(crate) async fn message(&self, id: Option<&str>, body: &Bytes) -> Response {
        let Some(id) = id else {
            return (
                StatusCode::BAD_REQUEST,
                "session_id is required: post to the path that the event 'endpoint' named",
            )
                .into_response();
        };
        let client = lock(&self.0).get(id).cloned();
        let Some(client) = client.filter(|client| client.caller.lets_current()) else {
            return (StatusCode::NOT_FOUND, "no such session: open a new stream").into_response();
        };
        match serde_json::from_slice::<ClientJsonRpcMessage>(body) {
            Ok(message) => match tokio::time::timeout(PATIENCE, client.say(message)).await {
                Ok(true) => (StatusCode::ACCEPTED, "Accepted").into_response(),
                Ok(false) => (StatusCode::GONE, "the session is closed").into_response(),
                Err(_) => {
                    let text = "too many answers wait to be read in this session: read its stream, then post again";
                    (StatusCode::TOO_MANY_REQUESTS, text).into_response()
                }
            },
            Err(error) => (
                StatusCode::BAD_REQUEST,
                format!("no message of the protocol: {error}"),
            )
                .into_response(),
        }
    }
}

/// A connection as rmcp sees it.
struct Connection {
    from_client: mpsc::Receiver<In>,
    to_client: Option<mpsc::Sender<Out>>,
    gone: CancellationToken,
}

impl Transport<RoleServer> for Connection {
    type Error = io::Error;

    fn send(
        &mut self,
        message: Out,
    ) -> impl Future<Output = Result<(), io::Error>> + Send + 'static {
        let to_client = self.to_client.clone();
        async move {
            let gone = || io::Error::new(io::ErrorKind::BrokenPipe, "the client went away");
            to_client
                .ok_or_else(gone)?
                .send(message)
                .await
                .map_err(|_| gone())
        }
    }

    async fn receive(&mut self) -> Option<In> {
        tokio::select! {
            message = self.from_client.recv() => message,
            () = self.gone.cancelled() => None,
        }
    }

    async fn close(&mut self) -> Result<(), io::Error> {
        self.to_client = None;
        self.from_client.close();
        Ok(())
    }
}

/// Lives as long as the client reads its stream; then the connection is closed and forgotten.
struct Open {
    connections: Connections,
    id: String,
    client: Client,
    _gone: DropGuard,
}

impl Drop for Open {
    fn drop(&mut self) {
        lock(&self.connections.0).remove(&self.id);
        self.client.places.close();
    }
}
