//! The store: Delta Lake tables in one folder or bucket, and the one log that binds them.
//!
//! Every table is a Delta table of its own, which any reader of Delta Lake can open. What makes
//! them one store is the log of `episodes`: each of its commits names, as Delta application
//! transactions, the version of every other table that belongs to it. A reader opens `episodes` at
//! a version and the others at the versions named there, so that it never sees half of an ingest;
//! two writers that commit at a time conflict on those names, and the later one looks again and
//! repeats. `verdicts` and `contradictions` hang on no version. Nobody outside this folder knows
//! how the tables lie.

mod contents;
mod ingest;
mod judgements;
mod location;
mod maintenance;
mod opening;
mod parts;
mod reading;
mod rescored;
mod unbound;

use std::{collections::BTreeMap, ffi::OsStr, io, path::PathBuf, sync::Arc};

use arrow::error::ArrowError;
use deltalake::{
    DeltaTable, DeltaTableError,
    kernel::transaction::{CommitBuilder, CommitConflictError, TransactionError},
    kernel::{Action, Transaction, transaction::CommitProperties},
    protocol::{DeltaOperation, SaveMode},
};
use object_store::{ObjectMeta, ObjectStore, ObjectStoreExt as _};
use parquet::errors::ParquetError;
use reel_trace::TraceFiles;
use serde::Serialize;
use tokio::runtime::{Builder, Runtime};
use url::Url;

pub use ingest::{IngestReport, Progress};
pub use judgements::{
    AnswerLabelRow, AttributionRow, BlameRow, ClassRow, CounterfactualRow, Finding, LabelRow,
    RemarkRow,
};
pub use location::Location;
pub use maintenance::{CompactReport, VacuumReport};
pub use reading::{DocumentSet, TraceRows};
pub use rescored::{RescoreReport, RescoredEpisodes};
pub use unbound::{CheckedTrace, RefutedClaim, TraceVerdict};

use crate::Table;
use opening::{added_columns, create, load, open};

/// Tables that hang on `episodes`, in the order in which they are committed before it.
const SIDE: [Table; 11] = [
    Table::Tasks,
    Table::Scenes,
    Table::Rescored,
    Table::Quarantine,
    Table::Classes,
    Table::Blame,
    Table::Attribution,
    Table::Labels,
    Table::AnswerLabels,
    Table::Remarks,
    Table::Counterfactuals,
];

/// Tables that stores of version 0.2.0 do not have; the next ingest makes them.
const ADDED_LATER: [Table; 3] = [Table::Attribution, Table::Remarks, Table::Counterfactuals];

/// Tables that are bound to no version.
const UNBOUND: [Table; 2] = [Table::Verdicts, Table::Contradictions];

/// Stack of the threads that plan and run queries, in bytes: deep expressions
/// are walked by recursion.
pub const STACK_BYTES: usize = 64 << 20;
/// Most threads of a store that wait for files at a time, each with such a stack.
pub const BLOCKING_THREADS: usize = 16;

/// How often a writer looks again after others were quicker.
const TRIES_MAX: u32 = 100;

/// The tables of a store at one version.
pub struct Store {
    location: Location,
    runtime: Arc<Runtime>,
    tables: BTreeMap<Table, DeltaTable>,
    trace_files: TraceFiles,
}

/// The commits by which a store sees what it sees ([`Store::stamp`]): of another store in the same
/// place they are others.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Stamp(Vec<ObjectMeta>);

/// A version of a store.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct Commit {
    /// Its number: that of the Delta table `episodes`.
    pub version: u64,
    /// When it was written, milliseconds since 1970.
    pub timestamp_ms: Option<i64>,
    /// What Delta Lake calls what was done, e.g. `WRITE`, `OPTIMIZE`.
    pub operation: String,
}

