//! `reel dataset profile`, `diff` and `join` from outside: exit codes, JSON, files.

use std::fs;

use serde_json::Value;
use tempfile::TempDir;

use crate::{complaint, expect};

fn rows(range: std::ops::Range<u32>, tool: &str) -> String {
    range
        .map(|id| format!("{{\"id\": {id}, \"tool\": \"{tool}\", \"score\": {id}.5}}\n"))
        .collect()
}

#[test]
fn sets_of_any_columns_are_described_compared_and_joined() {
    let folder = TempDir::new().unwrap();
    let here = folder.path();
    fs::write(here.join("old.jsonl"), rows(0..100, "pick")).unwrap();
    fs::write(here.join("new.jsonl"), rows(50..150, "place")).unwrap();

    let json: Value =
        serde_json::from_str(&reel!(here, "dataset profile old.jsonl --json")).unwrap();
    assert_eq!(json["rows"], 100);
    assert_eq!(json["columns"][0]["numbers"]["max"], 99.0);
    let text = reel!(here, "dataset profile old.jsonl --key id --by tool");
    assert!(text.starts_with("100 rows, 1 file, "), "{text}");
    assert!(text.contains("rows that repeat the key id: 0"), "{text}");

    reel!(here, "dataset diff old.jsonl new.jsonl");
    expect(here, 1, "dataset diff old.jsonl new.jsonl --check");
    expect(here, 0, "dataset diff old.jsonl old.jsonl --check");
    let diff = reel!(here, "dataset diff old.jsonl new.jsonl --key id --json");
    let diff: Value = serde_json::from_str(&diff).unwrap();
    assert_eq!(diff["by_key"]["added"], 50);
    assert_eq!(diff["by_key"]["changed"], 50);

    let join = "dataset join old.jsonl new.jsonl --on id --out both.parquet";
    assert!(expect(here, 0, join).starts_with("50 rows in both.parquet"));
    assert!(complaint(here, 2, join).contains("the output exists"));
    reel!(
        here,
        "dataset join both.parquet old.jsonl --on id --how anti --out none.jsonl"
    );
    assert_eq!(fs::read(here.join("none.jsonl")).unwrap(), b"");

    fs::write(here.join("bad.jsonl"), "{\"id\": 1}\n{\"id\": x}\n").unwrap();
    let bad = complaint(here, 2, "dataset profile bad.jsonl");
    assert!(bad.contains("bad.jsonl:2:8"), "{bad}");
    assert!(
        complaint(here, 2, "dataset profile old.jsonl --key uid")
            .contains("there are id, tool, score")
    );
    assert!(complaint(here, 2, "dataset diff old.jsonl new.jsonl --threshold 0").contains("0.25"));
}
