//! Episodes as the tables know them.

use std::{collections::BTreeSet, path::Path, sync::Arc};

use arrow::{array::AsArray as _, compute::cast, datatypes::DataType};
use axum::{
    Json,
    body::Bytes,
    extract::State,
    http::header,
    response::{IntoResponse as _, Response},
};
use reel_query::{Format, Parameters, QueryError, QuerySession};
use reel_tables::{Store, StoreError};
use reel_world::Digest;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use utoipa::{IntoParams, ToSchema};

use super::{
    ApiError, analyse,
    error::ErrorBody,
    extract::{PathParams, QueryParams},
    traces::limited,
};
use crate::service::App;

#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct Filter {
    /// FDP, FODP, FDO or SUL.
    family: Option<String>,
    /// Only episodes that this policy played, by its name.
    policy: Option<String>,
    /// Only episodes of the run with this id.
    run_id: Option<String>,
    /// Only episodes of the task with this id.
    task_id: Option<String>,
    /// Whether the goal held at the end.
    success: Option<bool>,
    /// From the one after this id on.
    #[serde(default)]
    after: String,
    /// At most so many, up to 1,000.
    #[serde(default = "page")]
    #[param(minimum = 1, maximum = 1000, default = 100)]
    limit: usize,
}

fn page() -> usize {
    100
}

/// A part of the episodes.
#[derive(Serialize, ToSchema)]
pub(super) struct Episodes {
    #[schema(value_type = Vec<Object>)]
    episodes: Vec<Value>,
    /// What to give as `after` for the next part; null at the end.
    next: Option<String>,
}

const COLUMNS: &str = "episode_id, run_id, group_id, rollout_index, task_id, family, policy, seed, profile, success, completion, \
                       total_reward, length, asks, end_reason, trace";

/// Episodes of the tables, by id.
#[utoipa::path(get, path = "/api/episodes", tag = "tables", params(Filter),
    responses((status = 200, body = Episodes), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn episodes(
    State(app): State<Arc<App>>,
    QueryParams(filter): QueryParams<Filter>,
) -> Result<Json<Episodes>, ApiError> {
    let limit = limited(filter.limit)?;
    let mut conditions = vec!["episode_id > $after".to_owned()];
    let mut parameters = Parameters::from([("after".to_owned(), filter.after)]);
    let texts = [
        ("family", filter.family),
        ("policy", filter.policy),
        ("run_id", filter.run_id),
        ("task_id", filter.task_id),
    ];
    for (column, value) in texts {
        if let Some(value) = value {
            conditions.push(format!("{column} = ${column}"));
            parameters.insert(column.to_owned(), value);
        }
    }
    if let Some(success) = filter.success {
        conditions.push(if success { "success" } else { "NOT success" }.to_owned());
    }
    let sql = format!(
        "SELECT {COLUMNS} FROM episodes WHERE {} ORDER BY episode_id LIMIT {limit}",
        conditions.join(" AND ")
    );
    let episodes = analyse(&app, move |app| rows(app, &sql, &parameters)).await?;
    let last = episodes.last().filter(|_| episodes.len() == limit);
    let next = last
        .and_then(|last| last["episode_id"].as_str())
        .map(str::to_owned);
    Ok(Json(Episodes { episodes, next }))
}

/// One episode of the tables, with its class, blame and labels.
#[utoipa::path(get, path = "/api/episodes/{episode}", tag = "tables",
    params(("episode" = String, Path)),
    responses((status = 200, body = Object), (status = 400, body = ErrorBody), (status = 404, body = ErrorBody),
        (status = 422, body = ErrorBody), (status = 503, body = ErrorBody)))]
pub(super) async fn episode(
    State(app): State<Arc<App>>,
    PathParams(id): PathParams<String>,
) -> Result<Json<Value>, ApiError> {
    let found = analyse(&app, move |app| {
        let parameters = Parameters::from([("id".to_owned(), id.clone())]);
        let of = |columns: &str, table: &str| {
            rows(
                app,
                &format!("SELECT {columns} FROM {table} WHERE episode_id = $id"),
                &parameters,
            )
        };
        let mut episode = of(COLUMNS, "episodes")?
            .pop()
            .ok_or_else(|| ApiError::not_found(format!("the tables have no episode {id}")))?;
        for table in ["classes", "blame", "labels"] {
            episode[table] = json!(of("*", table)?);
        }
        Ok(episode)
    });
    found.await.map(Json)
}

