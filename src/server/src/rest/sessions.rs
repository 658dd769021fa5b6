//! Live sessions: who plays, prompt groups, and questions that wait for a person.

use std::sync::Arc;

use axum::{
    Json,
    extract::State,
    http::{StatusCode, header},
    response::{IntoResponse as _, Response},
};
use reel_live::{Lease, LiveError, SessionEntry, check_name};
use reel_mcp::{SessionCalls, Worker};
use reel_trace::encode_png_fastest;
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use utoipa::ToSchema;

use super::{
    ApiError,
    error::ErrorBody,
    extract::{Body, PathParams},
};
use crate::{Role, gate, service::App};

/// Live sessions, by name.
#[utoipa::path(get, path = "/api/sessions", operation_id = "list_sessions", tag = "sessions",
    responses((status = 200, body = ref("#/components/schemas/Sessions"))))]
pub(super) async fn list(State(app): State<Arc<App>>) -> Json<Vec<Value>> {
    Json(
        app.pool
            .entries()
            .iter()
            .map(|entry| shown(&app, entry))
            .collect(),
    )
}

/// State of one live session, by the session's name.
#[utoipa::path(get, path = "/api/sessions/{session}", operation_id = "show_session", tag = "sessions",
    params(("session" = String, Path)),
    responses((status = 200, body = ref("#/components/schemas/Session")), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody)))]
pub(super) async fn show(
    State(app): State<Arc<App>>,
    PathParams(session): PathParams<String>,
) -> Result<Json<Value>, ApiError> {
    Ok(Json(shown(&app, &app.pool.entry(&session)?)))
}

/// What the head of a session's robot sees now, as PNG. Looking counts as no use of the session.
#[utoipa::path(get, path = "/api/sessions/{session}/frame", operation_id = "session_frame", tag = "sessions",
    params(("session" = String, Path)),
    responses((status = 200, content_type = "image/png"), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 409, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn frame(
    State(app): State<Arc<App>>,
    PathParams(session): PathParams<String>,
) -> Result<Response, ApiError> {
    let frame = app.pool.render_frame(&session).await?;
    let png = encode_png_fastest(&frame.rgb, FRAME_WIDTH as u32, FRAME_HEIGHT as u32);
    Ok((
        [
            (header::CONTENT_TYPE, "image/png"),
            (header::CACHE_CONTROL, "no-store"),
        ],
        png,
    )
        .into_response())
}

/// What the agent of a session called so far in its episode, what it was told, and what its robot has
/// before it. Looking counts as no use of the session.
#[utoipa::path(get, path = "/api/sessions/{session}/calls", operation_id = "session_calls", tag = "sessions",
    params(("session" = String, Path)),
    responses((status = 200, body = ref("#/components/schemas/SessionCalls")), (status = 400, body = ErrorBody),
        (status = 404, body = ErrorBody), (status = 409, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn calls(
    State(app): State<Arc<App>>,
    PathParams(session): PathParams<String>,
) -> Result<Json<Value>, ApiError> {
    let situation = app.pool.situation(&session).await?;
    Ok(Json(json!(SessionCalls::from(&situation))))
}

/// Closes a session: its episode ends as aborted, and its trace is whole.
#[utoipa::path(delete, path = "/api/sessions/{session}", tag = "sessions",
    params(("session" = String, Path)),
    responses((status = 204), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody)))]
pub(super) async fn close(
    State(app): State<Arc<App>>,
    PathParams(session): PathParams<String>,
) -> Result<StatusCode, ApiError> {
    app.questions.withdraw(&session);
    app.pool.close(&session).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Questions of policies that wait for a person (`play.ask = "rest"`).
#[utoipa::path(get, path = "/api/questions", tag = "sessions",
    responses((status = 200, body = ref("#/components/schemas/Questions"))))]
pub(super) async fn questions(State(app): State<Arc<App>>) -> Json<Value> {
    Json(json!(app.questions.pending()))
}

/// The open question of a session with all that whoever answers has to know: what the user wants, and
/// what the robot was told, decided and thought so far. Holds the goal, which no policy may see.
#[utoipa::path(get, path = "/api/sessions/{session}/question", operation_id = "open_question", tag = "sessions",
    params(("session" = String, Path)),
    responses((status = 200, body = ref("#/components/schemas/OpenQuestion")), (status = 400, body = ErrorBody),
        (status = 404, body = ErrorBody)))]
pub(super) async fn question(
    State(app): State<Arc<App>>,
    PathParams(session): PathParams<String>,
) -> Result<Json<Value>, ApiError> {
    match app.questions.open(&session) {
        Some(open) => Ok(Json(json!(open))),
        None => Err(no_question(&session)),
    }
}

fn no_question(session: &str) -> ApiError {
    ApiError::not_found(format!("session {session} has no open question"))
}

