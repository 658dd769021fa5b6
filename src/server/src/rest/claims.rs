//! Claims: sentences about episodes that the service counts anew.

use std::sync::Arc;

use axum::{Json, extract::State};
use reel_query::claim::{Claim, ClaimReport};
use serde_json::{Value, json};
use utoipa::openapi::Ref;

use super::{
    ApiError, analyse, asked_rows,
    definitions::kept_claim,
    error::ErrorBody,
    extract::{Body, PathParams},
};
use crate::service::App;

/// What a stored claim comes to over the tables as they are now: how many of the episodes that count
/// bear it out, with a 95 % interval (tasks as clusters), run by run, with examples.
#[utoipa::path(get, path = "/api/claims/{file}", operation_id = "show_claim", tag = "tables",
    params(("file" = String, Path, description = "Name of the definition that is a claim")),
    responses((status = 200, body = ref("#/components/schemas/ClaimReport")), (status = 400, body = ErrorBody),
        (status = 404, body = ErrorBody), (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn show(
    State(app): State<Arc<App>>,
    PathParams(name): PathParams<String>,
) -> Result<Json<Value>, ApiError> {
    let answer = analyse(&app, move |app| evaluated(app, &kept_claim(app, &name)?));
    answer.await.map(Json)
}

/// What a claim would come to; nothing is stored.
#[utoipa::path(post, path = "/api/claims", operation_id = "evaluate_claim", tag = "tables",
    request_body(content = ref("#/components/schemas/Claim"), content_type = "application/json"),
    responses((status = 200, body = ref("#/components/schemas/ClaimReport")), (status = 400, body = ErrorBody),
        (status = 404, body = ErrorBody), (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn evaluate(
    State(app): State<Arc<App>>,
    Body(claim): Body<Claim>,
) -> Result<Json<Value>, ApiError> {
    let answer = analyse(&app, move |app| evaluated(app, &claim));
    answer.await.map(Json)
}

/// The schema of a claim, which `records.json` has.
pub(super) fn schema() -> Ref {
    Ref::from_schema_name("Claim")
}

fn evaluated(app: &App, claim: &Claim) -> Result<Value, ApiError> {
    claim
        .check()
        .map_err(|problem| ApiError::unprocessable("bad_claim", format!("the claim {problem}")))?;
    let rows = asked_rows(app, &claim.question(), || false)?;
    let report = ClaimReport::of(claim, rows)
        .map_err(|_| ApiError::internal("the counts of the claim cannot be read"))?;
    Ok(json!(report))
}