/// The rows of an answer to one of our own questions. Traces of the archive go by their names.
pub(crate) fn rows(app: &App, sql: &str, parameters: &Parameters) -> Result<Vec<Value>, ApiError> {
    let session = QuerySession::with_limits(app.tables.newest()?.store, app.sql_limits())?;
    let batches = session.run_with(sql, parameters)?;
    let text = reel_query::format(&batches, Format::Json).map_err(QueryError::from)?;
    let rows =
        serde_json::from_str(&text).map_err(|_| ApiError::internal("the answer is not JSON"))?;
    Ok(named(app, rows))
}

/// Traces of the archive that the tables do not have.
#[derive(Serialize, ToSchema)]
pub(super) struct Waiting {
    /// How many there are.
    count: usize,
    /// How many the tables have: where that grows, they have new episodes.
    known: usize,
    /// Their names in order, the first 1,000.
    traces: Vec<String>,
    /// Whether the server reads them in by itself (`ingest_new`); else a job of kind `ingest` does.
    automatic: bool,
}

impl Waiting {
    fn of(app: &App, known: usize, mut traces: Vec<String>) -> Self {
        let count = traces.len();
        traces.truncate(WAITING_LISTED);
        Self {
            count,
            known,
            traces,
            automatic: app.config.ingests_new(),
        }
    }

    fn to_json(&self) -> Bytes {
        serde_json::to_vec(self).unwrap_or_default().into()
    }
}

/// Traces that were recorded since the last ingest: branches, episodes of sessions, uploads. Files
/// that cannot be read in (table `quarantine`) do not wait.
#[utoipa::path(get, path = "/api/waiting", operation_id = "waiting_traces", tag = "tables",
    responses((status = 200, body = Waiting), (status = 503, body = ErrorBody), (status = 507, body = ErrorBody)))]
pub(super) async fn waiting(State(app): State<Arc<App>>) -> Result<Response, ApiError> {
    let answer = analyse(&app, |app| {
        let recorded = app.archive.finished().map_err(ApiError::disk)?;
        let newest = match app.tables.newest() {
            Ok(newest) => newest,
            // Before the first ingest everything waits.
            Err(StoreError::NoStore { .. }) => {
                return Ok(Waiting::of(app, 0, recorded).to_json());
            }
            Err(error) => return Err(error.into()),
        };
        // Pages ask again and again, and seldom is anything new.
        let names = Digest::of(recorded.join("\n").as_bytes());
        let ingested = app.intake.names();
        let question = format!("waiting traces of {names}, {} ingested", ingested.len());
        let stamp = newest.stamp;
        if let Some(answer) = app.tables.cached_answer(stamp.as_ref(), &question) {
            return Ok(answer);
        }
        let known = known_traces(app, newest.store)?;
        let new = recorded
            .into_iter()
            .filter(|name| !known.contains(name) && !ingested.contains(name));
        let answer = Waiting::of(app, known.len(), new.collect()).to_json();
        app.tables
            .cache_answer(stamp.as_ref(), question, answer.clone());
        Ok(answer)
    });
    let content = [(header::CONTENT_TYPE, "application/json")];
    answer.await.map(|answer| (content, answer).into_response())
}

/// Most names of waiting traces in one answer.
const WAITING_LISTED: usize = 1_000;

/// Names of the traces that an ingest has looked at.
fn known_traces(app: &App, store: Store) -> Result<BTreeSet<String>, ApiError> {
    let session = QuerySession::with_limits(store, app.sql_limits())?;
    let looked_at = "SELECT trace FROM episodes UNION ALL SELECT trace FROM quarantine";
    let mut names = BTreeSet::new();
    for batch in session.run(looked_at)? {
        let paths = cast(batch.column(0), &DataType::Utf8).map_err(QueryError::from)?;
        let paths = paths.as_string::<i32>().iter().flatten();
        names.extend(paths.filter_map(|path| app.archive.name_of(Path::new(path))));
    }
    Ok(names)
}

/// Rows with the names of traces in the place of their paths.
pub(super) fn named(app: &App, rows: Vec<Value>) -> Vec<Value> {
    let named = |mut row: Value| {
        let path = row
            .get("trace")
            .and_then(Value::as_str)
            .map(std::path::PathBuf::from);
        if let Some(path) = path {
            row["trace"] = json!(app.archive.name_of(&path));
        }
        row
    };
    rows.into_iter().map(named).collect()
}
