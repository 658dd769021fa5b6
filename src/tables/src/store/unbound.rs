//! What replaying trace files found, and what of their Histories the record refutes. Both are about
//! the content of a trace, whatever version of the store names it: so these rows are bound to no
//! version, are only ever added to, and are always read at their newest.

use std::collections::HashSet;

use deltalake::DeltaTable;
use reel_world::Digest;
use serde::{Deserialize, Serialize};

use super::{Refused, Store, StoreError, TRIES_MAX};
use crate::{Table, rows::Rows};

/// What the replay of a trace file found: a row of `verdicts`.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the schema of the table says what each is")]
pub struct TraceVerdict {
    pub file_digest: String,
    pub trace_digest: String,
    pub sim_version: u32,
    pub build: String,
    pub verdict: String,
    pub reason: String,
}

impl TraceVerdict {
    /// What this build found in a file of that digest. `trace` is none where it holds no trace.
    pub fn new(
        file: Digest,
        trace: Option<Digest>,
        sim_version: u32,
        verdict: String,
        reason: String,
    ) -> Self {
        Self {
            file_digest: file.to_string(),
            trace_digest: trace.map(|digest| digest.to_string()).unwrap_or_default(),
            sim_version,
            build: env!("CARGO_PKG_VERSION").to_owned(),
            verdict,
            reason,
        }
    }

    /// What makes it another verdict than those that are kept: a build that finds the same adds
    /// nothing.
    fn key(&self) -> (&str, u32, &str) {
        (&self.file_digest, self.sim_version, &self.verdict)
    }
}

/// What the Histories of a trace claim against its record: a row of `contradictions`.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the schema of the table says what each is")]
pub struct CheckedTrace {
    pub episode_id: String,
    pub trace_digest: String,
    pub checker_version: u32,
    pub claims: Vec<RefutedClaim>,
}

/// A claim of a History that the record refutes.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the schema of the table says what each is")]
pub struct RefutedClaim {
    pub step: u32,
    pub kind: String,
    pub claim: String,
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
        self.append_unbound(Table::Verdicts, verdicts)
    }

    /// Keeps those of the verdicts that are not kept yet.
    ///
    /// # Errors
    /// When the store cannot be read or written.
    pub fn append_new_verdicts(&self, verdicts: &[TraceVerdict]) -> Result<(), StoreError> {
        if verdicts.is_empty() {
            return Ok(());
        }
        self.append_with(Table::Verdicts, |newest| {
            let kept: Vec<TraceVerdict> = self.rows_of(newest)?;
            let mut known: HashSet<_> = kept.iter().map(TraceVerdict::key).collect();
            let new = verdicts
                .iter()
                .filter(|verdict| known.insert(verdict.key()));
            Ok(new.cloned().collect())
        })
    }

    /// Every trace whose Histories were checked, by any version of the checker.
    ///
    /// # Errors
    /// When the store cannot be read.
    pub fn checked_traces(&self) -> Result<Vec<CheckedTrace>, StoreError> {
        self.rows_of(&self.newest(Table::Contradictions)?)
    }

    /// Keeps what checks found. The store's version stays what it is.
    ///
    /// # Errors
    /// When the store cannot be written.
    pub fn append_checked_traces(&self, traces: &[CheckedTrace]) -> Result<(), StoreError> {
        self.append_unbound(Table::Contradictions, traces)
    }

    fn append_unbound<R: Serialize + Clone>(
        &self,
        table: Table,
        rows: &[R],
    ) -> Result<(), StoreError> {
        self.append_with(table, |_| Ok(rows.to_vec()))
    }

    /// Adds the rows that `rows` makes of the newest version, and makes them anew where somebody
    /// else was faster.
    fn append_with<R: Serialize>(
        &self,
        table: Table,
        rows: impl Fn(&DeltaTable) -> Result<Vec<R>, StoreError>,
    ) -> Result<(), StoreError> {
        for _ in 0..TRIES_MAX {
            let newest = self.newest(table)?;
            let rows = rows(&newest)?;
            if rows.is_empty() {
                return Ok(());
            }
            let actions = self.write_parts(&newest, vec![Rows::of(table, &rows)?])?;
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