/// Why the store cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum StoreError {
    /// The location holds no store; `reel ingest` creates one.
    #[error("no tables here; fill them with `reel ingest`: {location}")]
    NoStore { location: String },
    /// The store does not have the version that was asked for.
    #[error("unknown version {version}, the newest is {newest}: {location}")]
    NoVersion {
        version: u64,
        newest: u64,
        location: String,
    },
    /// A file of this version is gone.
    #[error(
        "version {version} needs a missing file, perhaps vacuumed: {file}; open another version or ingest the traces into a new store: {location}"
    )]
    Missing {
        version: u64,
        /// Name of the table and path of the missing file, as `table/file`.
        file: String,
        location: String,
    },
    /// The location cannot be understood or reached.
    #[error("cannot use this store: {reason}: {location}")]
    Location { reason: String, location: String },
    /// The columns are not those of this version of Reel.
    #[error(
        "table '{table}' has the columns of another version of Reel: {location}; ingest the traces into a new store with `reel ingest TRACES --store NEW`"
    )]
    OtherColumns {
        table: &'static str,
        location: String,
    },
    /// Others wrote all the time.
    #[error(
        "gave up after {tries} tries, because other writers keep changing the store; nothing was written, try again: {location}"
    )]
    Busy { tries: u32, location: String },
    /// A file or folder cannot be read or written.
    #[error("cannot {action}: {source}: {path}", path = path.display())]
    Io {
        /// The action that failed, as words for the message, e.g. `make the folder`.
        action: &'static str,
        source: io::Error,
        /// The file or folder; empty if the threads could not be started.
        path: PathBuf,
    },
    /// Delta Lake or the object store fails.
    #[error("the tables cannot be read or written: {source}: {location}")]
    Delta {
        source: Box<DeltaTableError>,
        location: String,
    },
    /// A Parquet file cannot be read or written.
    #[error("part of a table: {source}: {path}")]
    Parquet { source: ParquetError, path: String },
    /// A task or scene in the tables is none.
    #[error(
        "the {problem} in the tables is damaged: {reason}; ingest the traces into a new store: {digest}"
    )]
    Document {
        /// Which kind of document is damaged: `task` or `scene`.
        problem: &'static str,
        digest: String,
        reason: String,
    },
    /// Rows that came from another machine are none.
    #[error(
        "rows that another machine read cannot be used: {reason}; both have to be the same build of reel"
    )]
    Wire { reason: String },
    /// Columns of different parts do not fit together.
    #[error("rows of the tables: {0}")]
    Arrow(#[from] ArrowError),
    /// A row does not fit its columns.
    #[error("rows of the tables: {0}")]
    Rows(#[from] crate::RowsError),
}

/// A commit did not come about.
enum Refused {
    /// Somebody else was quicker: look again.
    Conflict,
    /// It cannot be done.
    Failed(StoreError),
}

impl From<StoreError> for Refused {
    fn from(error: StoreError) -> Self {
        Refused::Failed(error)
    }
}

impl From<ArrowError> for Refused {
    fn from(error: ArrowError) -> Self {
        Refused::Failed(error.into())
    }
}

impl Store {
    /// Opens the newest version of a store: a folder, or `s3://bucket/folder`
    /// ([`Location::parse`]).
    ///
    /// # Errors
    /// When there is none, or it is damaged or of another version of Reel.
    pub fn open(location: impl AsRef<OsStr>) -> Result<Self, StoreError> {
        Self::load(
            Location::parse(&location.as_ref().to_string_lossy())?,
            runtime()?,
            None,
        )
    }

    /// Opens an earlier version.
    ///
    /// # Errors
    /// As [`Store::open`], and when there is no such version, or its files were vacuumed.
    pub fn open_at(location: impl AsRef<OsStr>, version: u64) -> Result<Self, StoreError> {
        Self::load(
            Location::parse(&location.as_ref().to_string_lossy())?,
            runtime()?,
            Some(version),
        )
    }

    /// Opens a store, or makes an empty one where there is none.
    ///
    /// # Errors
    /// When it cannot be made, or the store is damaged or of another version of Reel.
    pub fn open_or_create(location: impl AsRef<OsStr>) -> Result<Self, StoreError> {
        Self::at(Location::parse(&location.as_ref().to_string_lossy())?, None)
    }

    /// Opens or makes the store at a location: [`Store::open_or_create`], or
    /// [`Store::open_at`] with a version.
    ///
    /// # Errors
    /// As those.
    pub fn at(location: Location, version: Option<u64>) -> Result<Self, StoreError> {
        let runtime = runtime()?;
        if version.is_none() {
            location.prepare()?;
            runtime.block_on(create(&location))?;
        }
        Self::load(location, runtime, version)
    }

    /// The number of this version.
    pub fn version(&self) -> u64 {
        self.tables[&Table::Episodes].version().unwrap_or_default()
    }

    /// Reads the traces that its rows name from `files`, not only from this machine.
    #[must_use]
    pub fn with_trace_files(mut self, files: TraceFiles) -> Self {
        self.trace_files = files;
        self
    }

    /// Where the traces that its rows name are read from.
    pub fn trace_files(&self) -> &TraceFiles {
        &self.trace_files
    }

    /// The same version once more, with threads of its own: what hangs in one is not waited
    /// for in the other.
    ///
    /// # Errors
    /// When the system refuses threads.
    pub fn reopen(&self) -> Result<Self, StoreError> {
        Ok(Self {
            location: self.location.clone(),
            runtime: runtime()?,
            tables: self.tables.clone(),
            trace_files: self.trace_files.clone(),
        })
    }

    /// By which commits the store sees what it sees; none where somebody has committed since. While
    /// it stays the same, there is nothing new to open.
    ///
    /// # Errors
    /// When the place cannot be reached.
    pub fn stamp(&self) -> Result<Option<Stamp>, StoreError> {
        let mut commits = Vec::new();
        // The other tables go by a commit of `episodes`.
        for table in [Table::Episodes].into_iter().chain(UNBOUND) {
            let version = self.tables[&table].version().unwrap_or_default();
            let commit = |version| {
                self.runtime
                    .block_on(self.location.commit(table.name(), version))
            };
            match (commit(version)?, commit(version + 1)?) {
                (Some(commit), None) => commits.push(commit),
                _ => return Ok(None),
            }
        }
        Ok(Some(Stamp(commits)))
    }

    /// The versions there are, the newest first.
    ///
    /// # Errors
    /// When the log cannot be read.
    pub fn history(&self) -> Result<Vec<Commit>, StoreError> {
        use futures_util::TryStreamExt as _;

        let table = &self.tables[&Table::Episodes];
        let commits: Vec<_> = self.wait(table.history(None).try_collect())?;
        let newest = self.version();
        let commit = |(back, commit): (usize, deltalake::kernel::CommitInfo)| Commit {
            version: newest - back as u64,
            timestamp_ms: commit.timestamp,
            operation: commit.operation.unwrap_or_default(),
        };
        Ok(commits.into_iter().enumerate().map(commit).collect())
    }

    /// URLs of the Parquet files of a table. [`Store::objects`] reads them.
    pub fn files(&self, table: Table) -> Vec<Url> {
        let root = self.location.table_url(table.name());
        self.parts(table)
            .into_iter()
            .map(|part| root.join(&part.path).unwrap_or_else(|_| root.clone()))
            .collect()
    }

    /// Looks whether the files of this version are there: a vacuum may have deleted what
    /// an earlier version needs.
    ///
    /// # Errors
    /// The first file that is missing.
    pub fn check_files(&self) -> Result<(), StoreError> {
        for (table, opened) in &self.tables {
            let objects = opened.log_store().object_store(None);
            for part in self.parts(*table) {
                match self
                    .runtime
                    .block_on(objects.head(&part.path.as_str().into()))
                {
                    Ok(_) => {}
                    Err(object_store::Error::NotFound { .. }) => {
                        let file = format!("{}/{}", table.name(), part.path);
                        return Err(StoreError::Missing {
                            version: self.version(),
                            file,
                            location: self.location.to_string(),
                        });
                    }
                    Err(error) => return Err(self.delta(error.into())),
                }
            }
        }
        Ok(())
    }

    /// The file system or bucket in which the files lie, and its URL.
    pub fn objects(&self) -> (Url, Arc<dyn ObjectStore>) {
        self.location.objects()
    }

    /// Where it lies, as it was given.
    pub fn location(&self) -> &Location {
        &self.location
    }

    /// Runs the store's reading and writing; queries use it too.
    pub fn runtime(&self) -> Arc<Runtime> {
        self.runtime.clone()
    }

    /// Adds rows that were made up, in one commit, to a store that has no episodes of the same ids.
    pub(crate) fn append(
        &mut self,
        table: Table,
        batches: Vec<arrow::array::RecordBatch>,
    ) -> Result<(), StoreError> {
        let actions = self.write_parts(&self.tables[&table], batches)?;
        let written = match table {
            Table::Episodes => self.commit_episodes(actions, &BTreeMap::new()),
            _ => self
                .commit_side(&self.tables[&table], actions)
                .and_then(|version| {
                    self.commit_episodes(Vec::new(), &BTreeMap::from([(table, version)]))
                }),
        };
        match written {
            Ok(_) => self.reload(),
            Err(Refused::Failed(error)) => Err(error),
            Err(Refused::Conflict) => Err(StoreError::Busy {
                tries: 1,
                location: self.location.to_string(),
            }),
        }
    }

    fn load(
        location: Location,
        runtime: Arc<Runtime>,
        version: Option<u64>,
    ) -> Result<Self, StoreError> {
        let tables = runtime.block_on(load(&location, version))?;
        Ok(Self {
            location,
            runtime,
            tables,
            trace_files: TraceFiles::default(),
        })
    }

    /// Looks what is there now.
    fn reload(&mut self) -> Result<(), StoreError> {
        self.tables = self.runtime.block_on(load(&self.location, None))?;
        Ok(())
    }

    /// The newest state of a side table, also what no commit of `episodes` names yet.
    fn newest(&self, table: Table) -> Result<DeltaTable, StoreError> {
        self.runtime.block_on(open(&self.location, table, None))
    }

    /// [`Store::newest`] to write to: with the columns that an earlier version of Reel did not have.
    fn newest_to_write(&self, table: Table) -> Result<DeltaTable, Refused> {
        let newest = self.newest(table)?;
        let schema = newest
            .snapshot()
            .map_err(|error| self.delta(error))?
            .schema();
        let added = added_columns(&schema, table).map_err(|error| self.delta(error.into()))?;
        match added {
            Some(added) if !added.is_empty() => {
                self.committed(newest.add_columns().with_fields(added).into_future())
            }
            _ => Ok(newest),
        }
    }

    /// Commits to a side table that was just looked at, and says its new version.
    fn commit_side(&self, table: &DeltaTable, actions: Vec<Action>) -> Result<u64, Refused> {
        let version = table.version().unwrap_or_default() as i64 + 1;
        self.commit(table, actions, vec![Transaction::new(WRITER, version)])
    }

    /// Commits to `episodes` with the versions of the side tables that belong to it: those that are
    /// named here, else as they were. What was committed is not loaded.
    fn commit_episodes(
        &self,
        actions: Vec<Action>,
        moved: &BTreeMap<Table, u64>,
    ) -> Result<u64, Refused> {
        let version = |table: Table| {
            moved
                .get(&table)
                .copied()
                .unwrap_or_else(|| self.tables[&table].version().unwrap_or_default())
        };
        let names = SIDE
            .map(|table| Transaction::new(table.name(), version(table) as i64))
            .to_vec();
        self.commit(&self.tables[&Table::Episodes], actions, names)
    }

    fn commit(
        &self,
        table: &DeltaTable,
        actions: Vec<Action>,
        names: Vec<Transaction>,
    ) -> Result<u64, Refused> {
        let state = table.snapshot().map_err(|error| self.delta(error))?;
        let properties = CommitProperties::default().with_application_transactions(names);
        let operation = DeltaOperation::Write {
            mode: SaveMode::Append,
            partition_by: None,
            predicate: None,
        };
        let commit = CommitBuilder::from(properties).with_actions(actions).build(
            Some(state),
            table.log_store(),
            operation,
        );
        Ok(self.committed(commit.into_future())?.version())
    }

    /// Waits for a commit.
    fn committed<T>(
        &self,
        commit: impl Future<Output = Result<T, DeltaTableError>>,
    ) -> Result<T, Refused> {
        match self.runtime.block_on(commit) {
            Ok(done) => Ok(done),
            Err(error) if is_conflict(&error) => Err(Refused::Conflict),
            Err(error) => Err(self.delta(error).into()),
        }
    }

    /// Waits for Delta Lake.
    fn wait<T>(
        &self,
        future: impl Future<Output = Result<T, DeltaTableError>>,
    ) -> Result<T, StoreError> {
        self.runtime
            .block_on(future)
            .map_err(|error| self.delta(error))
    }

    fn delta(&self, source: DeltaTableError) -> StoreError {
        StoreError::Delta {
            source: Box::new(source),
            location: self.location.to_string(),
        }
    }
}

impl std::fmt::Debug for Store {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Store")
            .field("location", &self.location)
            .field("version", &self.version())
            .finish_non_exhaustive()
    }
}

