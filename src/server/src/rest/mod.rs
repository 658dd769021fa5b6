//! The REST service: what people, pages and trainers ask, and what they get. Documented where it is
//! written; the document is at `/api/openapi.json`.

#[cfg(feature = "tables")]
mod attribution;
#[cfg(feature = "tables")]
mod claims;
mod comparison;
#[cfg(feature = "tables")]
mod counterfactuals;
#[cfg(feature = "tables")]
mod definitions;
mod error;
#[cfg(feature = "tables")]
mod exports;
mod extract;
mod frames;
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
    handler::Handler as _,
    http::Method,
    middleware,
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
use utoipa_axum::routes;

pub(crate) use error::{ApiError, ErrorBody};
#[cfg(feature = "tables")]
pub(crate) use error::{OVER_LIMIT, SentError};
pub(crate) use extract::{Body, QueryParams};
#[cfg(feature = "tables")]
pub(crate) use frames::{Camera, FrameRequest};
#[cfg(feature = "tables")]
pub(crate) use {sql::asked_rows, tables::rows};

use crate::{
    Role,
    gate::{self, Demand},
    openenv::http,
    routes::{Routes, TOKEN, operations},
    service::App,
};

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
        (name = "openenv", description = "Environments for clients of OpenEnv; their WebSocket is /ws"),
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
            .add_security_scheme(TOKEN, scheme);
    }
}

/// What holds for every operation and is said once: how names in paths look, and what the
/// gate may answer (`crate::gate`).
struct Everywhere;

/// Names in paths, where not every text is one.
const NAMES: [(&str, &str); 6] = [
    ("file", "^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"),
    ("export", "^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"),
    ("trace", "^[A-Za-z0-9][A-Za-z0-9_.-]{0,199}$"),
    ("other", "^[A-Za-z0-9][A-Za-z0-9_.-]{0,199}$"),
    ("step", r"^(start|[0-9]{1,9})(\.png)?$"),
    ("worker", "^[A-Za-z0-9][A-Za-z0-9_.-]{0,61}$"),
];

