//! Long work: started, watched, stopped.

use std::{convert::Infallible, sync::Arc, time::Duration};

use axum::{
    Json,
    extract::State,
    http::StatusCode,
    response::sse::{Event, KeepAlive, Sse},
};
use futures_util::{Stream, StreamExt as _, stream};
use tokio_stream::wrappers::WatchStream;

use super::{
    ApiError,
    error::ErrorBody,
    extract::{Body, PathParams},
};
use crate::{
    jobs::{Job, Work},
    service::App,
};

/// How often a watched job is told of at most.
const TELL_EVERY: Duration = Duration::from_millis(200);

/// Every job, the newest first.
#[utoipa::path(get, path = "/api/jobs", operation_id = "list_jobs", tag = "jobs",
    responses((status = 200, body = Vec<Job>)))]
pub(super) async fn list(State(app): State<Arc<App>>) -> Json<Vec<Job>> {
    Json(app.jobs.list())
}

/// Starts a job; one is at work at a time, the others wait.
#[utoipa::path(post, path = "/api/jobs", tag = "jobs", request_body = Work,
    responses((status = 202, body = Job), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 409, body = ErrorBody), (status = 422, body = ErrorBody)))]
pub(super) async fn start(
    State(app): State<Arc<App>>,
    Body(work): Body<Work>,
) -> Result<(StatusCode, Json<Job>), ApiError> {
    Ok((StatusCode::ACCEPTED, Json(app.jobs.start(work)?)))
}

/// One job with its state, its progress and its report.
#[utoipa::path(get, path = "/api/jobs/{id}", operation_id = "show_job", tag = "jobs",
    params(("id" = u64, Path)),
    responses((status = 200, body = Job), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody)))]
pub(super) async fn show(
    State(app): State<Arc<App>>,
    PathParams(id): PathParams<u64>,
) -> Result<Json<Job>, ApiError> {
    Ok(Json(app.jobs.watch(id)?.borrow().clone()))
}

/// Stops a job. What it had done stays, and the same job goes on from there.
#[utoipa::path(delete, path = "/api/jobs/{id}", tag = "jobs", params(("id" = u64, Path)),
    responses((status = 202), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 409, body = ErrorBody)))]
pub(super) async fn cancel(
    State(app): State<Arc<App>>,
    PathParams(id): PathParams<u64>,
) -> Result<StatusCode, ApiError> {
    app.jobs.cancel(id).map(|()| StatusCode::ACCEPTED)
}

/// A job while it goes on, as server-sent events of type `job`; ends with the job.
#[utoipa::path(get, path = "/api/jobs/{id}/events", tag = "jobs", params(("id" = u64, Path)),
    responses((status = 200, description = "Events whose data is a job, as JSON", content_type = "text/event-stream"),
        (status = 400, body = ErrorBody), (status = 404, body = ErrorBody)))]
pub(super) async fn events(
    State(app): State<Arc<App>>,
    PathParams(id): PathParams<u64>,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, ApiError> {
    let watched = WatchStream::new(app.jobs.watch(id)?);
    let closing = app.closing.clone();
    let until_it_ends = stream::unfold((watched, false), |(mut watched, ended)| async move {
        if ended {
            return None;
        }
        let job = watched.next().await?;
        if !job.ended() {
            tokio::time::sleep(TELL_EVERY).await;
        }
        let event = Event::default()
            .event("job")
            .json_data(&job)
            .expect("a job is JSON");
        Some((Ok(event), (watched, job.ended())))
    });
    let events = until_it_ends.take_until(async move { closing.cancelled().await });
    Ok(Sse::new(events).keep_alive(KeepAlive::default()))
}
