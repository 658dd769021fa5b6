//! Questions in SQL, under the limits of the query layer. A short answer goes out whole, a long one
//! while it comes; one that is cut off breaks off, and no client takes it for whole.

use std::{io, sync::Arc};

use axum::{
    Json,
    body::{Body, Bytes},
    extract::State,
    http::{Version, header},
    response::{IntoResponse, Response},
};
use futures_util::{Stream, StreamExt as _, stream};
use reel_query::{Limits, Parameters, named};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tokio::sync::mpsc;
use utoipa::{IntoParams, ToSchema};

use super::{
    ApiError,
    error::ErrorBody,
    extract::{Body as JsonBody, PathParams, QueryParams},
    told,
};
use crate::{
    gate,
    service::App,
    sql_process::{AnswerFormat, SqlRequest},
    store::ANSWER_MAX,
};

/// Parts of an answer that wait for a slow client; the query waits with them.
const AHEAD: usize = 4;

/// What a query sends while it runs.
enum Part {
    /// The next bytes of the answer.
    Bytes(Bytes),
    /// The answer is whole. Where this does not come, it was cut off.
    End,
}

/// A SQL query with its parameters, answer format and table version.
#[derive(Clone, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Question {
    /// One statement that asks.
    #[schema(example = "SELECT family, count(*) AS n FROM episodes GROUP BY family")]
    sql: String,
    /// Values of its `$parameters`.
    #[serde(default)]
    #[schema(inline)]
    parameters: Parameters,
    /// How the answer looks.
    #[serde(default)]
    format: AnswerFormat,
    /// The tables as they were at this version.
    at: Option<u64>,
}

impl App {
    /// What a question may cost.
    pub(crate) fn sql_limits(&self) -> Limits {
        let limits = &self.config.limits;
        Limits {
            memory_bytes: limits.sql_mib << 20,
            time: std::time::Duration::from_secs(limits.sql_timeout_s),
            rows: limits.sql_rows,
        }
    }

    /// A question as a process gets it.
    fn sql_request(&self, question: Question) -> SqlRequest {
        let Question {
            sql,
            parameters,
            format,
            at,
        } = question;
        SqlRequest {
            store: self.config.store(),
            at,
            sql,
            parameters,
            format,
            limits: self.sql_limits().into(),
        }
    }
}

/// Asks the tables in SQL.
#[utoipa::path(post, path = "/api/sql", tag = "tables", request_body = Question,
    responses((status = 200, description = "As the format says",
            content((Vec<Object> = "application/json"), ("text/csv"), ("application/vnd.apache.arrow.stream"), ("application/vnd.apache.parquet"))),
        (status = 400, body = ErrorBody), (status = 404, body = ErrorBody), (status = 422, body = ErrorBody),
        (status = 503, body = ErrorBody)))]
pub(super) async fn ask(
    State(app): State<Arc<App>>,
    version: Version,
    JsonBody(question): JsonBody<Question>,
) -> Result<Response, ApiError> {
    answer(app, version, question).await
}

/// A query that comes with Reel.
#[derive(Serialize, ToSchema)]
pub(super) struct NamedQuery {
    name: &'static str,
    /// Short description of what the query answers.
    summary: String,
    /// Its parameters, with what they are where nobody says otherwise.
    #[schema(inline)]
    parameters: Parameters,
    sql: &'static str,
}

/// The queries that come with Reel.
#[utoipa::path(get, path = "/api/queries", tag = "tables",
    responses((status = 200, body = Vec<NamedQuery>)))]
pub(super) async fn named() -> Json<Vec<NamedQuery>> {
    let query = |query: &'static named::NamedQuery| NamedQuery {
        name: query.name,
        summary: query.summary(),
        parameters: query.parameters().into_iter().collect(),
        sql: query.sql,
    };
    Json(named::ALL.iter().map(query).collect())
}

#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct NamedOptions {
    /// json, csv, arrow or parquet.
    #[serde(default)]
    #[param(inline)]
    format: AnswerFormat,
    /// Values of its parameters: `name=value`, several joined by commas.
    #[param(pattern = "^([^,]*=[^,]*)?(,([^,]*=[^,]*)?)*$")]
    parameters: Option<String>,
}

/// Asks a query that comes with Reel.
#[utoipa::path(get, path = "/api/queries/{name}", tag = "tables",
    params(("name" = String, Path), NamedOptions),
    responses((status = 200, description = "As the format says",
            content((Vec<Object> = "application/json"), ("text/csv"), ("application/vnd.apache.arrow.stream"), ("application/vnd.apache.parquet"))),
        (status = 400, body = ErrorBody), (status = 404, body = ErrorBody), (status = 422, body = ErrorBody),
        (status = 503, body = ErrorBody)))]
pub(super) async fn ask_named(
    State(app): State<Arc<App>>,
    version: Version,
    PathParams(name): PathParams<String>,
    QueryParams(options): QueryParams<NamedOptions>,
) -> Result<Response, ApiError> {
    let query = named::by_name(&name).ok_or_else(|| {
        ApiError::not_found(format!(
            "no query is called '{name}'; /api/queries lists them"
        ))
    })?;
    let mut parameters: Parameters = query.parameters().into_iter().collect();
    for part in options
        .parameters
        .iter()
        .flat_map(|text| text.split(','))
        .filter(|part| !part.is_empty())
    {
        let (name, value) = part.split_once('=').ok_or_else(|| {
            ApiError::bad_request(
                "bad_parameter",
                format!("parameters: '{part}' is not name=value"),
            )
        })?;
        parameters.insert(name.to_owned(), value.to_owned());
    }
    answer(
        app,
        version,
        Question {
            sql: query.sql.to_owned(),
            parameters,
            format: options.format,
            at: None,
        },
    )
    .await
}

