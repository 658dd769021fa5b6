//! What speaks against publishing a folder: the checks by name, and what each found. Reads nothing.

use std::{collections::BTreeMap, fmt};

use reel_world::printable_line;
use serde::Serialize;

use crate::secrets::without_secrets;

/// Problems that are kept of one check in one file; all are counted.
const KEPT_OF_FILE: u64 = 3;
/// Problems that are kept of one check.
const KEPT_OF_CHECK: usize = 50;

/// The checks that a folder has to pass before it is published.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Check {
    /// Names of files, and what is no plain file: links, devices, empty files.
    Files,
    /// Digests of `manifest.json` and `SHA256SUMS` against the files.
    Checksums,
    /// The card `README.md` and what it tells the viewer.
    Card,
    /// The license that the card names.
    License,
    /// Tokens and keys in the bytes of any file.
    Secrets,
    /// Absolute paths of a machine in texts and rows.
    LocalPaths,
    /// Rows whose trace was not replayed exactly.
    Unverified,
    /// Examples of one task in two splits.
    Splits,
    /// Errors of `reel dataset lint`.
    Lint,
}

impl Check {
    /// All checks, in the order in which they are reported.
    pub const ALL: [Check; 9] = [
        Check::Files,
        Check::Checksums,
        Check::Card,
        Check::License,
        Check::Secrets,
        Check::LocalPaths,
        Check::Unverified,
        Check::Splits,
        Check::Lint,
    ];

    /// The name of the check, as `--allow` takes it.
    pub fn as_str(self) -> &'static str {
        match self {
            Check::Files => "files",
            Check::Checksums => "checksums",
            Check::Card => "card",
            Check::License => "license",
            Check::Secrets => "secrets",
            Check::LocalPaths => "local-paths",
            Check::Unverified => "unverified",
            Check::Splits => "splits",
            Check::Lint => "lint",
        }
    }

    /// Whether a person may publish in spite of it. The others are never what one wants.
    pub fn may_be_allowed(self) -> bool {
        matches!(
            self,
            Check::LocalPaths | Check::Unverified | Check::Splits | Check::Lint
        )
    }

    /// The check of a name that `--allow` may be given.
    pub fn parse_allowed(name: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|check| check.as_str() == name && check.may_be_allowed())
    }
}

/// One thing that speaks against publishing.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct Problem {
    /// The check that found it.
    pub check: Check,
    /// Path of the file in the folder, safe to print; empty if it is about the folder.
    pub file: String,
    /// Line of a text, or row of a table, from 1; `None` if it is about the whole file.
    pub line: Option<u64>,
    /// What is wrong and what to do, safe to print.
    pub message: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: ", self.check.as_str())?;
        match self.line {
            Some(line) => write!(f, "{}:{line}: ", self.file)?,
            None if self.file.is_empty() => {}
            None => write!(f, "{}: ", self.file)?,
        }
        f.write_str(&self.message)
    }
}

/// Problems as they are found: all are counted, the first of each check and file are kept.
#[derive(Clone, Debug, Default)]
pub struct Problems {
    found: Vec<Problem>,
    of_file: BTreeMap<(Check, String), u64>,
    counts: BTreeMap<Check, u64>,
}

impl Problems {
    /// Counts a problem, and keeps it if it is among the first. Texts may come from anywhere.
    pub fn add(&mut self, check: Check, file: &str, line: Option<u64>, message: &str) {
        *self.counts.entry(check).or_default() += 1;
        let file = printable_path(file);
        let of_file = self.of_file.entry((check, file.clone())).or_default();
        *of_file += 1;
        let of_check = self.found.iter().filter(|it| it.check == check).count();
        if *of_file <= KEPT_OF_FILE && of_check < KEPT_OF_CHECK {
            let message = printable_line(message);
            self.found.push(Problem {
                check,
                file,
                line,
                message,
            });
        }
    }

    /// The problems that were kept, by check and then as they were found.
    pub fn kept_problems(&self) -> Vec<&Problem> {
        let mut found: Vec<&Problem> = self.found.iter().collect();
        found.sort_by_key(|problem| problem.check);
        found
    }

    /// How many problems each check found; those without any are left out.
    pub fn counts(&self) -> &BTreeMap<Check, u64> {
        &self.counts
    }

    /// Whether a check found something that is not among the allowed ones.
    pub fn forbid(&self, allowed: &[Check]) -> bool {
        self.counts
            .keys()
            .any(|check| !(allowed.contains(check) && check.may_be_allowed()))
    }
}

/// A path within a dataset for a terminal: secrets in its names are labels.
pub fn printable_path(path: &str) -> String {
    printable_line(&without_secrets(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_problems_are_counted_and_few_are_kept() {
        let mut problems = Problems::default();
        for line in 0..500 {
            problems.add(Check::LocalPaths, "a\n", Some(line), "a path");
        }
        problems.add(Check::Files, "b", None, "a link");
        assert_eq!(problems.counts()[&Check::LocalPaths], 500);
        let kept = problems.kept_problems();
        assert_eq!(kept.len(), 4);
        assert_eq!(kept[0].to_string(), "files: b: a link");
        assert_eq!(kept[1].to_string(), "local-paths: a\\n:0: a path");
        assert!(problems.forbid(&[Check::LocalPaths]));
        assert!(problems.forbid(&[Check::LocalPaths, Check::Files]));
        assert!(!Problems::default().forbid(&[]));
    }

    #[test]
    fn secrets_and_licenses_cannot_be_allowed() {
        assert_eq!(Check::parse_allowed("lint"), Some(Check::Lint));
        for name in ["secrets", "license", "files", "checksums", "card", "", "x"] {
            assert_eq!(Check::parse_allowed(name), None, "{name}");
        }
    }
}
