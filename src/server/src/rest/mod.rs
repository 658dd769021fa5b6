//! The REST service: what people, pages and trainers ask, and what they get. Documented where it is
//! written; the document is at `/api/openapi.json`.

#[cfg(feature = "tables")]
mod definitions;
mod error;
#[cfg(feature = "tables")]
mod exports;
mod extract;
mod health;
#[cfg(feature = "tables")]
mod jobs;
#[cfg(feature = "tables")]
mod labels;
mod sessions;
#[cfg(feature = "tables")]
mod sql;
#[cfg(feature = "tables")]
mod tables;
mod traces;

use std::{any::Any, collections::BTreeMap, sync::Arc};

use axum::{
    Json, Router,
    extract::State,
    http::Method,
    response::{IntoResponse, Response},
    routing::get,
};
use utoipa::{
    Modify, OpenApi,
    openapi::{
        Content, Ref, RefOr, Required, ResponseBuilder, Schema,
        path::ParameterIn,
        security::{Http, HttpAuthScheme, SecurityScheme},
    },
};
use utoipa_axum::{router::OpenApiRouter, routes};

pub(crate) use error::ApiError;
#[cfg(feature = "tables")]
pub(crate) use tables::rows;

use crate::service::App;

/// Schemas of what other crates serialise: records of traces, blame, sessions, examples.
const RECORDS: &str = include_str!("records.json");

/// General part of the OpenAPI document: title, tags and security scheme.
#[derive(OpenApi)]
#[openapi(
    info(title = "Reel", description = "Episodes of embodied agents: traces, replay, blame, tables, jobs, live sessions."),
    tags(
        (name = "traces", description = "Recorded episodes: files, steps, images, replay, branches, blame, rewards"),
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
        openapi
            .components
            .get_or_insert_default()
            .add_security_scheme("token", scheme);
    }
}

/// What holds for every operation and is said once: how names in paths look, and what the
/// gate may answer (`crate::gate`).
struct Everywhere;

/// Names in paths, where not every text is one.
const NAMES: [(&str, &str); 5] = [
    ("file", "^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"),
    ("export", "^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"),
    ("trace", "^[A-Za-z0-9][A-Za-z0-9_.-]{0,199}$"),
    ("step", r"^(start|[0-9]{1,9})(\.png)?$"),
    ("worker", "^[A-Za-z0-9][A-Za-z0-9_.-]{0,61}$"),
];

impl Modify for Everywhere {
    fn modify(&self, openapi: &mut utoipa::openapi::OpenApi) {
        let paths = openapi.paths.paths.values_mut();
        let operations = paths
            .flat_map(|path| {
                [
                    &mut path.get,
                    &mut path.put,
                    &mut path.post,
                    &mut path.delete,
                ]
            })
            .flatten();
        for operation in operations {
            for parameter in operation
                .parameters
                .iter_mut()
                .flatten()
                .filter(|it| it.parameter_in == ParameterIn::Path)
            {
                let pattern = NAMES
                    .iter()
                    .find(|(name, _)| *name == parameter.name)
                    .map(|(_, pattern)| (*pattern).to_owned());
                if let Some(RefOr::T(Schema::Object(schema))) = &mut parameter.schema {
                    schema.pattern = pattern;
                }
            }
            let mut may_answer = |status: &str, why: &str| {
                let body = Content::new(Some(Ref::from_schema_name("ErrorBody")));
                let response = ResponseBuilder::new()
                    .description(why)
                    .content("application/json", body)
                    .build();
                operation
                    .responses
                    .responses
                    .insert(status.to_owned(), response.into());
            };
            may_answer(
                "403",
                "A host or origin that is not allowed, or a token that lacks the role",
            );
            may_answer("429", "Too many requests; wait a moment");
            if operation.security.is_some() {
                may_answer("401", "No token, or an unknown or revoked one");
            }
            if let Some(body) = &mut operation.request_body {
                body.required = Some(Required::True);
                may_answer("408", "The request body timed out");
                may_answer("413", "The request body is too large");
            }
        }
    }
}

