//! What steers a running query from outside: stopping it, and hearing how far
//! its slow functions are.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
    sync::{
        Mutex, OnceLock, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
};

use datafusion::error::DataFusionError;
use reel_tables::TraceVerdict;
use reel_trace::{TraceFiles, is_remote};
use reel_world::Digest;

use crate::functions::simulator::ReplayRow;

/// Why a query was stopped before its end.
#[derive(Clone, PartialEq, Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum StopReason {
    /// Somebody asked for it.
    #[error("stopped; nothing was changed")]
    Cancelled,
    /// It took too long.
    #[error("stopped after {seconds} s, the limit on time; narrow the question down")]
    Time {
        /// Time limit of the query, in seconds.
        seconds: u64,
    },
    /// It took too much memory.
    #[error("stopped at {bytes} bytes, the limit on memory; narrow the question down")]
    Memory {
        /// Limit on the growth of the process's memory, in bytes.
        bytes: usize,
    },
    /// Its answer is too long.
    #[error("stopped at {rows} rows, the limit on answers; add a LIMIT or aggregate")]
    Rows { rows: usize },
    /// It would pair more rows than anyone waits for.
    #[error(
        "not started: a join without a key would make about {rows:.0e} rows; say by which columns the tables belong together (JOIN ... USING)"
    )]
    Estimate {
        /// Rows that the join would make, as an estimate.
        rows: f64,
    },
    /// Two texts would be compared character by character for too long.
    #[error(
        "'{function}' would compare {characters} pairs of characters at once; the limit is {limit}: take parts of the texts with left(text, n)"
    )]
    Comparisons {
        function: String,
        /// Pairs of characters of one batch of rows.
        characters: u128,
        /// Most pairs of characters that one batch may compare.
        limit: u128,
    },
    /// A function would make too much of one batch.
    #[error("'{function}' would make {bytes} bytes of one batch of rows; the limit is {limit}")]
    Batch {
        function: String,
        /// Size of what it would make, in bytes.
        bytes: u128,
        /// Most bytes of one batch.
        limit: u128,
    },
    /// An aggregate would be computed anew for every row.
    #[error(
        "not started: '{function}' works through all rows of a window for each row, which is allowed where the window is known to have at most {limit} rows; aggregate by groups instead"
    )]
    Window {
        function: String,
        /// Most rows of what the window moves over.
        limit: u64,
    },
    /// Its subqueries repeat each other without end.
    #[error(
        "not started: written out, the query has {reads} subqueries and tables; the limit is {limit}"
    )]
    Expansion {
        /// Subqueries and tables once every name stands for its query.
        reads: u64,
        /// Most subqueries and tables that a question may come to.
        limit: u64,
    },
    /// Its conditions hold subqueries that hold subqueries, and so on.
    #[error(
        "not started: subqueries in conditions stand {depth} deep in each other; the limit is {limit}: join the tables instead"
    )]
    Nesting {
        /// How deep the innermost subquery stands.
        depth: usize,
        /// Most subqueries that may stand in each other.
        limit: usize,
    },
    /// A value that no question needs.
    #[error("'{function}' would make {bytes} bytes for one row; the limit is {limit}")]
    Value {
        function: String,
        /// Size that the value would have, in bytes.
        bytes: u128,
        /// Largest size of a value for one row, in bytes.
        limit: u128,
    },
}

/// A limit that whoever runs the engine sets; only they know what it is called there.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SetLimit {
    /// The limit on wall-clock time, [`Limits::time`](crate::Limits::time).
    Time,
    /// Memory of the process: [`Limits::memory_bytes`](crate::Limits::memory_bytes).
    Memory,
    /// Rows of the answer: [`Limits::rows`](crate::Limits::rows).
    Rows,
}

impl StopReason {
    /// The limit that was reached; none where nobody set one.
    pub fn limit(&self) -> Option<SetLimit> {
        match self {
            StopReason::Time { .. } => Some(SetLimit::Time),
            StopReason::Memory { .. } => Some(SetLimit::Memory),
            StopReason::Rows { .. } => Some(SetLimit::Rows),
            _ => None,
        }
    }
}

/// Which traces functions may open.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum TraceAccess {
    /// None at all: the plans of this process run elsewhere.
    Nothing,
    /// Those that a store names, as it names them.
    These(BTreeSet<String>),
    /// Those in folders, and those at places in buckets. Links and `..` do not lead out of them.
    Below(Vec<PathBuf>),
}

