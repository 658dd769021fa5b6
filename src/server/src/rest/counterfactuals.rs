//! What plausible other calls come to, from table `counterfactuals`.

use std::sync::Arc;

use axum::{Json, extract::State};
use reel_query::Parameters;
use serde::Deserialize;
use serde_json::{Value, json};
use utoipa::IntoParams;

use super::{ApiError, analyse, error::ErrorBody, extract::QueryParams, tables::rows};
use crate::service::App;

/// Whose counterfactuals are asked for.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct CounterfactualsOf {
    /// Id of the episode whose calls were replaced.
    episode: String,
}

/// What the plausible other calls of every step come to, in the order of the steps: rows of table
/// `counterfactuals`, none where no job of kind `counterfactuals` has played the episode.
#[utoipa::path(get, path = "/api/counterfactuals", operation_id = "list_counterfactuals", tag = "tables",
    params(CounterfactualsOf),
    responses((status = 200, body = Vec<Object>), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn list(
    State(app): State<Arc<App>>,
    QueryParams(of): QueryParams<CounterfactualsOf>,
) -> Result<Json<Value>, ApiError> {
    let found = analyse(&app, move |app| {
        let parameters = Parameters::from([("id".to_owned(), of.episode)]);
        let sql =
            "SELECT * FROM counterfactuals WHERE episode_id = $id ORDER BY step, origin, call";
        rows(app, sql, &parameters)
    });
    found.await.map(|found| Json(json!(found)))
}
