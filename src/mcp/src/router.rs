//! The ways in: Streamable HTTP, legacy HTTP+SSE, stdio.

use std::{sync::Arc, time::Duration};

use axum::{
    Router,
    body::Bytes,
    extract::{Path, Query, Request, State},
    http::StatusCode,
    middleware::{self, Next},
    response::{IntoResponse, Response},
    routing::{MethodRouter, any_service, get, post},
};
use reel_live::{SessionPool, check_name};
use rmcp::{
    ServerHandler, ServiceExt as _,
    transport::{StreamableHttpServerConfig, StreamableHttpService},
};
use serde::Deserialize;
use tokio_util::sync::CancellationToken;

use crate::{
    Caller, Questions, ToolServer, ToolServerOptions, legacy_sse::Connections, methods::explain,
    sessions::Sessions,
};

/// A worker: whoever connects under its name acts in the same session.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Worker(String);

impl Worker {
    /// A worker by its name in the path `/w/<name>/`.
    ///
    /// # Errors
    /// When the name could not be one of a file.
    pub fn named(name: &str) -> Result<Self, reel_live::LiveError> {
        let worker = Self(name.to_owned());
        check_name(name)?;
        check_name(&worker.session_name()).map(|()| worker)
    }

    /// Name of its session: no name of a session that a connection has for its own.
    pub fn session_name(&self) -> String {
        format!("w-{}", self.0)
    }
}

/// Where clients of `/sse` post.
const MESSAGES: &str = "/messages/";

/// What all transports share.
#[derive(Clone)]
struct Shared {
    pool: Arc<SessionPool>,
    questions: Arc<Questions>,
    options: Arc<ToolServerOptions>,
    connections: Connections,
    closing: CancellationToken,
}

/// `/mcp`, `/w/<name>/mcp`, `/sse`, `/w/<name>/sse` and `/messages/`. Host, Origin, tokens and
/// sizes of bodies are the caller's to check; every stream ends with `closing`.
pub fn router(
    pool: Arc<SessionPool>,
    questions: Arc<Questions>,
    options: Arc<ToolServerOptions>,
    closing: CancellationToken,
    max_body: usize,
) -> Router {
    let shared = Shared {
        pool,
        questions,
        options,
        connections: Connections::default(),
        closing: closing.clone(),
    };
    let limits = shared.pool.limits();
    let sessions = Sessions::new(limits.sessions, limits.sessions_each, limits.close_after);
    let factory = |server: fn(&Shared) -> ToolServer| {
        let shared = shared.clone();
        move || server(&shared)
    };
    let service = serve(
        sessions.clone(),
        factory(Shared::server),
        max_body,
        closing.clone(),
    );
    let of_workers = serve(sessions, factory(Shared::workers), max_body, closing);
    let workers = Router::new()
        .route_service("/w/{worker}/mcp", of_workers)
        .layer(middleware::from_fn(name_worker));
    Router::new()
        .route("/sse", get(open))
        .route("/w/{worker}/sse", get(open_worker))
        .route(MESSAGES, post(message))
        .with_state(shared)
        .route_service("/mcp", service)
        .merge(workers)
}

/// What bounds the transports of a server, and what ends them.
#[derive(Clone, Debug)]
pub struct Transports {
    /// How many sessions, and how many streams of `/sse`, may be open at a time.
    pub sessions: usize,
    /// A session ends when nothing came or went for so long.
    pub keep_alive: Duration,
    /// Most bytes of a message.
    pub max_body: usize,
    /// Ends every stream when it is cancelled.
    pub closing: CancellationToken,
}

/// `/mcp`, `/sse` and `/messages/` of another server than that of live episodes: `factory` makes
/// the service of each session. Host and Origin are the caller's to check.
pub fn router_of<S: ServerHandler>(
    factory: impl Fn() -> S + Clone + Send + Sync + 'static,
    transports: &Transports,
) -> Router {
    let (limit, closing) = (transports.sessions, transports.closing.clone());
    let connections = Connections::default();
    let (posted_to, opened) = (connections.clone(), factory.clone());
    let stream = {
        let closing = closing.clone();
        move || async move {
            let caller = Caller::current().unwrap_or_default();
            let limits = (limit, limit);
            connections.open(opened(), random(), MESSAGES, limits, (caller, &closing))
        }
    };
    let posted = move |Query(session): Query<Session>, body: Bytes| async move {
        let id = session.session_id.as_deref();
        posted_to.message(id, &body).await
    };
    let sessions = Sessions::new(limit, limit, transports.keep_alive);
    Router::new()
        .route("/sse", get(stream))
        .route(MESSAGES, post(posted))
        .route_service(
            "/mcp",
            serve(sessions, factory, transports.max_body, closing),
        )
}

