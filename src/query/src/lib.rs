//! SQL over the tables of a store, read-only: the tables, their flat views, every named query as a
//! view, and functions of our own over sequences, statistics and the simulator.
//!
//! DataFusion stays in here: batches of Arrow go out. Never writes, never reads a file that is not
//! the store's or, by the functions that take one, a trace that the store names.

pub mod claim;
mod control;
mod estimate;
pub mod format;
mod functions;
mod fusion;
mod limits;
pub mod named;
mod partition;
pub mod pattern;
mod planning;
mod session;
mod sort_keys;
mod tables;
mod watched;

use arrow::{
    array::{ArrayRef, RecordBatch},
    datatypes::DataType,
};
use reel_tables::Store;

pub use control::{Control, SetLimit, StopReason, TraceAccess};
pub use format::{Format, ParquetStream, arrow_file, format, parquet_file};
pub use functions::{FunctionHelp, help as functions};
pub use fusion::{RowExpression, fuse};
pub use limits::Limits;
pub use reel_tables::STACK_BYTES;
pub use session::{
    CacheScope, EngineFactory, Parameters, QueryError, QuerySession, every_function,
};

/// Runs one query over a store.
///
/// # Errors
/// When it is no question, is wrong, or exceeds a limit.
pub fn run(store: Store, sql: &str) -> Result<Vec<RecordBatch>, QueryError> {
    QuerySession::new(store)?.run(sql)
}

/// Applies one of the functions on sequences (`sequence_match`, `first_step`, ...) to a column of
/// steps, a list of records an episode, outside of any question.
///
/// # Errors
/// When there is no such function, the column holds no steps, or the text is wrong.
pub fn apply_to_steps(
    function: &str,
    steps: &ArrayRef,
    text: Option<&str>,
) -> Result<ArrayRef, QueryError> {
    Ok(functions::sequence::apply(function, steps, text)?)
}

/// The type of what one of the functions on sequences gives for a column of steps of that type.
///
/// # Errors
/// When there is no such function, or the column holds no steps.
pub fn type_over_steps(function: &str, steps: &DataType) -> Result<DataType, QueryError> {
    Ok(functions::sequence::type_over(function, steps)?)
}