/// Asks, and answers: with all of it or why there is none, where it is short; else with what comes,
/// as it comes.
async fn answer(app: Arc<App>, version: Version, question: Question) -> Result<Response, ApiError> {
    let kind = match question.format {
        AnswerFormat::Json => "application/json",
        AnswerFormat::Csv => "text/csv; charset=utf-8",
        AnswerFormat::Arrow => "application/vnd.apache.arrow.stream",
        AnswerFormat::Parquet => "application/vnd.apache.parquet",
    };
    let place = app.place(&gate::owner()).await?;
    let (sender, mut parts) = mpsc::channel(AHEAD);
    let asked = app.clone();
    tokio::task::spawn_blocking(move || {
        // Given back also when the query panics.
        let _place = place;
        let last = run(&asked, &question, &sender).map(|()| Part::End);
        let _ = sender.blocking_send(last);
    });
    let kind = [(header::CONTENT_TYPE, kind)];
    let mut begun = Vec::new();
    while begun.len() <= ANSWER_MAX {
        match parts.recv().await {
            Some(Ok(Part::Bytes(part))) => begun.extend_from_slice(&part),
            Some(Ok(Part::End)) => return Ok((kind, Body::from(begun)).into_response()),
            Some(Err(error)) => return Err(told(&app, error)),
            None => {
                return Err(ApiError::internal(
                    "the query panicked; the log has the details",
                ));
            }
        }
    }
    if version < Version::HTTP_11 {
        return Err(ApiError::unprocessable(
            "too_long",
            format!(
                "the answer has more than {ANSWER_MAX} bytes, and in HTTP/1.0 nothing shows whether one of \
                 unknown length is whole; use HTTP/1.1, or ask for less"
            ),
        ));
    }
    let begun = stream::once(async move { Ok(Bytes::from(begun)) });
    let body = Body::from_stream(begun.chain(rest(parts)));
    Ok((kind, body).into_response())
}

/// The rest of an answer whose status is sent already. Where it is cut off, the chunks end without
/// their end, which clients see.
fn rest(
    parts: mpsc::Receiver<Result<Part, ApiError>>,
) -> impl Stream<Item = io::Result<Bytes>> + Send {
    stream::unfold(Some(parts), |parts| async move {
        let mut parts = parts?;
        let error = match parts.recv().await {
            Some(Ok(Part::Bytes(part))) => return Some((Ok(part), Some(parts))),
            Some(Ok(Part::End)) => return None,
            Some(Err(error)) => io::Error::other(error.to_string()),
            None => io::Error::other("the query panicked"),
        };
        tracing::warn!("an answer in SQL was cut off: a limit or an error came after its status");
        Some((Err(error), None))
    })
}

/// Asks a process of its own, unless the answer is known; `sender` gets the parts.
fn run(
    app: &App,
    question: &Question,
    sender: &mpsc::Sender<Result<Part, ApiError>>,
) -> Result<(), ApiError> {
    let gone = {
        let sender = sender.clone();
        move || sender.is_closed()
    };
    each_part(app, question, gone, |part| {
        sender.blocking_send(Ok(Part::Bytes(part))).is_ok()
    })
}

/// Gives the parts of an answer to `each`, as long as it wants more: from the cache, or from a
/// process of its own.
fn each_part(
    app: &App,
    question: &Question,
    gone: impl Fn() -> bool + Clone + Send + 'static,
    mut each: impl FnMut(Bytes) -> bool,
) -> Result<(), ApiError> {
    let stamp = match question.at {
        None => app.tables.stamp()?,
        Some(_) => None,
    };
    let asked = serde_json::to_string(&(&question.sql, &question.parameters, question.format))
        .unwrap_or_default();
    if let Some(answer) = app.tables.cached_answer(stamp.as_ref(), &asked) {
        each(answer);
        return Ok(());
    }
    let request = app.sql_request(question.clone());
    let mut whole = Vec::new();
    let lasting = app.sql.ask(&request, gone, |part| {
        if whole.len() <= ANSWER_MAX {
            whole.extend_from_slice(&part);
        }
        each(part)
    })?;
    if lasting {
        app.tables.cache_answer(stamp.as_ref(), asked, whole.into());
    }
    Ok(())
}

/// The rows of the answer to somebody's question, which ends where nobody waits any more. Traces of
/// the archive go by their names.
pub(crate) fn asked_rows(
    app: &App,
    sql: &str,
    gone: impl Fn() -> bool + Clone + Send + 'static,
) -> Result<Vec<Value>, ApiError> {
    let question = Question {
        sql: sql.to_owned(),
        parameters: Parameters::new(),
        format: AnswerFormat::Json,
        at: None,
    };
    let mut text = Vec::new();
    each_part(app, &question, gone, |part| {
        text.extend_from_slice(&part);
        text.len() <= ROWS_BYTES_MAX
    })?;
    if text.len() > ROWS_BYTES_MAX {
        return Err(ApiError::unprocessable(
            "too_long",
            format!("the answer has more than {ROWS_BYTES_MAX} bytes; aggregate, or use LIMIT"),
        ));
    }
    let rows =
        serde_json::from_slice(&text).map_err(|_| ApiError::internal("the answer is not JSON"))?;
    Ok(super::tables::named(app, rows))
}

/// Longest answer that is read as rows, in bytes.
const ROWS_BYTES_MAX: usize = 8 << 20;
