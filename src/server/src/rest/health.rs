//! Whether it lives, whether it takes calls, and what it counts.

use std::{
    io::{self, Write as _},
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use axum::{Json, extract::State, http::header, response::IntoResponse};
use serde::Serialize;
use tokio::time::Instant;
use utoipa::ToSchema;

use super::{ApiError, error::ErrorBody};
use crate::service::App;

/// Bytes that there has to be room for: a recording grows by its start at once.
const ROOM: usize = 1 << 20;
/// How long it is believed that there is room.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// What a living server says.
#[derive(Serialize, ToSchema)]
pub(super) struct Health {
    /// Always `ok`: a server that is not ready answers with an error.
    status: &'static str,
    /// Version of Reel that this server runs.
    version: &'static str,
}

/// Tells whether the server process is alive.
#[utoipa::path(get, path = "/healthz", tag = "service", responses((status = 200, body = Health)))]
pub(super) async fn healthz() -> Json<Health> {
    Json(Health {
        status: "ok",
        version: env!("CARGO_PKG_VERSION"),
    })
}

/// Whether it takes calls, and can record them: the folder of traces has to have room.
#[utoipa::path(get, path = "/readyz", tag = "service",
    responses((status = 200, body = Health), (status = 503, body = ErrorBody)))]
pub(super) async fn readyz(State(app): State<Arc<App>>) -> Result<Json<Health>, ApiError> {
    if !app.ready.load(Ordering::Acquire) {
        return Err(ApiError::busy("the server is shutting down"));
    }
    // One look at a time, and one a second: anybody may ask.
    let mut looked = app.room.lock().await;
    if looked.is_some_and(|at| at.elapsed() < LOOK_EVERY) {
        return Ok(healthz().await);
    }
    let folder = app.archive.folder().to_owned();
    // The file has no name, and is gone when it is closed.
    let tried = app
        .pool
        .setup()
        .host
        .work
        .spawn(move || tempfile::tempfile_in(folder)?.write_all(&vec![0; ROOM]));
    match tried.await.map_err(io::Error::other).flatten() {
        Ok(()) => {
            *looked = Some(Instant::now());
            Ok(healthz().await)
        }
        Err(error) => Err(ApiError::records_nothing(&error)),
    }
}

/// Counts and times, as Prometheus reads them.
#[utoipa::path(get, path = "/metrics", tag = "service",
    responses((status = 200, body = String, content_type = "application/openmetrics-text")))]
pub(super) async fn metrics(State(app): State<Arc<App>>) -> impl IntoResponse {
    let text = app.metrics.text(&app.pool.entries());
    (
        [(
            header::CONTENT_TYPE,
            "application/openmetrics-text; version=1.0.0; charset=utf-8",
        )],
        text,
    )
}
