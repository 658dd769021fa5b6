//! Whether every row names a trace that was replayed exactly: rows of JSON by the objects that name
//! a trace, tables by their columns. Believes what the rows say; the lint and the manifest's
//! digests say whether they are the exported ones.

use std::collections::BTreeMap;

use reel_world::printable_line;
use serde_json::Value;

use crate::{Check, DatasetKind, Problems};

/// How the names of files end that hold the provenance of rows beside them.
const PROVENANCE: &str = ".provenance.jsonl";
/// The verdicts of traces that were replayed to the same digests.
const EXACT: [&str; 2] = ["exact", "exact_without_rgb"];

/// Rows by file, and how many of them say that their trace is verified.
pub(crate) struct Verdicts {
    kind: DatasetKind,
    files: BTreeMap<String, RowCount>,
}

#[derive(Default)]
struct RowCount {
    rows: u64,
    named: u64,
}

impl Verdicts {
    pub(crate) fn new(kind: DatasetKind) -> Self {
        Self {
            kind,
            files: BTreeMap::new(),
        }
    }

    /// A row of a JSON file.
    pub(crate) fn json_row(
        &mut self,
        path: &str,
        line: u64,
        value: &Value,
        problems: &mut Problems,
    ) {
        let mut verdicts = Vec::new();
        find_verdicts(value, &mut verdicts);
        self.count(path, line, &verdicts, problems);
    }

    /// A row of a table, whose columns of text are asked by name.
    pub(crate) fn table_row(
        &mut self,
        path: &str,
        line: u64,
        value: &dyn Fn(&str) -> Option<String>,
        problems: &mut Problems,
    ) {
        let column = match self.kind {
            DatasetKind::Export | DatasetKind::Preferences => "verdict",
            DatasetKind::LeRobot => "reel/verdict",
        };
        let verdict = value(column);
        let verdicts: Vec<&str> = verdict.iter().map(String::as_str).collect();
        self.count(path, line, &verdicts, problems);
    }

    fn count(&mut self, path: &str, line: u64, verdicts: &[&str], problems: &mut Problems) {
        let count = self.files.entry(path.to_owned()).or_default();
        count.rows += 1;
        count.named += u64::from(!verdicts.is_empty());
        for verdict in verdicts.iter().filter(|verdict| !EXACT.contains(verdict)) {
            let verdict = printable_line(&verdict.chars().take(40).collect::<String>());
            let message =
                format!("the trace is not verified ({verdict}); export without --allow-unverified");
            problems.add(Check::Unverified, path, Some(line), &message);
        }
    }

    /// Files of an export whose rows name no verdict, neither themselves nor beside them.
    pub(crate) fn finish(self, problems: &mut Problems) {
        if self.kind == DatasetKind::LeRobot {
            // one of another origin has no traces; its lint says what is wrong with it
            return;
        }
        for (path, count) in &self.files {
            let is_rows = ["train/", "validation/", "test/"]
                .iter()
                .any(|folder| path.starts_with(folder))
                || path == reel_dataset::PREFERENCES;
            let stem = path
                .rsplit_once('.')
                .map_or(path.as_str(), |(stem, _)| stem);
            let beside = self.files.get(&format!("provenance/{stem}{PROVENANCE}"));
            let named = count.named.max(beside.map_or(0, |beside| beside.named));
            if is_rows && named < count.rows {
                let message = format!(
                    "{} of {} rows name no trace; export again",
                    count.rows - named,
                    count.rows
                );
                problems.add(Check::Unverified, path, None, &message);
            }
        }
    }
}

/// The verdicts of all objects that name a trace. The parser bounds the depth.
fn find_verdicts<'v>(value: &'v Value, found: &mut Vec<&'v str>) {
    match value {
        Value::Array(items) => items.iter().for_each(|item| find_verdicts(item, found)),
        Value::Object(entries) => {
            let names_trace =
                entries.contains_key("trace_digest") || entries.contains_key("trace_chain");
            if names_trace && let Some(verdict) = entries.get("verdict").and_then(Value::as_str) {
                found.push(verdict);
            }
            entries
                .values()
                .for_each(|value| find_verdicts(value, found));
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn rows_have_to_name_verified_traces() {
        let mut problems = Problems::default();
        let mut verdicts = Verdicts::new(DatasetKind::Export);
        let row = |verdict: &str| json!({"provenance": {"trace_digest": "a", "verdict": verdict}});
        let mut add = |path: &str, value: &Value| {
            let before = problems.counts().values().sum::<u64>();
            verdicts.json_row(path, 1, value, &mut problems);
            problems.counts().values().sum::<u64>() - before
        };
        assert_eq!(add("train/a.jsonl", &row("exact")), 0);
        assert_eq!(add("train/a.jsonl", &row("exact_without_rgb")), 0);
        assert_eq!(add("train/a.jsonl", &row("unverified")), 1);
        assert_eq!(add("train/b.jsonl", &json!({"verdict": "unverified"})), 0);
        assert_eq!(add("train/c.jsonl", &json!({})), 0);
        let beside = "provenance/train/c.provenance.jsonl";
        assert_eq!(add(beside, &row("exact")["provenance"]), 0);
        assert_eq!(add("values.jsonl", &json!({"trace_digest": "a"})), 0);
        verdicts.finish(&mut problems);
        let kept = problems.kept_problems();
        assert_eq!(kept.len(), 2);
        assert!(kept[1].to_string().contains("train/b.jsonl: 1 of 1 rows"));
    }
}
