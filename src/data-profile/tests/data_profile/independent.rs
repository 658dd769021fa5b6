//! The same questions to pyarrow, NumPy and DuckDB.

use std::{
    path::{Path, PathBuf},
    process::Command,
};

use reel_data_profile::{
    ColumnProfile, DiffOptions, JoinHow, JoinOptions, Numbers, ProfileOptions, diff, join, profile,
};
use serde_json::Value;
use tempfile::TempDir;

use crate::write::{lines, parquet, table};

const ROWS: u64 = 3_000;

fn set(folder: &Path, name: &str, shift: u64) -> PathBuf {
    let row = |row: u64| {
        let id = (row + shift) % (ROWS - 100);
        let score = if id.is_multiple_of(11) {
            "null".to_owned()
        } else {
            format!("{}", (id * 7919 % 1000 + shift / 4) as f64 / 8.0 - 20.0)
        };
        let tool = ["\"pick\"", "\"place\"", "\"open\"", "null"][(id * id % 9 % 4) as usize];
        let answer = "ö".repeat((id % 40) as usize);
        let turns: Vec<String> = (0..id % 5)
            .map(|turn| {
                let role = ["user", "assistant"][(turn % 2) as usize];
                format!(r#"{{"role": "{role}", "content": "{answer}{turn}"}}"#)
            })
            .collect();
        format!(
            r#"{{"id": {id}, "score": {score}, "tool": {tool}, "text": "{answer}", "messages": [{}]}}"#,
            turns.join(", ")
        )
    };
    parquet(&lines(folder, name, (0..ROWS).map(row)), "id")
}

fn close(found: f64, expected: &Value, what: &str) {
    let expected = expected.as_f64().unwrap_or_else(|| panic!("{what}"));
    let near = (found - expected).abs() <= 1e-9 * expected.abs().max(1.0);
    assert!(near, "{what}: {found}, Python has {expected}");
}

fn same_numbers(found: &Numbers, expected: &Value, what: &str) {
    close(found.min, &expected["min"], what);
    close(found.max, &expected["max"], what);
    close(found.mean, &expected["mean"], what);
    close(found.deviation, &expected["deviation"], what);
    assert!(found.exact, "{what}");
    let quantiles = expected["quantiles"].as_array().unwrap();
    assert_eq!(found.quantiles.len(), quantiles.len());
    for ((share, found), expected) in found.quantiles.iter().zip(quantiles) {
        close(*found, expected, &format!("{what} at {share}"));
    }
}

fn same_column(found: &ColumnProfile, expected: &Value) {
    let name = &found.name;
    assert_eq!(found.nulls, expected["nulls"], "{name}");
    match &found.numbers {
        Some(numbers) => {
            assert_eq!(found.distinct.unwrap(), expected["distinct"], "{name}");
            same_numbers(numbers, &expected["numbers"], name);
        }
        None => same_numbers(found.lengths.as_ref().unwrap(), &expected["lengths"], name),
    }
}

#[test]
fn python_finds_the_same() {
    let Some(python) = reel_vectors::python("duckdb, pyarrow, numpy") else {
        return;
    };
    let folder = TempDir::new().unwrap();
    let (old, new) = (
        set(folder.path(), "old.jsonl", 0),
        set(folder.path(), "new.jsonl", 700),
    );
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/check_profile.py");
    let answer = reel_vectors::run(Command::new(python).arg(script).args([&old, &new]));
    let expected: Value = serde_json::from_str(&answer).unwrap();

    let (old, new) = (table(&old), table(&new));
    let found = profile(&old, &ProfileOptions::default()).unwrap();
    let answer = &expected["profile"];
    assert_eq!(found.rows, answer["rows"]);
    assert_eq!(found.duplicates.repeated, answer["repeated"]);
    for (name, expected) in answer["columns"].as_object().unwrap() {
        let column = found.columns.iter().find(|column| column.name == *name);
        same_column(column.unwrap(), expected);
    }
    let conversation = found.conversation.unwrap();
    same_numbers(
        &conversation.answers.unwrap(),
        &answer["answers"],
        "answers",
    );
    same_numbers(
        &conversation.answer_characters.unwrap(),
        &answer["answer_characters"],
        "answer_characters",
    );

    let found = diff(&old, &new, &DiffOptions::default()).unwrap();
    for (name, expected) in expected["drift"].as_object().unwrap() {
        let column = found.columns.iter().find(|it| it.column == *name).unwrap();
        close(column.psi, &expected["psi"], &format!("PSI of {name}"));
        close(column.js, &expected["js"], &format!("JS of {name}"));
    }
    let rows = serde_json::to_value(&found.whole_rows).unwrap();
    assert_eq!(rows, expected["rows"]);

    for (name, how) in [
        ("inner", JoinHow::Inner),
        ("left", JoinHow::Left),
        ("semi", JoinHow::Semi),
        ("anti", JoinHow::Anti),
    ] {
        let options = JoinOptions {
            on: vec!["id".to_owned()],
            how,
            out: folder.path().join(format!("{name}.parquet")),
        };
        let report = join(&old, &new, &options).unwrap();
        assert_eq!(report.written, expected["joins"][name], "{name}");
    }
}
