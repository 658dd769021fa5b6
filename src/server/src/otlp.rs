//! Spans of instrumented agents, taken as a collector takes them: `POST /v1/traces` (OTLP over HTTP). A trace of theirs
//! that is complete becomes a trace in the archive. What a body has to be and when a trace is complete is
//! `reel_otlp`'s, what spans mean `reel_import::otel`'s.

use std::{
    fs, io,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use axum::{
    Router,
    body::Bytes,
    extract::State,
    http::{HeaderMap, HeaderName, StatusCode, header},
    response::{IntoResponse as _, Response},
    routing::post,
};
use reel_import::{ImportOptions, ImportedEpisode, otel};
use reel_otlp::{ExportTraceServiceRequest, HttpAnswer, PendingLimits, PendingTraces, receive};
use tokio::time::{Instant, sleep};

use crate::{archive::Archive, config::Config, service::App};

/// How often it is seen which traces are complete.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// How long an exporter waits that met no room, in seconds.
const RETRY_AFTER_S: &str = "5";
/// The run that the episodes belong to.
const RUN: &str = "otel";

/// Spans whose traces are not complete yet. They are in memory alone: a server that is killed loses them.
pub(crate) struct SpanIntake(Mutex<PendingTraces>);

impl Default for SpanIntake {
    fn default() -> Self {
        Self(Mutex::new(PendingTraces::new(PendingLimits::default())))
    }
}

impl SpanIntake {
    fn lock(&self) -> MutexGuard<'_, PendingTraces> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The route that exporters know.
pub(crate) fn router(app: &Arc<App>) -> Router {
    Router::new()
        .route("/v1/traces", post(take))
        .with_state(app.clone())
}

async fn take(State(app): State<Arc<App>>, headers: HeaderMap, body: Bytes) -> Response {
    let text = |name: HeaderName| headers.get(name)?.to_str().ok().map(str::to_owned);
    let (kind, encoding) = (text(header::CONTENT_TYPE), text(header::CONTENT_ENCODING));
    let received = receive(kind.as_deref(), encoding.as_deref(), body.to_vec());
    let answer = match received {
        Ok((format, request)) => {
            let now = Instant::now().into_std();
            app.spans.lock().add(format, request, now)
        }
        Err(refused) => refused,
    };
    response(answer)
}

fn response(answer: HttpAnswer) -> Response {
    let status = StatusCode::from_u16(answer.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
    let kind = [(header::CONTENT_TYPE, answer.format.media_type())];
    let mut response = (status, kind, answer.body).into_response();
    if status == StatusCode::SERVICE_UNAVAILABLE {
        let value = header::HeaderValue::from_static(RETRY_AFTER_S);
        response.headers_mut().insert(header::RETRY_AFTER, value);
    }
    response
}

/// Writes traces as they are complete, until the server closes.
pub(crate) async fn write_complete_traces(app: Arc<App>) {
    loop {
        tokio::select! {
            () = sleep(LOOK_EVERY) => {}
            () = app.closing.cancelled() => return,
        }
        let complete = app.spans.lock().complete(Instant::now().into_std());
        write(&app, complete).await;
    }
}

/// Writes what is still there, once no more requests come.
pub(crate) async fn write_all_traces(app: &Arc<App>) {
    let complete = app.spans.lock().take_all();
    write(app, complete).await;
}

async fn write(app: &Arc<App>, complete: Vec<(String, ExportTraceServiceRequest)>) {
    if complete.is_empty() {
        return;
    }
    let (archive, config) = (app.archive.clone(), app.config.clone());
    let writing = move || {
        let requests = complete.into_iter().map(|(_, request)| request).collect();
        write_episodes(&archive, &config, requests);
    };
    // Who sent them has been answered: what goes wrong is in the log.
    if let Err(error) = app.pool.setup().host.work.spawn(writing).await {
        tracing::error!(%error, "spans could not be written as traces");
    }
}

/// Never logs what the agents said: errors name numbers and places alone.
fn write_episodes(archive: &Archive, config: &Config, requests: Vec<ExportTraceServiceRequest>) {
    let staging = &config.data.join("otlp-incoming");
    let read = match otel::read_requests(Path::new("/v1/traces"), requests) {
        Ok(read) => read,
        Err(error) => {
            tracing::warn!(%error, "spans could not be read");
            return;
        }
    };
    if read.without_agent > 0 {
        tracing::debug!(
            traces = read.without_agent,
            "traces without an agent are left out"
        );
    }
    if let Err(error) = fs::create_dir_all(staging) {
        tracing::warn!(%error, "spans could not be written: the data folder takes no folder");
        return;
    }
    let options = ImportOptions {
        run_id: RUN,
        tasks: &[],
        scenes: None,
    };
    let (success, task) = (config.otlp_success.as_ref(), config.otlp_task.as_deref());
    for told in &read.episodes {
        match otel::import(told, staging, &options, success, task) {
            Ok(imported) => match placed(archive, &imported) {
                Ok(trace) => tracing::info!(
                    trace = %trace.display(),
                    steps = imported.steps,
                    losses = imported.losses.len(),
                    "spans became a trace"
                ),
                Err(error) => tracing::warn!(%error, "a trace of spans could not be placed"),
            },
            Err(error) => tracing::warn!(%error, "spans are no episode"),
        }
    }
}

/// Moves a trace into the archive under a name that clients may use. The same episode may be there already.
fn placed(archive: &Archive, imported: &ImportedEpisode) -> io::Result<PathBuf> {
    let stem = imported.trace.file_stem().unwrap_or_default();
    let stem = stem.to_string_lossy();
    let path = archive
        .path(&stem)
        .unwrap_or_else(|_| archive.folder().join(format!("otel-{stem}.mcap")));
    if path.exists() {
        fs::remove_file(&imported.trace)?;
    } else {
        fs::rename(&imported.trace, &path)?;
    }
    Ok(PathBuf::from(path.file_name().unwrap_or_default()))
}
