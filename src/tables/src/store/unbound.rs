//! What replaying trace files found, and what of their Histories the record refutes. Both are about
//! the content of a trace, whatever version of the store names it: so these rows are bound to no
//! version, are only ever added to, and are always read at their newest.

use std::{collections::HashMap, time::SystemTime};

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
    #[serde(default)]
    pub at_ms: Option<i64>,
}

impl TraceVerdict {
    /// What this build found just now in a file of that digest. `trace` is none where the file
    /// holds no trace.
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
            at_ms: SystemTime::now()
                .duration_since(SystemTime::UNIX_EPOCH)
                .ok()
                .and_then(|since| i64::try_from(since.as_millis()).ok()),
        }
    }

    /// Which replays its replay repeats: of the same file by the same simulator, comparing as much.
    fn key(&self) -> (&str, u32, bool) {
        let without_rgb = self.verdict.ends_with("_without_rgb");
        (&self.file_digest, self.sim_version, without_rgb)
    }

    /// Verdicts of one replay after the other. Among those that are older than times, and so in no
    /// order, what diverged comes last: it must not be hidden.
    fn in_time(verdicts: &mut [Self]) {
        verdicts.sort_by_key(|verdict| (verdict.at_ms, verdict.verdict.starts_with("diverged")));
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
    /// Every verdict that was kept, those of other versions of the store too; the newest last.
    ///
    /// # Errors
    /// When the store cannot be read.
    pub fn verdicts(&self) -> Result<Vec<TraceVerdict>, StoreError> {
        let mut kept: Vec<TraceVerdict> = self.rows_of(&self.newest(Table::Verdicts)?)?;
        TraceVerdict::in_time(&mut kept);
        Ok(kept)
    }

    /// Keeps verdicts. The store's version stays what it is.
    ///
    /// # Errors
    /// When the store cannot be written.
    pub fn append_verdicts(&self, verdicts: &[TraceVerdict]) -> Result<(), StoreError> {
        self.append_unbound(Table::Verdicts, verdicts)
    }

    /// Keeps those of the verdicts that say something else than the replay before: one that finds
    /// the same again adds nothing.
    ///
    /// # Errors
    /// When the store cannot be read or written.
    pub fn append_new_verdicts(&self, verdicts: &[TraceVerdict]) -> Result<(), StoreError> {
        if verdicts.is_empty() {
            return Ok(());
        }
        self.append_with(Table::Verdicts, |newest| {
            let mut kept: Vec<TraceVerdict> = self.rows_of(newest)?;
            TraceVerdict::in_time(&mut kept);
            let mut last: HashMap<_, &str> = kept
                .iter()
                .map(|verdict| (verdict.key(), verdict.verdict.as_str()))
                .collect();
            let new = verdicts.iter().filter(|verdict| {
                last.insert(verdict.key(), &verdict.verdict) != Some(verdict.verdict.as_str())
            });
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
        let append = || -> Result<(), Refused> {
            let newest = self.newest_to_write(table)?;
            let rows = rows(&newest)?;
            if rows.is_empty() {
                return Ok(());
            }
            let rows = Rows::of(table, &rows).map_err(StoreError::from)?;
            let actions = self.write_parts(&newest, vec![rows])?;
            self.commit_side(&newest, actions).map(drop)
        };
        for _ in 0..TRIES_MAX {
            match append() {
                Ok(()) => return Ok(()),
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
