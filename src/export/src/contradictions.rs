//! What policies' Histories claim beside what their records say. What a check found is kept in the
//! store (table `contradictions`) under the trace's digest and the checker's version.

use std::{
    collections::{BTreeSet, HashMap},
    path::Path,
};

use rayon::prelude::*;
use reel_history::{CHECKER_VERSION, Checker, ClaimVerdict, EpisodeFacts, StepFacts};
use reel_tables::{CheckedTrace, RefutedClaim, Store, StoreError, Table};
use reel_trace::{RecordsReader, Trace};
use serde::Deserialize;

/// What is known of the Histories of a store's traces.
pub(crate) struct HistoryChecks<'s> {
    store: &'s Store,
    reader: RecordsReader,
    /// Decisions with a refuted claim, by the digest of the trace.
    refuted: HashMap<String, BTreeSet<u32>>,
    unsaved: Vec<CheckedTrace>,
}

/// Checks the Histories of every trace of a store that this version of the checker has not seen,
/// and keeps what it finds in table `contradictions`. `progress` gets the number of traces checked.
/// Traces that cannot be read are left out.
///
/// # Errors
/// When the store cannot be read or written.
pub fn check_histories(store: &Store, progress: impl FnMut(usize)) -> Result<(), StoreError> {
    check(store, |_| true, progress)
}

/// [`check_histories`] of failed episodes alone, which explains them.
///
/// # Errors
/// When the store cannot be read or written.
pub fn check_failed_histories(store: &Store) -> Result<(), StoreError> {
    check(store, |row| row.success == Some(false), |_| ())
}

#[derive(Deserialize)]
struct EpisodeRow<'a> {
    trace: &'a str,
    trace_digest: &'a str,
    success: Option<bool>,
}

fn check(
    store: &Store,
    wanted: impl Fn(&EpisodeRow<'_>) -> bool,
    mut progress: impl FnMut(usize),
) -> Result<(), StoreError> {
    let mut checks = HistoryChecks::open(store)?;
    let columns = ["trace", "trace_digest", "success"];
    store.read(Table::Episodes, &columns, |batch| {
        let rows: Vec<EpisodeRow<'_>> = reel_tables::rows_from(&batch)?;
        let traces = rows.iter().filter(|row| wanted(row));
        checks.check(traces.map(|row| (row.trace, row.trace_digest)));
        progress(rows.len());
        Ok(())
    })?;
    checks.save()
}

impl<'s> HistoryChecks<'s> {
    /// What is known so far.
    pub fn open(store: &'s Store) -> Result<Self, StoreError> {
        let known = store.checked_traces()?.into_iter();
        Ok(Self {
            store,
            reader: RecordsReader::new(store.trace_files().clone()),
            refuted: known
                .filter(|trace| trace.checker_version == CHECKER_VERSION)
                .map(|trace| (trace.trace_digest.clone(), refuted_steps(&trace)))
                .collect(),
            unsaved: Vec::new(),
        })
    }

    /// Checks those of these traces, given by path and digest, that are not known yet. One that
    /// cannot be read, or is another one now, stays unknown.
    pub fn check<'a>(&mut self, traces: impl Iterator<Item = (&'a str, &'a str)>) {
        let unknown: Vec<_> = traces
            .filter(|(_, digest)| !self.refuted.contains_key(*digest))
            .collect();
        let checked: Vec<CheckedTrace> = unknown
            .into_par_iter()
            .filter_map(|(path, digest)| {
                let trace = self.reader.read(Path::new(path)).ok()?;
                (trace.chain().to_string() == digest).then(|| checked(&trace))
            })
            .collect();
        for trace in checked {
            self.refuted
                .insert(trace.trace_digest.clone(), refuted_steps(&trace));
            self.unsaved.push(trace);
        }
    }

    /// The decisions of a trace whose Histories claim what the record refutes; `None` if the trace
    /// was not checked.
    pub fn refuted_steps(&self, trace_digest: &str) -> Option<&BTreeSet<u32>> {
        self.refuted.get(trace_digest)
    }

    /// Keeps what was found in the store.
    pub fn save(self) -> Result<(), StoreError> {
        self.store.append_checked_traces(&self.unsaved)
    }
}

fn refuted_steps(trace: &CheckedTrace) -> BTreeSet<u32> {
    trace.claims.iter().map(|claim| claim.step).collect()
}

fn checked(trace: &Trace) -> CheckedTrace {
    let mut claims = Vec::new();
    let mut checker = Checker::new(EpisodeFacts::of(
        &trace.task,
        &trace.scene,
        &trace.start.graphs.physics,
    ));
    for record in &trace.steps {
        let policy = record.input.policy.as_ref();
        let history = policy.map_or("", |policy| &policy.history);
        for claim in checker.check(history) {
            if let ClaimVerdict::Contradicted { why, .. } = claim.verdict {
                claims.push(RefutedClaim {
                    step: record.step,
                    kind: claim.kind.to_string(),
                    claim: history[claim.span].to_owned(),
                    reason: why,
                });
            }
        }
        checker.push_step(StepFacts::of(record));
    }
    CheckedTrace {
        episode_id: trace.header.episode_id.clone(),
        trace_digest: trace.chain().to_string(),
        checker_version: CHECKER_VERSION,
        claims,
    }
}