/// The service of Streamable HTTP, with a handler from `factory` for each of so many sessions in
/// all and of one token; who wants one more is told so with 503 or 429. A session ends when nothing
/// came or went for `keep_alive`, or sooner while it calls no tool; every stream with `closing`.
/// [`Guard`](crate::Guard) is what keeps pages of the web from it.
pub fn streamable_http<S: ServerHandler>(
    factory: impl Fn() -> S + Send + Sync + 'static,
    (sessions, each): (usize, usize),
    keep_alive: Duration,
    max_body: usize,
    closing: CancellationToken,
) -> MethodRouter {
    serve(
        Sessions::new(sessions, each, keep_alive),
        factory,
        max_body,
        closing,
    )
}

/// [`streamable_http`] for these sessions.
pub(crate) fn serve<S: ServerHandler>(
    sessions: Arc<Sessions>,
    factory: impl Fn() -> S + Send + Sync + 'static,
    max_body: usize,
    closing: CancellationToken,
) -> MethodRouter {
    let http = StreamableHttpServerConfig::default()
        .disable_allowed_hosts()
        .with_max_request_body_bytes(max_body)
        .with_cancellation_token(closing);
    any_service(StreamableHttpService::new(
        move || Ok(factory()),
        sessions,
        http,
    ))
    .layer(middleware::from_fn(Sessions::set_status))
    .layer(middleware::from_fn_with_state(max_body, explain))
}

/// Serves one agent over standard input and output, until it goes.
///
/// # Errors
/// When the first message is not one of the protocol.
pub async fn stdio(
    pool: Arc<SessionPool>,
    options: ToolServerOptions,
) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
    let server = ToolServer::new(pool, Arc::default(), Arc::new(options), "stdio".to_owned());
    server
        .serve(rmcp::transport::stdio())
        .await?
        .waiting()
        .await?;
    Ok(())
}

impl Shared {
    fn server(&self) -> ToolServer {
        ToolServer::new(
            self.pool.clone(),
            self.questions.clone(),
            self.options.clone(),
            format!("s-{}", random()),
        )
    }

    /// For whoever the path of a request names.
    fn workers(&self) -> ToolServer {
        ToolServer::of_workers(
            self.pool.clone(),
            self.questions.clone(),
            self.options.clone(),
        )
    }

    fn stream(&self, server: ToolServer) -> Response {
        let caller = Caller::current().unwrap_or_default();
        let limits = self.pool.limits();
        let limits = (limits.sessions, limits.sessions_each);
        self.connections.open(
            server.of_owner(caller.owner.clone()),
            random(),
            MESSAGES,
            limits,
            (caller, &self.closing),
        )
    }
}

/// Says to the handler whose session a request is for.
async fn name_worker(Path(worker): Path<String>, mut request: Request, next: Next) -> Response {
    match Worker::named(&worker) {
        Ok(worker) => {
            request.extensions_mut().insert(worker);
            next.run(request).await
        }
        Err(error) => (StatusCode::BAD_REQUEST, error.to_string()).into_response(),
    }
}

async fn open(State(shared): State<Shared>) -> Response {
    shared.stream(shared.server())
}

async fn open_worker(State(shared): State<Shared>, Path(worker): Path<String>) -> Response {
    match Worker::named(&worker) {
        Ok(worker) => {
            let Shared {
                pool,
                questions,
                options,
                ..
            } = shared.clone();
            let server = ToolServer::of_worker(pool, questions, options, worker);
            shared.stream(server)
        }
        Err(error) => (StatusCode::BAD_REQUEST, error.to_string()).into_response(),
    }
}

#[derive(Deserialize)]
struct Session {
    #[serde(alias = "sessionId")]
    session_id: Option<String>,
}

async fn message(
    State(shared): State<Shared>,
    Query(session): Query<Session>,
    body: Bytes,
) -> Response {
    shared
        .connections
        .message(session.session_id.as_deref(), &body)
        .await
}

/// 128 bits that nobody can guess.
fn random() -> String {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).expect("the system has randomness");
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
