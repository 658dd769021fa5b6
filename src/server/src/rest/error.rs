//! What a client is told when something does not work: a status, a code for programs,
//! a sentence for people.

use std::borrow::Cow;

use axum::{
    Json,
    http::{HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use reel_live::LiveError;
#[cfg(feature = "tables")]
use reel_query::{QueryError, SetLimit};
use reel_replay::Verdict;
#[cfg(feature = "tables")]
use reel_tables::StoreError;
use serde::Serialize;
use utoipa::ToSchema;

use crate::archive::Archive;

/// Why a request has no answer.
#[derive(Debug)]
pub(crate) struct ApiError {
    status: StatusCode,
    code: Cow<'static, str>,
    message: String,
}

/// An [`ApiError`] as one process tells it to another.
#[cfg(feature = "tables")]
#[derive(Serialize, serde::Deserialize)]
pub(crate) struct SentError {
    status: u16,
    code: String,
    message: String,
}

#[cfg(feature = "tables")]
impl From<ApiError> for SentError {
    fn from(error: ApiError) -> Self {
        Self {
            status: error.status.as_u16(),
            code: error.code.into_owned(),
            message: error.message,
        }
    }
}

#[cfg(feature = "tables")]
impl From<SentError> for ApiError {
    fn from(error: SentError) -> Self {
        Self {
            status: StatusCode::from_u16(error.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR),
            code: error.code.into(),
            message: error.message,
        }
    }
}

/// The body of every answer that is an error.
#[derive(Serialize, ToSchema)]
pub(crate) struct ErrorBody {
    error: ErrorDetail,
}

/// What went wrong, as a code for programs and a message for people.
#[derive(Serialize, ToSchema)]
pub(crate) struct ErrorDetail {
    /// Machine-readable code of the error, e.g. `not_found`.
    #[schema(example = "not_found")]
    code: String,
    /// For people: what, where, and what to do.
    message: String,
}

/// Code of an error that a limit on a question gave.
#[cfg(feature = "tables")]
pub(crate) const OVER_LIMIT: &str = "over_limit";

/// Code of an error of an episode that cannot be executed again.
const NOT_EXECUTED: &str = "not_executed";

impl ApiError {
    fn new(status: StatusCode, code: &'static str, message: impl Into<String>) -> Self {
        Self {
            status,
            code: code.into(),
            message: message.into(),
        }
    }

    /// Whether a limit on what a question may cost ended it.
    #[cfg(feature = "tables")]
    pub fn is_over_limit(&self) -> bool {
        self.code == OVER_LIMIT
    }

    /// The answer for an episode that cannot be executed again, with the verdict that says why.
    pub fn not_executed(verdict: &Verdict) -> Self {
        let message = format!("the episode cannot be executed again: {verdict}");
        Self::unprocessable(NOT_EXECUTED, message)
    }

    pub fn is_not_executed(&self) -> bool {
        self.code == NOT_EXECUTED
    }

    pub fn status(&self) -> StatusCode {
        self.status
    }

    pub fn bad_request(code: &'static str, message: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, code, message)
    }

    pub fn unauthorized(message: &str) -> Self {
        Self::new(StatusCode::UNAUTHORIZED, "no_token", message)
    }

    pub fn forbidden(code: &'static str, message: impl Into<String>) -> Self {
        Self::new(StatusCode::FORBIDDEN, code, message)
    }

    pub fn not_found(message: String) -> Self {
        Self::new(StatusCode::NOT_FOUND, "not_found", message)
    }

    pub fn not_allowed(message: String) -> Self {
        Self::new(
            StatusCode::METHOD_NOT_ALLOWED,
            "method_not_allowed",
            message,
        )
    }

    pub fn timeout(message: &str) -> Self {
        Self::new(StatusCode::REQUEST_TIMEOUT, "too_slow", message)
    }

    pub fn conflict(code: &'static str, message: String) -> Self {
        Self::new(StatusCode::CONFLICT, code, message)
    }

    pub fn too_large(message: String) -> Self {
        Self::new(StatusCode::PAYLOAD_TOO_LARGE, "too_large", message)
    }

    pub fn not_satisfiable(message: String) -> Self {
        Self::new(StatusCode::RANGE_NOT_SATISFIABLE, "out_of_range", message)
    }

    pub fn unprocessable(code: &'static str, message: String) -> Self {
        Self::new(StatusCode::UNPROCESSABLE_ENTITY, code, message)
    }

    pub fn too_many(message: &str) -> Self {
        Self::new(StatusCode::TOO_MANY_REQUESTS, "too_many", message)
    }

    pub fn busy(message: impl Into<String>) -> Self {
        Self::new(StatusCode::SERVICE_UNAVAILABLE, "busy", message)
    }

    pub fn internal(message: &str) -> Self {
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, "internal", message)
    }

    /// What a person reads.
    pub fn message(&self) -> &str {
        &self.message
    }

    /// The same error in other words.
    pub fn with_message(self, message: String) -> Self {
        Self { message, ..self }
    }

    /// The same without the way to the data folder.
    pub fn with_path_redacted(mut self, archive: &Archive) -> Self {
        self.message = archive.redact_path(&self.message);
        self
    }

    /// Logs a failed disk operation and makes an error with status 507.
    pub fn disk(error: std::io::Error) -> Self {
        tracing::error!(%error, "disk error");
        let (code, cause) = of_disk(&error);
        Self::new(
            StatusCode::INSUFFICIENT_STORAGE,
            code,
            format!("disk error: {cause}"),
        )
    }

    /// The folder of traces takes nothing, so no episode can be recorded.
    pub fn records_nothing(error: &std::io::Error) -> Self {
        tracing::error!(%error, "the folder of traces cannot be written");
        let (code, cause) = of_disk(error);
        Self::new(
            StatusCode::SERVICE_UNAVAILABLE,
            code,
            format!("no episode can be recorded: the folder of traces cannot be written: {cause}"),
        )
    }
}

/// Code and words of a disk error, without the path that some have in theirs.
fn of_disk(error: &std::io::Error) -> (&'static str, String) {
    let full = error.kind() == std::io::ErrorKind::StorageFull;
    let cause = error.raw_os_error().map_or_else(
        || error.kind().to_string(),
        |code| std::io::Error::from_raw_os_error(code).to_string(),
    );
    (if full { "disk_full" } else { "disk" }, cause)
}

impl std::fmt::Display for ApiError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.message)
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let body = ErrorBody {
            error: ErrorDetail {
                code: self.code.into_owned(),
                message: self.message,
            },
        };
        let mut response = (self.status, Json(body)).into_response();
        let headers = response.headers_mut();
        match self.status {
            StatusCode::UNAUTHORIZED => {
                headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
            }
            StatusCode::TOO_MANY_REQUESTS | StatusCode::SERVICE_UNAVAILABLE => {
                headers.insert(header::RETRY_AFTER, HeaderValue::from_static("1"));
            }
            // What is left of a body that was too much is not read.
            StatusCode::PAYLOAD_TOO_LARGE | StatusCode::REQUEST_TIMEOUT => {
                headers.insert(header::CONNECTION, HeaderValue::from_static("close"));
            }
            _ => {}
        }
        response
    }
}

