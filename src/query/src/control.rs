//! What steers a running query from outside: stopping it, and hearing how far its slow functions are.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
    sync::{
        Mutex, OnceLock,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
};

use datafusion::error::DataFusionError;
use reel_world::Digest;

use crate::functions::simulator::Row;

/// Why a query was stopped before its end.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
pub enum Stopped {
    /// Somebody asked for it.
    #[error("stopped; nothing was changed")]
    Cancelled,
    /// It took too long.
    #[error("stopped after {seconds} s, the limit on time; narrow the question down or raise --timeout")]
    Time {
        /// The limit.
        seconds: u64,
    },
    /// It took too much memory.
    #[error("stopped at {bytes} bytes, the limit on memory; narrow the question down or raise --memory")]
    Memory {
        /// The limit.
        bytes: usize,
    },
    /// Its answer is too long.
    #[error("stopped at {rows} rows, the limit on answers; add a LIMIT, aggregate, or raise --max-rows")]
    Rows {
        /// The limit.
        rows: usize,
    },
    /// A value that no question needs.
    #[error("'{function}' would make {bytes} bytes for one row; the limit is {limit}")]
    Value {
        /// Which function.
        function: String,
        /// How large.
        bytes: u128,
        /// The limit.
        limit: u128,
    },
}

/// Shared between a session, its functions and whoever wants to stop it.
#[derive(Debug, Default)]
pub struct Control {
    cancelled: AtomicBool,
    simulated: AtomicU64,
    /// Traces that functions may open.
    traces: OnceLock<BTreeSet<String>>,
    /// What `replay` said, by the trace's digest.
    pub(crate) verdicts: Mutex<BTreeMap<Digest, Row>>,
}

impl Control {
    /// Stops what runs, as soon as it looks.
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }

    /// Another query begins: what stopped the last one does not stop this.
    pub(crate) fn begin(&self) {
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
        if self.is_cancelled() { Err(DataFusionError::External(Box::new(Stopped::Cancelled))) } else { Ok(()) }
    }

    pub(crate) fn count_simulated(&self) {
        self.simulated.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn allow(&self, traces: BTreeSet<String>) {
        self.traces.get_or_init(|| traces);
    }

    pub(crate) fn knows_traces(&self) -> bool {
        self.traces.get().is_some()
    }

    /// Only files that the store names are opened.
    pub(crate) fn allowed(&self, path: &Path) -> bool {
        self.traces.get().is_some_and(|traces| traces.contains(&*path.to_string_lossy()))
    }
}
