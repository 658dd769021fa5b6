//! The HTTP routes of the contract. HTTP has no session, so `episode_id` names it: a reset with one
//! (or with one that the server makes) begins an episode that steps with the same id go on with.

use std::sync::Arc;

use axum::{Json, extract::State};
use reel_live::check_name;
use reel_mcp::Caller;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use utoipa::{IntoParams, ToSchema};

use super::{
    environment::Environment,
    message::{ResetBody, action},
    observation, random_name,
    refusal::Refusal,
};
use crate::{
    rest::{ApiError, Body, ErrorBody, QueryParams},
    service::App,
};

/// Whether an environment can be had.
#[derive(Serialize, ToSchema)]
pub(crate) struct Healthy {
    /// Always `healthy`: a server that is not answers with an error, or not at all.
    status: &'static str,
}

/// What the environment is, for people.
#[derive(Serialize, ToSchema)]
pub(crate) struct EnvironmentMetadata {
    /// Name of the environment.
    name: &'static str,
    /// What an agent does in it.
    description: &'static str,
    /// Version of Reel that serves it.
    version: &'static str,
}

/// JSON schemas of what goes in and comes out.
#[derive(Serialize, ToSchema)]
pub(crate) struct EnvironmentSchemas {
    #[schema(value_type = Object)]
    action: Value,
    #[schema(value_type = Object)]
    observation: Value,
    #[schema(value_type = Object)]
    state: Value,
}

/// An observation with its reward.
#[derive(Serialize, ToSchema)]
pub(crate) struct Observed {
    /// What the agent observes (`/schema`).
    #[schema(value_type = Object)]
    observation: Value,
    /// The reward of the call under the server's preset; null at a reset, and for tokens without
    /// role `read`.
    reward: Option<f64>,
    /// Whether the episode is over.
    done: bool,
}

/// An action of an episode.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct StepBody {
    /// The call of a tool: `name` and `arguments`.
    #[schema(value_type = Object)]
    action: Value,
    /// The episode, by the id that `metadata.episode_id` of its first observation has.
    episode_id: Option<String>,
    /// Whether the observation holds the image.
    #[serde(default)]
    image: bool,
    /// Ignored: a call takes as long as `limits.worker_timeout_s` lets it wait.
    #[expect(dead_code, reason = "part of the contract")]
    timeout_s: Option<f64>,
    /// Ignored: for the client's own logs.
    #[expect(dead_code, reason = "part of the contract")]
    request_id: Option<String>,
}

/// Which episode is meant.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct EpisodeQuery {
    /// The episode, by its id; without it, an environment before its first reset.
    episode_id: Option<String>,
}

/// Tells whether environments can be had, for clients of OpenEnv.
#[utoipa::path(get, path = "/health", tag = "openenv", responses((status = 200, body = Healthy)))]
pub(crate) async fn health() -> Json<Healthy> {
    Json(Healthy { status: "healthy" })
}

/// What the environment is.
#[utoipa::path(get, path = "/metadata", operation_id = "openenv_metadata", tag = "openenv",
    responses((status = 200, body = EnvironmentMetadata)))]
pub(crate) async fn metadata() -> Json<EnvironmentMetadata> {
    Json(EnvironmentMetadata {
        name: "reel",
        description: "A home with a robot in it: tasks of moving objects between receptacles, by calls of tools.",
        version: env!("CARGO_PKG_VERSION"),
    })
}

/// JSON schemas of actions, observations and state.
#[utoipa::path(get, path = "/schema", operation_id = "openenv_schema", tag = "openenv",
    responses((status = 200, body = EnvironmentSchemas)))]
pub(crate) async fn schema(State(app): State<Arc<App>>) -> Json<Value> {
    Json(observation::schemas(app.pool.setup().profile))
}

/// Begins an episode. Its id in `metadata.episode_id` is what steps name it by.
#[utoipa::path(post, path = "/reset", operation_id = "openenv_reset", tag = "openenv", request_body = ResetBody,
    responses((status = 200, body = Observed), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 409, body = ErrorBody), (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(crate) async fn reset(
    State(app): State<Arc<App>>,
    Body(body): Body<ResetBody>,
) -> Result<Json<Value>, ApiError> {
    let body = body.merged()?;
    let id = body.episode_id.clone().unwrap_or_else(random_name);
    let name = session_name(&id);
    let mut environment = environment(&app, &id);
    let body = ResetBody {
        episode_id: Some(id),
        ..body
    };
    let known = existing(&app, body.episode_id.clone()).is_ok();
    let begun = environment.reset(body).await;
    if begun.is_err() && !known {
        // What never began needs no session.
        let _ = app.pool.close(&name).await;
    }
    Ok(Json(begun?))
}

/// Executes an action in an episode. With the last one its session is closed.
#[utoipa::path(post, path = "/step", operation_id = "openenv_step", tag = "openenv", request_body = StepBody,
    responses((status = 200, body = Observed), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 409, body = ErrorBody), (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(crate) async fn step(
    State(app): State<Arc<App>>,
    Body(body): Body<StepBody>,
) -> Result<Json<Value>, ApiError> {
    let action = action(body.action, "action")?;
    let id = existing(&app, body.episode_id)?.ok_or(reel_live::LiveError::NoEpisode);
    let id = id.map_err(Refusal::Live)?;
    let mut environment = environment(&app, &id);
    environment.set(Some(id.clone()), body.image);
    let observed = environment.step(action).await?;
    if observed["done"] == true {
        let closed = app.pool.close(&session_name(&id)).await;
        if let Err(error) = closed {
            tracing::warn!(%error, "the session of an ended episode could not be closed");
        }
    }
    Ok(Json(observed))
}

/// How an episode stands.
#[utoipa::path(get, path = "/state", operation_id = "openenv_state", tag = "openenv", params(EpisodeQuery),
    responses((status = 200, body = Object), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 503, body = ErrorBody)))]
pub(crate) async fn state(
    State(app): State<Arc<App>>,
    QueryParams(query): QueryParams<EpisodeQuery>,
) -> Result<Json<Value>, ApiError> {
    let Some(id) = existing(&app, query.episode_id)? else {
        let empty = json!({"episode_id": null, "step_count": 0, "status": "empty", "task_id": null, "trace": null});
        return Ok(Json(empty));
    };
    let mut environment = environment(&app, &id);
    environment.set(Some(id), false);
    Ok(Json(environment.state().await?))
}

fn environment(app: &Arc<App>, id: &str) -> Environment {
    let caller = Caller::current().unwrap_or_default();
    Environment::named(app.clone(), caller, session_name(id))
}

fn session_name(id: &str) -> String {
    format!("openenv-{id}")
}

/// The id, if there is an episode of it; `None` if there is no id.
fn existing(app: &App, id: Option<String>) -> Result<Option<String>, ApiError> {
    let Some(id) = id else {
        return Ok(None);
    };
    let name = session_name(&id);
    check_name(&name)?;
    match app.pool.entry(&name) {
        Ok(_) => Ok(Some(id)),
        Err(_) => Err(ApiError::not_found(format!(
            "unknown episode {id}: it ended, was closed, or never began"
        ))),
    }
}
