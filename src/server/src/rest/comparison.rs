//! Two episodes of one task side by side.

use std::sync::Arc;

use axum::{Json, extract::State};
use serde_json::{Value, json};

use super::{ApiError, analyse, error::ErrorBody, extract::PathParams};
use crate::service::App;

/// Two episodes of one task side by side: so many first calls alike, then rows in which a call
/// stands beside the one that corresponds to it, with what came of each (`reel diff --json`).
#[utoipa::path(get, path = "/api/traces/{trace}/compare/{other}", operation_id = "compare_traces", tag = "traces",
    params(("trace" = String, Path), ("other" = String, Path, description = "Name of the other trace")),
    responses((status = 200, body = ref("#/components/schemas/Comparison")), (status = 400, body = ErrorBody),
        (status = 404, body = ErrorBody), (status = 409, body = ErrorBody), (status = 422, body = ErrorBody),
        (status = 503, body = ErrorBody)))]
pub(super) async fn compare(
    State(app): State<Arc<App>>,
    PathParams((name, other)): PathParams<(String, String)>,
) -> Result<Json<Value>, ApiError> {
    let answer = analyse(&app, move |app| {
        let (a, b) = (app.archive.read(&name)?, app.archive.read(&other)?);
        let comparison = reel_replay::compare(&a, &b).map_err(|_| {
            let why = format!(
                "{name} and {other} play different tasks; only calls of one task are aligned"
            );
            ApiError::unprocessable("other_task", why)
        })?;
        let mut value = json!(comparison);
        for (episode, name) in [name, other].into_iter().enumerate() {
            value["episodes"][episode]["trace"] = json!(name);
        }
        Ok(value)
    });
    answer.await.map(Json)
}
