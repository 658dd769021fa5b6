//! The transport of 2024: `GET /sse` opens a stream of server-sent events and names the path to post messages to.
//! rmcp serves only its successor; REAL's agents and its trainer speak this one.

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
    model::ClientJsonRpcMessage,
    serve_server,
    service::{RxJsonRpcMessage, TxJsonRpcMessage},
    transport::Transport,
};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tokio_util::sync::{CancellationToken, DropGuard};

/// Messages that may wait in each direction of one connection.
const QUEUE: usize = 64;
const KEEP_ALIVE: Duration = Duration::from_secs(15);

type In = RxJsonRpcMessage<RoleServer>;
type Out = TxJsonRpcMessage<RoleServer>;

/// The open connections, by the id that a client was told.
#[derive(Clone, Default)]
pub(crate) struct Connections(Arc<Mutex<HashMap<String, mpsc::Sender<In>>>>);

impl Connections {
    fn lock(&self) -> MutexGuard<'_, HashMap<String, mpsc::Sender<In>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Opens a connection, one of at most `limit`, that `handler` serves as long as the client reads; messages go to `post`.
    pub(crate) fn open(
        &self,
        handler: impl ServerHandler,
        id: String,
        post: &str,
        limit: usize,
        closing: &CancellationToken,
    ) -> Response {
        let (to_server, from_client) = mpsc::channel(QUEUE);
        let (to_client, from_server) = mpsc::channel::<Out>(QUEUE);
        let gone = closing.child_token();
        {
            let mut open = self.lock();
            if open.len() >= limit {
                let text = format!("{limit} streams are open, which is the limit");
                return (StatusCode::SERVICE_UNAVAILABLE, text).into_response();
            }
            open.insert(id.clone(), to_server);
        }
        let transport = Connection { from_client, to_client: Some(to_client), gone: gone.clone() };
        tokio::spawn(async move {
            match serve_server(handler, transport).await {
                Ok(running) => drop(running.waiting().await),
                Err(error) => tracing::debug!(%error, "a client went before it said who it is"),
            }
        });
        let hello = Event::default().event("endpoint").data(format!("{post}?session_id={id}"));
        let open = Open { connections: self.clone(), id, _gone: gone.clone().drop_guard() };
        let messages = ReceiverStream::new(from_server).map(move |message| {
            let _open = &open;
            let json = serde_json::to_string(&message).expect("a message of the protocol is JSON");
            Event::default().event("message").data(json)
        });
        let events = stream::once(async { hello }).chain(messages).take_until(gone.cancelled_owned());
        Sse::new(events.map(Ok::<_, Infallible>)).keep_alive(KeepAlive::new().interval(KEEP_ALIVE).text("ping")).into_response()
    }

    /// Takes a message that was posted.
    pub(crate) async fn message(&self, id: Option<&str>, body: &Bytes) -> Response {
        let Some(id) = id else {
            return (StatusCode::BAD_REQUEST, "session_id is required: post to the path that the event 'endpoint' named")
                .into_response();
        };
        let Some(to_server) = self.lock().get(id).cloned() else {
            return (StatusCode::NOT_FOUND, "no such session: open a new stream").into_response();
        };
        match serde_json::from_slice::<ClientJsonRpcMessage>(body) {
            Ok(message) => match to_server.send_timeout(message, KEEP_ALIVE).await {
                Ok(()) => (StatusCode::ACCEPTED, "Accepted").into_response(),
                Err(mpsc::error::SendTimeoutError::Timeout(_)) => {
                    (StatusCode::TOO_MANY_REQUESTS, "too many messages wait in this session").into_response()
                }
                Err(mpsc::error::SendTimeoutError::Closed(_)) => (StatusCode::GONE, "the session is closed").into_response(),
            },
            Err(error) => (StatusCode::BAD_REQUEST, format!("no message of the protocol: {error}")).into_response(),
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

    fn send(&mut self, message: Out) -> impl Future<Output = Result<(), io::Error>> + Send + 'static {
        let to_client = self.to_client.clone();
        async move {
            let gone = || io::Error::new(io::ErrorKind::BrokenPipe, "the client went away");
            to_client.ok_or_else(gone)?.send(message).await.map_err(|_| gone())
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
    _gone: DropGuard,
}

impl Drop for Open {
    fn drop(&mut self) {
        self.connections.lock().remove(&self.id);
    }
}
