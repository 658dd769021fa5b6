//! Findings of one check as they come: all are counted, the first of each kind are kept.

use std::{collections::BTreeSet, path::Path};

use reel_dataset::lint::{CheckReport, ExampleRef, Finding, Severity};

/// A check that is under way.
pub(super) struct Check {
    report: CheckReport,
    kept_of_kind: usize,
    rows: BTreeSet<u64>,
}

impl Check {
    pub(super) fn new(check: &'static str, description: &'static str, kept_of_kind: usize) -> Self {
        Self {
            report: CheckReport::new(check, description),
            kept_of_kind,
            rows: BTreeSet::new(),
        }
    }

    /// Counts a finding, and keeps it if it is among the first of its kind.
    pub(super) fn add(
        &mut self,
        kind: &'static str,
        severity: Severity,
        place: Option<ExampleRef>,
        message: String,
    ) {
        let report = &mut self.report;
        let count = report.count(kind, severity);
        self.rows.extend(place.as_ref().map(|place| place.index));
        if count <= self.kept_of_kind as u64 {
            report.examples.push(Finding {
                check: report.check,
                kind,
                severity,
                examples: place.into_iter().collect(),
                message,
                excerpt: String::new(),
            });
        }
    }

    /// Figures for the table.
    pub(super) fn note(&mut self, note: String) {
        self.report.note = note;
    }

    /// The dataset has nothing that the check could look at.
    pub(super) fn not_applicable(&mut self, why: &str) {
        self.report.applies = false;
        self.report.note = why.to_owned();
    }

    pub(super) fn finish(mut self, frames: u64) -> CheckReport {
        self.report.rows = self.rows.len() as u64;
        self.report.share = self.report.rows as f64 / frames.max(1) as f64;
        self.report
    }
}

/// A row of a table, from 0 in the dataset and from 1 in its file.
pub(super) fn place(index: u64, root: &Path, file: &Path, row: u64) -> ExampleRef {
    let file = file.strip_prefix(root).unwrap_or(file);
    ExampleRef {
        index,
        file: file.display().to_string(),
        line: u32::try_from(row + 1).unwrap_or(u32::MAX),
    }
}