impl TraceAccess {
    /// Whether a trace may be opened.
    pub fn allows(&self, trace: &Path) -> bool {
        match self {
            TraceAccess::Nothing => false,
            TraceAccess::These(traces) => traces.contains(&*trace.to_string_lossy()),
            TraceAccess::Below(folders) if is_remote(trace) => {
                let (name, inside) = (trace.to_string_lossy(), |folder: &PathBuf| {
                    trace.starts_with(folder) && is_remote(folder)
                });
                name.split('/').all(|part| part != "..") && folders.iter().any(inside)
            }
            TraceAccess::Below(folders) => {
                let real = |path: &Path| path.canonicalize().ok();
                real(trace).is_some_and(|trace| {
                    folders
                        .iter()
                        .any(|folder| real(folder).is_some_and(|folder| trace.starts_with(folder)))
                })
            }
        }
    }
}

/// Shared between a session, its functions and whoever wants to stop it.
#[derive(Debug, Default)]
pub struct Control {
    cancelled: AtomicBool,
    /// Queries that were begun: what is left of an earlier one does not go on with the next.
    begun: AtomicU64,
    simulated: AtomicU64,
    /// Traces that functions may open.
    traces: OnceLock<TraceAccess>,
    /// Where functions read traces from.
    pub(crate) files: TraceFiles,
    /// What `replay` said, by the digest of the file.
    pub(crate) verdicts: Mutex<BTreeMap<Digest, ReplayRow>>,
    /// Verdicts of `replay` that the store does not have yet.
    new_verdicts: Mutex<Vec<TraceVerdict>>,
}

impl Control {
    pub(crate) fn new(files: TraceFiles) -> Self {
        Self {
            files,
            ..Self::default()
        }
    }

    /// Stops what runs, as soon as it looks.
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }

    /// Another query begins: what stopped the last one does not stop this.
    pub(crate) fn begin(&self) {
        self.begun.fetch_add(1, Ordering::Relaxed);
        self.cancelled.store(false, Ordering::Relaxed);
        self.simulated.store(0, Ordering::Relaxed);
    }

    /// How many traces the simulator functions have worked off.
    pub fn simulated(&self) -> u64 {
        self.simulated.load(Ordering::Relaxed)
    }

    pub(crate) fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }

    pub(crate) fn check(&self) -> Result<(), DataFusionError> {
        if self.is_cancelled() {
            Err(DataFusionError::External(Box::new(StopReason::Cancelled)))
        } else {
            Ok(())
        }
    }

    /// Number of the query that runs.
    pub(crate) fn query(&self) -> u64 {
        self.begun.load(Ordering::Relaxed)
    }

    /// Whether a query goes on: nobody stopped it, and no other one was begun since.
    pub(crate) fn check_query(&self, query: u64) -> Result<(), DataFusionError> {
        if self.query() != query {
            return Err(DataFusionError::External(Box::new(StopReason::Cancelled)));
        }
        self.check()
    }

    pub(crate) fn count_simulated(&self) {
        self.simulated.fetch_add(1, Ordering::Relaxed);
    }

    /// Keeps a verdict for the store.
    pub(crate) fn keep(&self, verdict: TraceVerdict) {
        self.new_verdicts
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(verdict);
    }

    /// The verdicts since this was asked last.
    pub(crate) fn take_verdicts(&self) -> Vec<TraceVerdict> {
        let mut new = self
            .new_verdicts
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        std::mem::take(&mut *new)
    }

    pub(crate) fn allow(&self, traces: TraceAccess) {
        self.traces.get_or_init(|| traces);
    }

    pub(crate) fn knows_traces(&self) -> bool {
        self.traces.get().is_some()
    }

    pub(crate) fn allowed(&self, path: &Path) -> bool {
        self.traces.get().is_some_and(|opens| opens.allows(path))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn executors_open_what_lies_below_their_folders_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let (inside, outside) = (folder.path().join("traces"), folder.path().join("secrets"));
        for folder in [&inside, &outside] {
            std::fs::create_dir(folder).unwrap();
            std::fs::write(folder.join("a.mcap"), "").unwrap();
        }
        std::os::unix::fs::symlink(&outside, inside.join("out")).unwrap();
        let opens = TraceAccess::Below(vec![inside.clone(), "s3://lab/traces".into()]);
        assert!(
            opens.allows(&inside.join("a.mcap"))
                && opens.allows(Path::new("s3://lab/traces/one/a.mcap"))
        );
        let refused = [
            outside.join("a.mcap"),
            inside.join("../secrets/a.mcap"),
            inside.join("out/a.mcap"),
            inside.join("absent.mcap"),
            "s3://lab/traces-of-others/a.mcap".into(),
            "s3://lab/traces/../secrets/a.mcap".into(),
            "s3://other/traces/a.mcap".into(),
        ];
        for path in refused {
            assert!(!opens.allows(&path), "{}", path.display());
        }
        assert!(!TraceAccess::Nothing.allows(&inside.join("a.mcap")));
    }
}
