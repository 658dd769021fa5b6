//! The REST service: what people, pages and trainers ask, and what they get. Documented where it is written; the document is
//! at `/api/openapi.json`.

mod error;
mod extract;
mod health;
mod jobs;
mod labels;
mod sessions;
mod sql;
mod tables;
mod traces;

use std::{any::Any, sync::Arc};

use axum::{
    Json, Router,
    extract::State,
    response::{IntoResponse, Response},
    routing::get,
};
use utoipa::{
    Modify, OpenApi,
    openapi::security::{Http, HttpAuthScheme, SecurityScheme},
};
use utoipa_axum::{router::OpenApiRouter, routes};

pub(crate) use error::ApiError;
pub(crate) use tables::rows;

use crate::service::App;

/// Reel's REST service.
#[derive(OpenApi)]
#[openapi(
    info(title = "Reel", description = "Episodes of embodied agents: traces, replay, blame, tables, jobs, live sessions."),
    tags(
        (name = "traces", description = "Recorded episodes: files, steps, pictures, replay, branches, blame, rewards"),
        (name = "tables", description = "Episodes in the tables, SQL, named queries, labels"),
        (name = "jobs", description = "Long work: ingest, exports, replays"),
        (name = "sessions", description = "Live sessions of policies, prompt groups, questions to people"),
        (name = "service", description = "Health and metrics"),
    ),
    modifiers(&Security),
)]
struct Document;

struct Security;

impl Modify for Security {
    fn modify(&self, openapi: &mut utoipa::openapi::OpenApi) {
        let scheme = SecurityScheme::Http(Http::new(HttpAuthScheme::Bearer));
        openapi.components.get_or_insert_default().add_security_scheme("token", scheme);
    }
}

fn documented() -> OpenApiRouter<Arc<App>> {
    OpenApiRouter::with_openapi(Document::openapi())
        .routes(routes!(health::healthz))
        .routes(routes!(health::readyz))
        .routes(routes!(health::metrics))
        .routes(routes!(traces::list))
        .routes(routes!(traces::upload, traces::download, traces::delete))
        .routes(routes!(traces::episode))
        .routes(routes!(traces::steps))
        .routes(routes!(traces::frame))
        .routes(routes!(traces::replay))
        .routes(routes!(traces::branch))
        .routes(routes!(traces::blame))
        .routes(routes!(traces::reward))
        .routes(routes!(tables::episodes))
        .routes(routes!(tables::episode))
        .routes(routes!(sql::ask))
        .routes(routes!(sql::named))
        .routes(routes!(sql::ask_named))
        .routes(routes!(labels::list, labels::set))
        .routes(routes!(jobs::list, jobs::start))
        .routes(routes!(jobs::show, jobs::cancel))
        .routes(routes!(jobs::events))
        .routes(routes!(sessions::list))
        .routes(routes!(sessions::show, sessions::close))
        .routes(routes!(sessions::questions))
        .routes(routes!(sessions::answer))
        .routes(routes!(sessions::lease))
        .routes(routes!(sessions::release))
}

/// The OpenAPI document.
pub fn openapi() -> utoipa::openapi::OpenApi {
    documented().into_openapi()
}

/// Every route of the service.
pub(crate) fn router(app: &Arc<App>) -> Router {
    let (router, document) = documented().split_for_parts();
    let document = Arc::new(document);
    let document = get(move |State(_): State<Arc<App>>| async move { Json(document.as_ref().clone()) });
    router.route("/api/openapi.json", document).with_state(app.clone())
}

/// Where nothing is.
pub(crate) async fn nothing_here() -> ApiError {
    ApiError::not_found("there is nothing here; /api/openapi.json says what there is".to_owned())
}

/// A handler panicked: the client learns that, and everybody else goes on.
pub(crate) fn broke_down(panic: Box<dyn Any + Send + 'static>) -> Response {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
    tracing::error!(panic = text, "a request broke down");
    ApiError::internal("the request broke down; the log says where").into_response()
}

/// Does blocking work where few do at a time, and gives its answer.
async fn analyse<T: Send + 'static>(
    app: &Arc<App>,
    work: impl FnOnce(&App) -> Result<T, ApiError> + Send + 'static,
) -> Result<T, ApiError> {
    let waiting = tokio::time::timeout(std::time::Duration::from_secs(app.config.limits.patience_s), app.analyses.acquire());
    let place = waiting.await.map_err(|_| ApiError::busy("too much is being asked; try again in a moment"))?;
    let _place = place.expect("the places are never closed");
    let inner = app.clone();
    match tokio::task::spawn_blocking(move || work(&inner)).await {
        Ok(answer) => answer,
        Err(error) if error.is_panic() => std::panic::resume_unwind(error.into_panic()),
        Err(_) => Err(ApiError::busy("the server is shutting down")),
    }
}
