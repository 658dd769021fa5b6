//! What each capability cost, from table `attribution`.

use std::{path::PathBuf, sync::Arc};

use axum::{Json, extract::State};
use reel_counterfactual::attribution::{Attributed, CapabilityBranch, estimates};
use reel_query::Parameters;
use serde_json::{Value, json};

use super::{ApiError, analyse, error::ErrorBody, tables::rows};
use crate::service::App;

/// Episodes that were played to an end and not broken off, with a row for each capability that
/// `reel attribute` measured of them.
const MEASURED: &str = "SELECT e.episode_id, e.trace_digest, e.trace, e.task_id, e.run_id, e.policy, e.family, e.success,
  a.capability, a.failures, a.first_step, a.played, a.success AS rescued, a.replaced, a.skipped, a.length, a.branch, a.verified, a.reason
FROM episodes e LEFT JOIN attribution a ON a.trace_digest = e.trace_digest
WHERE (e.success OR (NOT e.success AND e.end_reason <> 'aborted')) AND e.parent_trace IS NULL
ORDER BY e.episode_id, e.trace_digest";

/// Success rates with each capability perfect, of all episodes (group `all episodes`) and by policy,
/// from what the latest job of kind `attribute` measured. `missing` counts failed episodes that came
/// after it; they count as failed.
#[utoipa::path(get, path = "/api/attribution", operation_id = "show_attribution", tag = "tables",
    responses((status = 200, body = ref("#/components/schemas/Attribution")),
        (status = 404, body = ErrorBody), (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn show(State(app): State<Arc<App>>) -> Result<Json<Value>, ApiError> {
    let answer = analyse(&app, |app| {
        let unreadable = |_| ApiError::internal("table attribution cannot be read");
        let mut episodes: Vec<Attributed> = Vec::new();
        for row in rows(app, MEASURED, &Parameters::new())? {
            let digest = row["trace_digest"].as_str().unwrap_or_default().to_owned();
            if episodes
                .last()
                .is_none_or(|last| last.trace_digest.to_string() != digest)
            {
                episodes.push(episode(&row).map_err(unreadable)?);
            }
            if let (Some(measured), Some(last)) =
                (branch(&row).map_err(unreadable)?, episodes.last_mut())
            {
                last.capabilities.push(measured);
            }
        }
        let unmeasured =
            |one: &&Attributed| one.success == Some(false) && one.capabilities.is_empty();
        let missing = episodes.iter().filter(unmeasured).count();
        let measured = episodes
            .iter()
            .filter(|one| !one.capabilities.is_empty())
            .count();
        let mut all = estimates(&episodes, |_| "all episodes".to_owned());
        all.extend(estimates(&episodes, |one| one.policy.clone()));
        Ok(json!({"estimates": all, "measured": measured, "missing": missing}))
    });
    answer.await.map(Json)
}

fn episode(row: &Value) -> Result<Attributed, serde_json::Error> {
    let mut fields = row.clone();
    fields["trace"] = json!(row["trace"].as_str().unwrap_or_default());
    for name in ["task_id", "run_id", "policy"] {
        fields[name] = json!(row[name].as_str().unwrap_or_default());
    }
    fields["capabilities"] = json!([]);
    serde_json::from_value(fields)
}

fn branch(row: &Value) -> Result<Option<CapabilityBranch>, serde_json::Error> {
    if row["capability"].is_null() {
        return Ok(None);
    }
    let mut fields = row.clone();
    fields["success"] = row["rescued"].clone();
    fields["branch"] = json!(row["branch"].as_str().map(PathBuf::from));
    serde_json::from_value(fields).map(Some)
}