/// A person's answer to the open question of a session.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Answer {
    /// In plain words; it is persisted as a person's.
    answer: String,
}

/// Answers the question of a session.
#[utoipa::path(post, path = "/api/sessions/{session}/answer", tag = "sessions",
    params(("session" = String, Path)), request_body = Answer,
    responses((status = 204), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 422, body = ErrorBody)))]
pub(super) async fn answer(
    State(app): State<Arc<App>>,
    PathParams(session): PathParams<String>,
    Body(Answer { answer }): Body<Answer>,
) -> Result<StatusCode, ApiError> {
    if app.questions.answer(&session, &answer) {
        Ok(StatusCode::NO_CONTENT)
    } else {
        Err(no_question(&session))
    }
}

/// Request for a simulator to play one prompt group.
#[derive(Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct LeaseBody {
    /// Name of the worker whose simulator it gets.
    #[schema(pattern = "^[A-Za-z0-9][A-Za-z0-9_.-]{0,61}$")]
    worker: String,
    /// The task of all rollouts.
    task_id: String,
    /// The seed of all rollouts.
    #[serde(default)]
    #[schema(format = "uint64")]
    seed: u64,
    /// G: how many rollouts there will be.
    #[schema(minimum = 1, format = "uint32")]
    rollouts: u32,
    /// Name of the group in the traces; without it, one made of the rest.
    group_id: Option<String>,
}

/// A simulator for a prompt group.
#[derive(Serialize, ToSchema)]
pub(super) struct Leased {
    /// The group, as the traces will name it.
    group_id: String,
    /// Where to play: Streamable HTTP.
    mcp: String,
    /// Where to play: HTTP+SSE.
    sse: String,
}

/// Leases a simulator to a prompt group: every `finish` begins the next rollout, with
/// equal task and seed.
#[utoipa::path(post, path = "/api/leases", tag = "sessions", request_body = LeaseBody,
    responses((status = 201, body = Leased), (status = 400, body = ErrorBody), (status = 409, body = ErrorBody),
        (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn lease(
    State(app): State<Arc<App>>,
    Body(body): Body<LeaseBody>,
) -> Result<(StatusCode, Json<Leased>), ApiError> {
    if body.rollouts == 0 {
        return Err(ApiError::unprocessable(
            "bad_body",
            "rollouts: at least 1".to_owned(),
        ));
    }
    // Its name goes into an address, too.
    check_name(&body.worker)?;
    let worker = Worker::named(&body.worker)?;
    let made = || {
        format!(
            "{}--{}--{}--{}",
            app.pool.setup().run_id,
            body.worker,
            body.task_id,
            body.seed
        )
    };
    let group_id = body.group_id.clone().unwrap_or_else(made);
    let LeaseBody {
        task_id,
        seed,
        rollouts,
        ..
    } = body;
    let lease = Lease {
        group_id: group_id.clone(),
        task_id,
        seed,
        rollouts,
    };
    let owner = gate::owner();
    app.pool
        .open_for(&worker.session_name(), &owner, Some(lease))?;
    let leased = Leased {
        group_id,
        mcp: format!("/w/{}/mcp", body.worker),
        sse: format!("/w/{}/sse", body.worker),
    };
    Ok((StatusCode::CREATED, Json(leased)))
}

/// Gives a simulator back: what runs in it ends as aborted. A lease is its token's; an admin ends
/// any.
#[utoipa::path(delete, path = "/api/leases/{worker}", tag = "sessions",
    params(("worker" = String, Path)),
    responses((status = 204), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody)))]
pub(super) async fn release(
    State(app): State<Arc<App>>,
    PathParams(worker): PathParams<String>,
) -> Result<StatusCode, ApiError> {
    let session = Worker::named(&worker)?.session_name();
    let entry = app.pool.entry(&session)?;
    if entry.group_id.is_none() {
        return Err(ApiError::not_found(format!("worker {worker} has no lease")));
    }
    let caller = gate::owner();
    let own = entry.owner.is_none() || entry.owner.as_deref() == caller.name();
    if !own && !app.tokens.has_role(&caller, Role::Admin) {
        return Err(LiveError::OtherOwner(session).into());
    }
    app.questions.withdraw(&session);
    app.pool.close(&session).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// A session without paths of this machine.
fn shown(app: &App, entry: &SessionEntry) -> Value {
    let mut value = json!(entry);
    value["trace"] = json!(
        entry
            .state
            .trace
            .as_ref()
            .and_then(|path| app.archive.name_of(path))
    );
    let task = entry.state.task_id.as_deref();
    let task = task.and_then(|id| app.pool.setup().task(id));
    value["instruction"] = json!(task.map(|task| &task.instruction));
    value
}
