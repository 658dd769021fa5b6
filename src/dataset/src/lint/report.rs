//! What was found: a report for machines (JSON) and for people (a table and examples).

use std::{
    collections::BTreeMap,
    fmt::{self, Write as _},
};

use serde::Serialize;

use crate::lint::{Dataset, RowLocation};

/// How bad a finding is.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    /// Information that is worth knowing, but no warning.
    Note,
    /// Probably not what was wanted.
    Warning,
    /// Training on it is harmful, or the loader fails.
    Error,
}

/// A row that a finding is about.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct ExampleRef {
    /// Number of the row in the dataset, from 0.
    pub index: u64,
    /// Path of the file that holds the row.
    pub file: String,
    /// Its line, or in Parquet its row, from 1.
    pub line: u32,
}

/// One thing that is wrong.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Finding {
    /// The check that found it.
    pub check: &'static str,
    /// What sort of thing it is within the check.
    pub kind: &'static str,
    /// How bad it is.
    pub severity: Severity,
    /// The rows; the first is the one that is wrong, the others are what it was compared with.
    pub examples: Vec<ExampleRef>,
    /// What is wrong, in a message for people.
    pub message: String,
    /// The text it is about; empty where there is none.
    pub excerpt: String,
}

/// What one check found.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct CheckReport {
    /// Name of the check, e.g. `rows`.
    pub check: &'static str,
    /// What it looks for.
    pub description: &'static str,
    /// Whether the dataset has what the check needs.
    pub applies: bool,
    /// Number of findings, including those that `examples` leaves out.
    pub findings: u64,
    /// Number of rows with at least one.
    pub rows: u64,
    /// That number as a share of all rows that were read.
    pub share: f64,
    /// Severity of the worst finding; `None` if there are no findings.
    pub worst: Option<Severity>,
    /// Number of findings by kind.
    pub kinds: BTreeMap<&'static str, u64>,
    /// Figures, or why it does not apply.
    pub note: String,
    /// The first findings of each kind.
    pub examples: Vec<Finding>,
}

impl CheckReport {
    /// The report of a check that found nothing so far.
    pub fn new(check: &'static str, description: &'static str) -> Self {
        Self {
            check,
            description,
            applies: true,
            findings: 0,
            rows: 0,
            share: 0.0,
            worst: None,
            kinds: BTreeMap::new(),
            note: String::new(),
            examples: Vec::new(),
        }
    }

    /// Counts a finding; how many of its kind there are now.
    pub fn count(&mut self, kind: &'static str, severity: Severity) -> u64 {
        self.findings += 1;
        self.worst = self.worst.max(Some(severity));
        let count = self.kinds.entry(kind).or_default();
        *count += 1;
        *count
    }
}

/// What all checks found.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Report {
    /// Files: path, format, split.
    pub files: Vec<FileReport>,
    /// Rows that were read.
    pub rows: u64,
    /// Rows that could not be read.
    pub unreadable: u64,
    /// One for each check, in the order of their importance.
    pub checks: Vec<CheckReport>,
}

/// A file in a report.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct FileReport {
    /// Path of the file, as given or as found below a given folder.
    pub path: String,
    /// Format in which the rows of the file were read.
    pub format: crate::lint::Format,
    /// Its split, if its name tells.
    pub split: Option<String>,
}

impl Report {
    /// Whether anything is an error: the command's answer is then "no" (exit code 1).
    pub fn is_bad(&self) -> bool {
        self.checks
            .iter()
            .any(|check| check.worst == Some(Severity::Error))
    }

    /// The report of one check.
    pub fn check(&self, name: &str) -> Option<&CheckReport> {
        self.checks.iter().find(|check| check.check == name)
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unreadable = if self.unreadable > 0 {
            format!(", {} unreadable", self.unreadable)
        } else {
            String::new()
        };
        writeln!(
            f,
            "{} rows{unreadable} in {} files",
            self.rows,
            self.files.len()
        )?;
        for file in self.files.iter().take(FILES_SHOWN) {
            let split = file
                .split
                .as_deref()
                .map(|split| format!(", split {split}"))
                .unwrap_or_default();
            writeln!(f, "  {} ({}{split})", file.path, file.format.as_str())?;
        }
        if self.files.len() > FILES_SHOWN {
            writeln!(f, "  and {} more", self.files.len() - FILES_SHOWN)?;
        }
        write_checks(f, &self.checks)
    }
}

