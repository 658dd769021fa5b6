//! Traces to columnar tables: rows by [`episode_batch`], Delta Lake tables by [`Store`].
//!
//! Reads traces as they were recorded; never runs physics, never judges an episode (that is SQL's
//! job), and nobody outside `store` knows how the tables lie.

pub mod buckets;
mod rescore;
mod revisit;
mod rows;
pub mod schema;
mod store;
mod synthetic;

use arrow::array::RecordBatch;
use reel_trace::Trace;

pub use rescore::ScoredEpisode;
pub use rows::RowsError;
pub use schema::{Table, View, views};
pub use store::{
    AnswerLabelRow, AttributionRow, BLOCKING_THREADS, BlameRow, CheckedTrace, ClassRow, Commit,
    CompactReport, CounterfactualRow, DocumentSet, Finding, IngestReport, LabelRow, Location,
    Progress, RefutedClaim, RemarkRow, RescoreReport, RescoredEpisodes, STACK_BYTES, Stamp, Store,
    StoreError, TraceRows, TraceVerdict, VacuumReport,
};
pub use synthetic::synthesize;

/// The rows of some traces in [`Table::Episodes`], without a store.
///
/// # Errors
/// When Arrow refuses a value, e.g. a number too large for its column.
pub fn episode_batch(traces: &[Trace]) -> Result<RecordBatch, RowsError> {
    let mut rows = rows::Rows::new(Table::Episodes)?;
    traces
        .iter()
        .try_for_each(|trace| rows.push_episode(trace, 0))?;
    rows.finish()
}

/// The rows of a batch as structs; fields are found by name, and those that the struct
/// lacks are left out.
///
/// # Errors
/// When a column is missing, or does not fit its field.
pub fn rows_from<'a, R: serde::Deserialize<'a>>(
    batch: &'a RecordBatch,
) -> Result<Vec<R>, RowsError> {
    Ok(serde_arrow::from_record_batch(batch)?)
}
