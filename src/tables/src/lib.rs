//! Traces to columnar tables: rows by [`batches`], files on disk by [`Store`].
//!
//! Reads traces as they were recorded; never runs physics, never judges an episode (that is SQL's job), and nobody
//! outside `store` knows how the tables lie on disk.

mod rows;
pub mod schema;
mod store;

use std::collections::{BTreeMap, BTreeSet};

use arrow::{array::RecordBatch, compute::concat_batches, error::ArrowError};
use reel_trace::Trace;

pub use schema::Table;
pub use store::{IngestReport, Progress, Store, StoreError};

/// One batch a table; every table is there, if only with its columns.
pub type Tables = BTreeMap<Table, RecordBatch>;

/// The rows of some traces; a task that several of them play stands there once.
///
/// # Errors
/// When Arrow refuses a value, e.g. a number too large for its column.
pub fn batches(traces: &[Trace]) -> Result<Tables, ArrowError> {
    let each = traces.iter().map(one).collect::<Result<Vec<_>, _>>()?;
    let mut known = BTreeSet::new();
    let parts: Vec<_> = traces.iter().map(|trace| known.insert(trace.header.task_digest)).zip(each).collect();
    joined(&parts)
}

/// The rows of one trace.
fn one(trace: &Trace) -> Result<Tables, ArrowError> {
    Table::ALL.into_iter().map(|table| Ok((table, rows::batch(trace, table)?))).collect()
}

/// Rows of several traces in order; each says whether its task is new.
fn joined(parts: &[(bool, Tables)]) -> Result<Tables, ArrowError> {
    let table = |table: Table| {
        let wanted = parts.iter().filter(|(new_task, _)| *new_task || !table.is_by_task());
        let batches: Vec<&RecordBatch> = wanted.map(|(_, tables)| &tables[&table]).collect();
        Ok((table, concat_batches(&table.schema(), batches)?))
    };
    Table::ALL.into_iter().map(table).collect()
}