/// Prints what checks found: a table, and then the findings that were kept.
///
/// # Errors
/// When the formatter does.
pub fn write_checks(f: &mut fmt::Formatter<'_>, checks: &[CheckReport]) -> fmt::Result {
    writeln!(
        f,
        "\n{:<16} {:>9} {:>9} {:>8}",
        "check", "findings", "rows", "share"
    )?;
    for check in checks {
        let verdict = match check.worst {
            _ if !check.applies => "-",
            None => "ok",
            Some(Severity::Note) => "note",
            Some(Severity::Warning) => "warning",
            Some(Severity::Error) => "ERROR",
        };
        let (findings, rows, share) = (
            check.findings,
            check.rows,
            format!("{:.1}%", 100.0 * check.share),
        );
        let line = format!(
            "{:<16} {findings:>9} {rows:>9} {share:>8}  {verdict:<7}  {}",
            check.check, check.note
        );
        writeln!(f, "{}", line.trim_end())?;
    }
    for check in checks.iter().filter(|check| !check.examples.is_empty()) {
        writeln!(f, "\n{}: {}", check.check, check.description)?;
        for (kind, count) in &check.kinds {
            let of_kind: Vec<&Finding> = check
                .examples
                .iter()
                .filter(|finding| finding.kind == *kind)
                .collect();
            let shown = if (of_kind.len() as u64) < *count {
                format!(", {} shown", of_kind.len())
            } else {
                String::new()
            };
            writeln!(f, "  {kind}: {count}{shown}")?;
            for finding in of_kind {
                write_finding(f, finding)?;
            }
        }
    }
    Ok(())
}

/// Files that a readable report names.
const FILES_SHOWN: usize = 8;

fn write_finding(f: &mut fmt::Formatter<'_>, finding: &Finding) -> fmt::Result {
    let places: Vec<String> = finding
        .examples
        .iter()
        .map(|it| format!("{}:{} (row {})", it.file, it.line, it.index))
        .collect();
    writeln!(
        f,
        "    {}{}{}",
        places.join(" ~ "),
        if places.is_empty() { "" } else { ": " },
        finding.message
    )?;
    for line in finding.excerpt.lines() {
        writeln!(f, "      | {line}")?;
    }
    Ok(())
}

/// Findings of one check as they come: all are counted, the first of each kind are kept.
pub(crate) struct Findings<'a> {
    dataset: &'a Dataset,
    report: CheckReport,
    kept_of_kind: usize,
    last_row: Option<u64>,
}

impl<'a> Findings<'a> {
    pub(crate) fn new(
        dataset: &'a Dataset,
        check: &'static str,
        description: &'static str,
        kept_of_kind: usize,
    ) -> Self {
        Self {
            dataset,
            report: CheckReport::new(check, description),
            kept_of_kind,
            last_row: None,
        }
    }

    /// Counts a finding; its words are only made if it is kept.
    pub(crate) fn add(
        &mut self,
        kind: &'static str,
        severity: Severity,
        places: &[RowLocation],
        words: impl FnOnce() -> (String, String),
    ) {
        let report = &mut self.report;
        let count = report.count(kind, severity);
        if let Some(place) = places
            .first()
            .filter(|place| self.last_row != Some(place.index))
        {
            self.last_row = Some(place.index);
            report.rows += 1;
        }
        if count > self.kept_of_kind as u64 {
            return;
        }
        let (message, excerpt) = words();
        let examples = places
            .iter()
            .map(|place| self.dataset.example_ref(*place))
            .collect();
        report.examples.push(Finding {
            check: report.check,
            kind,
            severity,
            examples,
            message,
            excerpt: short(&excerpt),
        });
    }

    /// Figures for the table.
    pub(crate) fn note(&mut self, note: impl Into<String>) {
        self.report.note = note.into();
    }

    /// The dataset has nothing that the check could look at; what it seemed to find is forgotten.
    pub(crate) fn not_applicable(&mut self, why: impl Into<String>) {
        let (check, what) = (self.report.check, self.report.description);
        self.report = Self::new(self.dataset, check, what, self.kept_of_kind).report;
        self.report.applies = false;
        self.report.note = why.into();
    }

    pub(crate) fn finish(mut self, rows: u64) -> CheckReport {
        self.report.share = if rows == 0 {
            0.0
        } else {
            self.report.rows as f64 / rows as f64
        };
        self.report
    }
}

impl Dataset {
    /// A place for people.
    pub fn example_ref(&self, place: RowLocation) -> ExampleRef {
        let file = usize::try_from(place.file)
            .ok()
            .and_then(|file| self.files().get(file));
        let file = file
            .map(|file| file.path.display().to_string())
            .unwrap_or_default();
        ExampleRef {
            index: place.index,
            file,
            line: place.line,
        }
    }
}

/// Longest excerpt, in characters.
const EXCERPT_LENGTH_MAX: usize = 240;

fn short(text: &str) -> String {
    let text = text.trim();
    let mut kept: String = text.chars().take(EXCERPT_LENGTH_MAX).collect();
    if kept.len() < text.len() {
        let _ = write!(kept, " ..");
    }
    kept
}