/// Name under which writers of a side table conflict.
const WRITER: &str = "reel";

/// Tasks that a thread runs before it looks at clocks and at what came from other threads. Where a
/// sort leaves a task for each of a thousand batches, milliseconds each, the default of 61 would
/// hear of the end of a query's time seconds later.
const EVENT_INTERVAL: u32 = 4;

fn runtime() -> Result<Arc<Runtime>, StoreError> {
    let io_error = |source| StoreError::Io {
        action: "start threads",
        source,
        path: PathBuf::new(),
    };
    Ok(Arc::new(
        Builder::new_multi_thread()
            .enable_all()
            .thread_stack_size(STACK_BYTES)
            .max_blocking_threads(BLOCKING_THREADS)
            .event_interval(EVENT_INTERVAL)
            .global_queue_interval(EVENT_INTERVAL)
            .build()
            .map_err(io_error)?,
    ))
}

/// Whether somebody else wrote in between.
fn is_conflict(error: &DeltaTableError) -> bool {
    let conflict = |error: &TransactionError| match error {
        TransactionError::CommitConflict(conflict) => matches!(
            conflict,
            CommitConflictError::ConcurrentTransaction
                | CommitConflictError::ConcurrentAppend
                | CommitConflictError::ConcurrentDeleteRead
                | CommitConflictError::ConcurrentDeleteDelete
                | CommitConflictError::MetadataChanged
        ),
        TransactionError::MaxCommitAttempts(_) | TransactionError::VersionAlreadyExists(_) => true,
        _ => false,
    };
    match error {
        DeltaTableError::Transaction { source } => conflict(source),
        DeltaTableError::VersionAlreadyExists(_) => true,
        _ => false,
    }
}