impl From<LiveError> for ApiError {
    fn from(error: LiveError) -> Self {
        let message = error.to_string();
        match error {
            LiveError::Unknown(_) => Self::not_found(message),
            LiveError::Name(_) => Self::bad_request("bad_name", message),
            LiveError::UnknownTask(_) => Self::unprocessable("unknown_task", message),
            LiveError::OtherOwner(_) => Self::forbidden("owner", message),
            LiveError::Quota { .. } => Self::new(StatusCode::TOO_MANY_REQUESTS, "quota", message),
            LiveError::Taken(_) => Self::conflict("taken", message),
            LiveError::Overtaken => Self::conflict("overtaken", message),
            LiveError::Branch(_) => Self::unprocessable("bad_branch", message),
            LiveError::NoEpisode | LiveError::Over(_) | LiveError::Broken(_) => {
                Self::conflict("no_episode", message)
            }
            LiveError::Full(_)
            | LiveError::Busy(_)
            | LiveError::NoLookUp
            | LiveError::NoUser
            | LiveError::Closing => Self::busy(message),
            LiveError::Folder { source, .. } => Self::disk(source),
            LiveError::Recording(_) => Self::new(StatusCode::INSUFFICIENT_STORAGE, "disk", message),
            LiveError::Episode(_) => Self::internal("the episode cannot go on; the log says why"),
        }
    }
}

#[cfg(feature = "tables")]
impl From<StoreError> for ApiError {
    fn from(error: StoreError) -> Self {
        let message = match error {
            StoreError::NoStore { .. } => {
                "there are no tables yet; a job of kind 'ingest' makes them".to_owned()
            }
            StoreError::NoVersion {
                version, newest, ..
            } => format!("unknown version {version} of the tables; the newest is {newest}"),
            StoreError::Missing { version, .. } => {
                format!(
                    "version {version} of the tables needs a file that is gone; ask for a newer one"
                )
            }
            StoreError::OtherColumns { table, .. } => {
                format!(
                    "table '{table}' is of another version of Reel; the server needs new tables"
                )
            }
            other => {
                tracing::error!(error = %other, "the tables cannot be read");
                "the tables cannot be read; the log has the details".to_owned()
            }
        };
        Self::not_found(message)
    }
}

#[cfg(feature = "tables")]
impl From<QueryError> for ApiError {
    fn from(error: QueryError) -> Self {
        let message = error.to_string();
        match error {
            QueryError::Store(error) => error.into(),
            QueryError::Stopped(reason) => {
                let message = match reason.limit() {
                    Some(SetLimit::Time) => format!("{message} (limits.sql_timeout_s)"),
                    Some(SetLimit::Memory) => format!("{message} (limits.sql_mib)"),
                    Some(SetLimit::Rows) => format!("{message} (limits.sql_rows)"),
                    None => message,
                };
                Self::unprocessable(OVER_LIMIT, message)
            }
            QueryError::ReadOnly { .. } => Self::unprocessable("read_only", message),
            error if error.is_of_the_system() => {
                Self::busy(format!("{message}; try again in a moment"))
            }
            _ => Self::unprocessable("bad_query", message),
        }
    }
}
