//! Why a query has no result: the errors of a session.

use std::io::ErrorKind;

use datafusion::error::DataFusionError;

use crate::{
    control::StopReason,
    limits::{OPERATORS_MAX, SQL_BYTES_MAX},
};

/// Why a query has no result.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum QueryError {
    /// The text is not exactly one read-only query.
    #[error(
        "only questions are allowed here (SELECT, WITH, EXPLAIN, DESCRIBE, SHOW), one at a time: {reason}"
    )]
    ReadOnly { reason: String },
    /// The text is too long.
    #[error("the query has {bytes} bytes; the limit is {SQL_BYTES_MAX}")]
    TooLong { bytes: usize },
    /// The text nests too deep.
    #[error(
        "the query has {operators} operators; the limit is {OPERATORS_MAX}: for long lists use IN (...)"
    )]
    TooDeep { operators: usize },
    /// The query was cancelled or exceeded one of its limits.
    #[error("{0}")]
    Stopped(StopReason),
    /// A parameter is missing, unknown or no value.
    #[error("{0}")]
    Parameter(String),
    /// The store cannot be read.
    #[error(transparent)]
    Store(#[from] reel_tables::StoreError),
    /// The query is wrong, too large, or a file is damaged.
    #[error("{}", message(.0))]
    Engine(DataFusionError),
    /// The result cannot be shown.
    #[error("cannot show the result: {0}")]
    Arrow(#[from] arrow::error::ArrowError),
}

impl From<DataFusionError> for QueryError {
    fn from(error: DataFusionError) -> Self {
        if let DataFusionError::External(cause) = error.find_root()
            && let Some(stopped) = cause.downcast_ref::<StopReason>()
        {
            return QueryError::Stopped(stopped.clone());
        }
        QueryError::Engine(error)
    }
}

impl QueryError {
    /// Whether the system had no thread left, and the same query may
    /// succeed in a moment.
    pub fn is_of_the_system(&self) -> bool {
        match self {
            QueryError::Engine(error) => {
                matches!(error.find_root(), DataFusionError::IoError(cause) if cause.kind() == ErrorKind::WouldBlock)
            }
            _ => false,
        }
    }
}

/// The engine's own words, without its wrappers and its names for where the tables are.
pub(super) fn message(error: &DataFusionError) -> String {
    error
        .find_root()
        .strip_backtrace()
        .replace("datafusion.public.", "")
}
