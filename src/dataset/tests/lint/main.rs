//! Training sets as people write them, good and spoiled, through the whole of lint.

mod faults;
mod leaks;
mod likeness;
mod ours;
mod reading;

use std::{
    fs,
    path::{Path, PathBuf},
};

use reel_dataset::lint::{CheckReport, Dataset, LintOptions, Report, lint};
use serde_json::{Value, json};
use tempfile::TempDir;

/// A folder with files in it.
struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        Self(TempDir::new().expect("a folder for the test"))
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path().join(name);
        fs::create_dir_all(path.parent().expect("it has a folder")).expect("a folder");
        fs::write(&path, bytes).expect("a file");
        path
    }

    fn lines(&self, name: &str, rows: &[Value]) -> PathBuf {
        self.write(
            name,
            rows.iter()
                .map(|row| format!("{row}\n"))
                .collect::<String>(),
        )
    }
}

fn open(path: &Path) -> Dataset {
    Dataset::open(&[path.to_owned()], None, None).unwrap_or_else(|error| panic!("{error}"))
}

fn linted(path: &Path) -> Report {
    lint(&open(path), &LintOptions::default(), |_| ())
}

/// A check of a report.
fn of<'r>(report: &'r Report, check: &str) -> &'r CheckReport {
    report
        .check(check)
        .unwrap_or_else(|| panic!("there is no check {check}"))
}

/// Number of findings of a kind.
fn count(report: &Report, check: &str, kind: &str) -> u64 {
    of(report, check).kinds.get(kind).copied().unwrap_or(0)
}

/// A PNG without pixels, whole enough for its header to be read.
fn png(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec();
    bytes.extend(width.to_be_bytes());
    bytes.extend(height.to_be_bytes());
    bytes.extend(b"\x08\x02\0\0\0crc_\0\0\0\0IDATcrc_\0\0\0\0IENDcrc_");
    bytes
}

const TOOLS: &str = r#"[{"name":"nav_to","description":"Go to a viewpoint of the named receptacle and look at it.","parameters":{"type":"object","properties":{"receptacle_name":{"type":"string"}},"required":["receptacle_name"]}},{"name":"pick","description":"Pick up the object with this number.","parameters":{"type":"object","properties":{"marker_id":{"type":"integer"}},"required":["marker_id"]}},{"name":"finish","description":"End the episode when the task is done.","parameters":{"type":"object","properties":{},"required":[]}}]"#;

/// A prompt of the single-turn form.
fn prompt(task: &str, outcome: &str) -> String {
    format!(
        "Task: {task}\n\nTools:\n{TOOLS}\n\nReceptacles:\n- table_1 (table, kitchen/0)\n- fridge_1 (fridge, kitchen/0)\n\nProgress:\n\
         I went to table_1 and saw 2 cups.\n\nLast action: {{\"tool_name\":\"nav_to\",\"args\":{{\"receptacle_name\":\"table_1\"}}}}\n\
         Last outcome: {outcome}\n\nCurrent view: <image>"
    )
}

/// An answer of the single-turn form.
fn answer(tool: &str, args: Value) -> String {
    let object = json!({
        "summary": {
            "History": "I went to table_1. I looked for cups and saw 2 candidates.",
            "New Schedule": "pick up the cup; go to fridge_1",
            "Current subtask": "pick up the cup",
        },
        "next action": { "tool_name": tool, "args": args },
    });
    format!("<think>The red cup has number 1.</think>\n{object}")
}

/// A row in the form of ms-swift, with its image beside the file.
fn swift(task: &str, outcome: &str, tool: &str, args: Value) -> Value {
    json!({
        "messages": [
            { "role": "system", "content": "You are a household robot with one gripper." },
            { "role": "user", "content": prompt(task, outcome) },
            { "role": "assistant", "content": answer(tool, args) },
        ],
        "images": ["view.png"],
    })
}
