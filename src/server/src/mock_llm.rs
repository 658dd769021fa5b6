//! `reel agent mock-llm`: a script on the protocol of OpenAI-compatible endpoints, with trouble on
//! the way where it is asked for.

use std::{io, net::SocketAddr, sync::Arc, time::Duration};

use axum::{
    Json, Router,
    body::{Body, Bytes},
    extract::State,
    http::{StatusCode, header},
    response::{IntoResponse, Response},
    routing::{get, post},
};
use futures_util::stream;
use reel_llm::agent::script::{InjectedError, Script};
use serde_json::{Value, json};
use tokio::{net::TcpListener, time::sleep};

use crate::{
    ServeError,
    run::{runtime, stopped},
};

/// How the stand-in behaves.
#[derive(Clone, Copy, Debug)]
pub struct MockOptions {
    /// How long every answer takes.
    pub delay: Duration,
    /// How long an answer takes that stalls.
    pub stall: Duration,
    /// What `Retry-After` says, in seconds.
    pub retry_after_s: u64,
}

struct Mock {
    script: Script,
    options: MockOptions,
}

/// Serves a script until Ctrl-C. `on_listening` is told the address.
///
/// # Errors
/// When the address cannot be listened on.
pub fn mock_llm(
    listen: SocketAddr,
    script: Script,
    options: MockOptions,
    on_listening: impl FnOnce(SocketAddr),
) -> Result<(), ServeError> {
    let mock = Arc::new(Mock { script, options });
    let app = Router::new()
        .route("/v1/chat/completions", post(complete))
        .route("/v1/embeddings", post(embed))
        .route(
            "/v1/models",
            get(|| async {
                Json(json!({"object": "list", "data": [{"id": "mock", "object": "model"}]}))
            }),
        )
        .layer(axum::extract::DefaultBodyLimit::max(64 << 20))
        .with_state(mock);
    let runtime = runtime(None)?;
    let served = runtime.block_on(async {
        let listener = TcpListener::bind(listen)
            .await
            .map_err(|source| ServeError::Listen {
                address: listen,
                source,
            })?;
        on_listening(listener.local_addr().map_err(ServeError::System)?);
        axum::serve(listener, app)
            .with_graceful_shutdown(stopped())
            .await
            .map_err(ServeError::System)
    });
    runtime.shutdown_background();
    served
}

async fn complete(State(mock): State<Arc<Mock>>, body: Bytes) -> Response {
    let said = match read(&body).and_then(|request| mock.script.answer(&request)) {
        Ok(said) => said,
        Err(what) => return refused(StatusCode::BAD_REQUEST, &what),
    };
    sleep(mock.options.delay).await;
    match said.trouble {
        Some(InjectedError::RateLimit) => {
            let wait = [(header::RETRY_AFTER, mock.options.retry_after_s.to_string())];
            (wait, refused(StatusCode::TOO_MANY_REQUESTS, "slow down")).into_response()
        }
        Some(InjectedError::Error) => refused(StatusCode::INTERNAL_SERVER_ERROR, "something broke"),
        Some(InjectedError::Cut) => cut(&said.body),
        Some(InjectedError::Stall) => {
            sleep(mock.options.stall).await;
            Json(said.body).into_response()
        }
        _ => Json(said.body).into_response(),
    }
}

async fn embed(State(mock): State<Arc<Mock>>, body: Bytes) -> Response {
    match read(&body).and_then(|request| mock.script.embed(&request)) {
        Ok(vectors) => Json(vectors).into_response(),
        Err(what) => refused(StatusCode::BAD_REQUEST, &what),
    }
}

fn read(body: &[u8]) -> Result<Value, String> {
    serde_json::from_slice(body).map_err(|error| format!("the request is not JSON: {error}"))
}

fn refused(status: StatusCode, what: &str) -> Response {
    (
        status,
        Json(json!({"error": {"message": what, "type": "invalid_request_error"}})),
    )
        .into_response()
}

/// Half of an answer whose whole length was promised; then the connection breaks off.
fn cut(body: &Value) -> Response {
    let text = body.to_string();
    let half = Bytes::copy_from_slice(&text.as_bytes()[..text.len() / 2]);
    let broken = [
        Ok(half),
        Err(io::Error::from(io::ErrorKind::ConnectionReset)),
    ];
    let kind = [
        (header::CONTENT_TYPE, "application/json".to_owned()),
        (header::CONTENT_LENGTH, text.len().to_string()),
    ];
    (kind, Body::from_stream(stream::iter(broken))).into_response()
}