/// Every route of the service, and the document of all of them.
fn documented() -> (Router<Arc<App>>, utoipa::openapi::OpenApi) {
    let routes = OpenApiRouter::with_openapi(Document::openapi())
        .routes(routes!(health::healthz))
        .routes(routes!(health::readyz))
        .routes(routes!(health::metrics))
        .routes(routes!(traces::list))
        .routes(routes!(traces::upload, traces::download, traces::delete))
        .routes(routes!(traces::episode))
        .routes(routes!(traces::scene))
        .routes(routes!(traces::steps))
        .routes(routes!(traces::frame))
        .routes(routes!(traces::replay))
        .routes(routes!(traces::branch))
        .routes(routes!(traces::blame))
        .routes(routes!(traces::reward))
        .routes(routes!(sessions::list))
        .routes(routes!(sessions::show, sessions::close))
        .routes(routes!(sessions::frame))
        .routes(routes!(sessions::questions))
        .routes(routes!(sessions::answer))
        .routes(routes!(sessions::lease))
        .routes(routes!(sessions::release));
    #[cfg(feature = "rerun")]
    let routes = routes.routes(routes!(traces::recording));
    #[cfg(feature = "tables")]
    let routes = routes
        .routes(routes!(tables::episodes))
        .routes(routes!(tables::episode))
        .routes(routes!(sql::ask))
        .routes(routes!(sql::named))
        .routes(routes!(sql::ask_named))
        .routes(routes!(labels::list, labels::set))
        .routes(routes!(definitions::list))
        .routes(routes!(definitions::keep, definitions::drop))
        .routes(routes!(exports::list))
        .routes(routes!(exports::show))
        .routes(routes!(exports::examples))
        .routes(routes!(exports::findings))
        .routes(routes!(jobs::list, jobs::start))
        .routes(routes!(jobs::show, jobs::cancel))
        .routes(routes!(jobs::events));
    let (router, mut document) = routes.split_for_parts();
    Everywhere.modify(&mut document);
    let records: BTreeMap<String, RefOr<Schema>> =
        serde_json::from_str(RECORDS).expect("records.json holds schemas");
    document
        .components
        .get_or_insert_default()
        .schemas
        .extend(records);
    (router, document)
}

/// The complete OpenAPI document of the REST service.
pub fn openapi() -> utoipa::openapi::OpenApi {
    documented().1
}

/// Every route of the service.
pub(crate) fn router(app: &Arc<App>) -> Router {
    let (router, document) = documented();
    let document = Arc::new(document);
    let document =
        get(move |State(_): State<Arc<App>>| async move { Json(document.as_ref().clone()) });
    router
        .route("/api/openapi.json", document)
        .with_state(app.clone())
        .method_not_allowed_fallback(other_method)
}

/// What is there is asked for in another way; the header `Allow` says in which.
async fn other_method(method: Method) -> ApiError {
    ApiError::not_allowed(format!(
        "method {method} is not allowed on this path; see /api/openapi.json"
    ))
}

/// Answers 404 for paths that no route serves.
pub(crate) async fn not_found() -> ApiError {
    ApiError::not_found("unknown path; see /api/openapi.json".to_owned())
}

/// A handler panicked: the client learns that, and everybody else goes on.
pub(crate) fn broke_down(panic: Box<dyn Any + Send + 'static>) -> Response {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text
        .or_else(|| panic.downcast_ref::<String>().cloned())
        .unwrap_or_default();
    tracing::error!(panic = text, "request panicked");
    ApiError::internal("the request panicked; the log has the details").into_response()
}

/// An error as clients see it: names, never paths of this machine.
fn told(app: &App, error: ApiError) -> ApiError {
    error.with_path_redacted(&app.archive)
}

/// Does blocking work where few do at a time, and gives its answer.
async fn analyse<T: Send + 'static>(
    app: &Arc<App>,
    work: impl FnOnce(&App) -> Result<T, ApiError> + Send + 'static,
) -> Result<T, ApiError> {
    let waiting = tokio::time::timeout(
        std::time::Duration::from_secs(app.config.limits.worker_timeout_s),
        app.analyses.acquire(),
    );
    let place = waiting
        .await
        .map_err(|_| ApiError::busy("too many requests are waiting; try again in a moment"))?;
    let _place = place.expect("the places are never closed");
    let inner = app.clone();
    match tokio::task::spawn_blocking(move || work(&inner)).await {
        Ok(answer) => answer.map_err(|error| told(app, error)),
        Err(error) if error.is_panic() => std::panic::resume_unwind(error.into_panic()),
        Err(_) => Err(ApiError::busy("the server is shutting down")),
    }
}
