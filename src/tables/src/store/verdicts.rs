//! What replaying trace files found. A verdict is about the bytes of a file, whatever version of
//! the store names it: so these rows are bound to no version, are only ever added to, and are
//! always read at their newest.

use serde::{Deserialize, Serialize};

use super::{Refused, Store, StoreError, TRIES_MAX};
use crate::{Table, rows::Rows};

/// What the replay of a trace file found: a row of `verdicts`.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct TraceVerdict {
    /// BLAKE3 of the file's bytes.
    pub file_digest: String,
    /// The trace's chain digest; empty where the file could not be read.
    pub trace_digest: String,
    /// The simulator that replayed it.
    pub sim_version: u32,
    /// Version of Reel that replayed it.
    pub build: String,
    /// `exact`, `diverged`, `other_simulator`, `not_replayable` or `refused`.
    pub verdict: String,
    /// What was found, in words.
    pub reason: String,
}

impl Store {
    /// Every verdict that was kept, those of other versions of the store too.
    ///
    /// # Errors
    /// When the store cannot be read.
    pub fn verdicts(&self) -> Result<Vec<TraceVerdict>, StoreError> {
        self.rows_of(&self.newest(Table::Verdicts)?)
    }

    /// Keeps verdicts. The store's version stays what it is.
    ///
    /// # Errors
    /// When the store cannot be written.
    pub fn append_verdicts(&self, verdicts: &[TraceVerdict]) -> Result<(), StoreError> {
        if verdicts.is_empty() {
            return Ok(());
        }
        let rows = Rows::of(Table::Verdicts, verdicts)?;
        for _ in 0..TRIES_MAX {
            let newest = self.newest(Table::Verdicts)?;
            let actions = self.write_parts(&newest, vec![rows.clone()])?;
            match self.commit_side(&newest, actions) {
                Ok(_) => return Ok(()),
                Err(Refused::Conflict) => {}
                Err(Refused::Failed(error)) => return Err(error),
            }
        }
        Err(StoreError::Busy {
            tries: TRIES_MAX,
            location: self.location.to_string(),
        })
    }
}
