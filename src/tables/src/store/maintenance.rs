//! Upkeep of a store: few large files instead of many small ones, and the removal of files
//! that no version needs.

use std::collections::BTreeMap;

use serde::Serialize;

use super::{
    Refused, Store, StoreError, TRIES_MAX, UNBOUND,
    parts::{Merge, Part},
};
use crate::Table;

/// What a compaction did.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize)]
pub struct CompactReport {
    /// Number of data files in all tables before the compaction.
    pub files_before: usize,
    /// Number of data files in all tables after the compaction.
    pub files_after: usize,
    /// The store's version afterwards.
    pub version: u64,
}

/// What a vacuum did, or would do.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize)]
pub struct VacuumReport {
    /// Files deleted, or to be deleted if `dry_run`, each as `table/file`.
    pub deleted: Vec<String>,
    /// Whether it only looked.
    pub dry_run: bool,
}

impl Store {
    /// Merges the small files of every table. Answers do not change;
    /// earlier versions stay readable.
    ///
    /// # Errors
    /// When the store cannot be read or written.
    pub fn compact(&mut self) -> Result<CompactReport, StoreError> {
        let count = |store: &Self| {
            Table::ALL
                .iter()
                .map(|table| store.parts(*table).len())
                .sum()
        };
        self.reload()?;
        let files_before = count(self);
        self.merge_small_files(Merge::COMPACT)?;
        Ok(CompactReport {
            files_before,
            files_after: count(self),
            version: self.version(),
        })
    }

    /// Deletes files that no version of the last `retention_hours` needs. Earlier versions cannot
    /// be opened any more.
    ///
    /// # Errors
    /// When the store cannot be read or written.
    pub fn vacuum(
        &mut self,
        retention_hours: u32,
        dry_run: bool,
    ) -> Result<VacuumReport, StoreError> {
        let mut report = VacuumReport {
            dry_run,
            ..VacuumReport::default()
        };
        for table in Table::ALL {
            let period = chrono::Duration::hours(retention_hours.into());
            let vacuum = self
                .newest(table)?
                .vacuum()
                .with_retention_period(period)
                .with_enforce_retention_duration(false);
            let (_, metrics) = self.wait(vacuum.with_dry_run(dry_run).into_future())?;
            report.deleted.extend(
                metrics
                    .files_deleted
                    .into_iter()
                    .map(|file| format!("{}/{file}", table.name())),
            );
        }
        self.reload()?;
        Ok(report)
    }

    /// Merges the small files of tables that have enough of them; by how many versions of the store.
    pub(super) fn merge_small_files(&mut self, merge: Merge) -> Result<u64, StoreError> {
        let mut versions = 0;
        for table in Table::ALL {
            for _ in 0..TRIES_MAX {
                let mut small = self.parts(table);
                small.retain(|part| part.size < merge.small_bytes);
                if small.len() < merge.files_min {
                    break;
                }
                match self.try_merge(table, small, merge) {
                    Ok(_) => {
                        versions += u64::from(!UNBOUND.contains(&table));
                        self.reload()?;
                    }
                    Err(Refused::Conflict) => {
                        self.reload()?;
                        // a writer that was killed left a commit that nothing names yet: the next
                        // ingest takes it in
                        if table != Table::Episodes {
                            break;
                        }
                    }
                    Err(Refused::Failed(error)) => return Err(error),
                }
            }
        }
        Ok(versions)
    }

    fn try_merge(&self, table: Table, small: Vec<Part>, merge: Merge) -> Result<u64, Refused> {
        let opened = &self.tables[&table];
        let actions = self.rewrite_parts(opened, small, merge)?;
        if table == Table::Episodes {
            return self.commit_episodes(actions, &BTreeMap::new());
        }
        let version = self.commit_side(opened, actions)?;
        if UNBOUND.contains(&table) {
            return Ok(self.version());
        }
        self.commit_episodes(Vec::new(), &BTreeMap::from([(table, version)]))
    }
}