impl Modify for Everywhere {
    fn modify(&self, openapi: &mut utoipa::openapi::OpenApi) {
        for operation in openapi.paths.paths.values_mut().flat_map(operations) {
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

/// Every documented route, with what it demands.
fn documented(app: Option<&Arc<App>>) -> Routes {
    use Role::{Act, Admin, Read};
    let routes = Routes::new(app, Document::openapi())
        .open(routes!(health::healthz))
        .open(routes!(health::readyz))
        .for_role(Read, routes!(health::metrics))
        .for_role(Read, routes!(traces::list))
        .for_role(Read, routes!(traces::download))
        .streamed(Admin, routes!(traces::upload))
        .for_role(Admin, routes!(traces::delete))
        .for_role(Read, routes!(traces::episode))
        .for_role(Read, routes!(traces::scene))
        .for_role(Read, routes!(traces::gltf))
        .for_role(Read, routes!(traces::steps))
        .for_role(Read, routes!(frames::frame))
        .for_role(Read, routes!(frames::instances))
        .for_role(Read, routes!(frames::markers))
        // Computes and keeps nothing.
        .for_role(Read, routes!(traces::replay))
        .for_role(Admin, routes!(traces::branch))
        .for_role(Read, routes!(traces::blame))
        .for_role(Read, routes!(traces::reward))
        .for_role(Read, routes!(comparison::compare))
        .for_role(Read, routes!(sessions::list))
        .for_role(Read, routes!(sessions::show))
        .for_role(Admin, routes!(sessions::close))
        .for_role(Read, routes!(sessions::frame))
        .for_role(Read, routes!(sessions::calls))
        .for_role(Read, routes!(sessions::questions))
        .for_role(Admin, routes!(sessions::question))
        .for_role(Admin, routes!(sessions::answer))
        .for_role(Act, routes!(sessions::lease))
        .audited(Act, routes!(sessions::release))
        .open(routes!(http::health))
        .for_role(Act, routes!(http::metadata))
        .for_role(Act, routes!(http::schema))
        .for_role(Act, routes!(http::reset))
        .for_role(Act, routes!(http::step))
        .for_role(Act, routes!(http::state));
    #[cfg(feature = "rerun")]
    let routes = routes.for_role(Read, routes!(traces::recording));
    #[cfg(feature = "tables")]
    let routes = routes
        .for_role(Read, routes!(tables::episodes))
        .for_role(Read, routes!(tables::episode))
        .for_role(Read, routes!(sql::ask))
        .for_role(Read, routes!(sql::named))
        .for_role(Read, routes!(sql::ask_named))
        .for_role(Read, routes!(labels::list))
        .for_role(Admin, routes!(labels::set))
        .for_role(Admin, routes!(labels::remove))
        .for_role(Read, routes!(tables::waiting))
        .for_role(Admin, routes!(labels::answer))
        .for_role(Read, routes!(labels::remarks))
        .for_role(Admin, routes!(labels::remark))
        .for_role(Admin, routes!(labels::take_back))
        .for_role(Read, routes!(counterfactuals::list))
        .for_role(Read, routes!(definitions::list))
        .for_role(Admin, routes!(definitions::keep, definitions::drop))
        .for_role(Read, routes!(claims::show))
        // Computes and keeps nothing.
        .for_role(Read, routes!(claims::evaluate))
        .for_role(Read, routes!(attribution::show))
        .for_role(Read, routes!(exports::list))
        .for_role(Read, routes!(exports::show))
        .for_role(Read, routes!(exports::examples))
        .for_role(Read, routes!(exports::findings))
        .for_role(Read, routes!(jobs::list))
        .for_role(Admin, routes!(jobs::start))
        .for_role(Read, routes!(jobs::show))
        .for_role(Admin, routes!(jobs::cancel))
        .for_role(Read, routes!(jobs::events));
    routes
}

/// The document with what holds for every operation, and the records of other crates.
fn completed(mut document: utoipa::openapi::OpenApi) -> utoipa::openapi::OpenApi {
    Everywhere.modify(&mut document);
    let records: BTreeMap<String, RefOr<Schema>> =
        serde_json::from_str(RECORDS).expect("records.json holds schemas");
    document
        .components
        .get_or_insert_default()
        .schemas
        .extend(records);
    document
}

/// The complete OpenAPI document of the REST service.
pub fn openapi() -> utoipa::openapi::OpenApi {
    completed(documented(None).split().1)
}

/// Every route of the service: the documented ones, and those that `others` adds.
pub(crate) fn router(app: &Arc<App>, others: impl FnOnce(Routes) -> Routes) -> Router {
    let (router, document, others) = others(documented(Some(app))).split();
    let document = Arc::new(completed(document));
    let document = get(|| async move { Json(document.as_ref().clone()) });
    let open = middleware::from_fn_with_state((app.clone(), Demand::OPEN), gate::admit);
    router
        .route(
            "/api/openapi.json",
            document.clone().route_layer(open.clone()),
        )
        // Where clients of OpenEnv look for it.
        .route("/openapi.json", document.route_layer(open.clone()))
        .with_state(app.clone())
        .merge(others)
        .method_not_allowed_fallback(other_method.layer(open))
}

/// What is there is asked for in another way; the header `Allow` says in which.
async fn other_method(method: Method) -> ApiError {
    ApiError::not_allowed(format!(
        "method {method} is not allowed on this path; the header `Allow` lists those that are"
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
    let place = app.place(&gate::owner()).await?;
    let inner = app.clone();
    let working = move || {
        // Held as long as it works, and not as long as somebody waits.
        let _place = place;
        work(&inner)
    };
    match app.pool.setup().host.work.spawn(working).await {
        Ok(answer) => answer.map_err(|error| told(app, error)),
        Err(error) if error.is_panic() => std::panic::resume_unwind(error.into_panic()),
        Err(_) => Err(ApiError::busy("the server is shutting down")),
    }
}
