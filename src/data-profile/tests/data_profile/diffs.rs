//! What is said of two versions of a set.

use reel_data_profile::{DataError, Diff, DiffOptions, diff};
use tempfile::TempDir;

use crate::write::{lines, parquet, table};

fn row(id: u32, score: f64, tool: &str) -> String {
    format!(r#"{{"id": {id}, "score": {score}, "tool": "{tool}"}}"#)
}

fn rows(count: u32, shift: f64, tools: &[&str]) -> Vec<String> {
    (0..count)
        .map(|id| {
            let tool = tools[id as usize % tools.len()];
            row(id, f64::from(id % 100) + shift, tool)
        })
        .collect()
}

fn compare(old: Vec<String>, new: Vec<String>, options: &DiffOptions) -> Diff {
    let folder = TempDir::new().unwrap();
    let old = lines(folder.path(), "old.jsonl", old);
    let new = lines(folder.path(), "new.jsonl", new);
    diff(&table(&old), &table(&new), options).unwrap_or_else(|error| panic!("{error}"))
}

fn keyed() -> DiffOptions {
    DiffOptions {
        keys: vec!["id".to_owned()],
        by: vec!["tool".to_owned()],
        ..DiffOptions::default()
    }
}

#[test]
fn a_set_equals_itself_in_either_format() {
    let folder = TempDir::new().unwrap();
    let json = lines(folder.path(), "a.jsonl", rows(300, 0.5, &["pick", "place"]));
    let parquet = parquet(&json, "id");
    let same = diff(&table(&json), &table(&parquet), &keyed()).unwrap();
    assert!(!same.is_drifted(), "{same}");
    assert_eq!((same.whole_rows.unchanged, same.whole_rows.added), (300, 0));
    assert_eq!(same.by_key.unwrap().unchanged, 300);
    assert!(
        same.columns
            .iter()
            .all(|it| it.psi.abs() < 1e-9 && it.js == 0.0)
    );
}

#[test]
fn rows_are_added_removed_and_changed() {
    let old = rows(100, 0.5, &["pick"]);
    let mut new = old[10..].to_vec();
    new.push(new[0].clone());
    new[5] = row(15, -1.0, "pick");
    new.extend([row(200, 1.5, "pick"), row(201, 1.5, "pick")]);
    let found = compare(old, new, &keyed());
    assert_eq!(found.rows, [100, 93]);
    let whole = found.whole_rows;
    assert_eq!((whole.unchanged, whole.removed, whole.added), (89, 11, 4));
    let keys = found.by_key.unwrap();
    assert_eq!((keys.added, keys.removed), (2, 10));
    assert_eq!((keys.unchanged, keys.changed), (88, 2));
    assert_eq!(keys.duplicated, [0, 1]);
}

#[test]
fn shifted_numbers_and_other_classes_drift() {
    let old = rows(1_000, 0.5, &["pick", "place"]);
    let new = rows(1_000, 30.5, &["pick", "pick", "pick", "open"]);
    let found = compare(old, new, &keyed());
    let column = |name: &str| found.columns.iter().find(|it| it.column == name).unwrap();
    assert!(column("score").drifted && column("tool").drifted, "{found}");
    assert!(!column("id").drifted);
    assert_eq!(column("tool").compared, "values");
    // Shares 1/2, 1/2, 0 against 3/4, 0, 1/4, by hand.
    let js = column("tool").js;
    assert!((js - 0.3931).abs() < 0.001, "{js}");
    assert!(found.is_drifted());
    let loose = DiffOptions {
        threshold: 1e6,
        ..DiffOptions::default()
    };
    let unchanged = rows(100, 0.5, &["pick"]);
    assert!(!compare(unchanged, rows(100, 30.5, &["pick"]), &loose).is_drifted());
    let text = found.to_string();
    assert!(text.contains("drifted") && text.contains("pick"), "{text}");
    assert!(text.contains("50.0% -> 75.0%"), "{text}");
}

#[test]
fn columns_are_added_removed_and_retyped() {
    let old = [r#"{"id": 1, "gone": "x", "kind": 3}"#.to_owned()];
    let new = [r#"{"id": 1, "kind": "3", "fresh": [0.5]}"#.to_owned()];
    let found = compare(old.to_vec(), new.to_vec(), &DiffOptions::default());
    let shown: Vec<String> = found.schema.iter().map(ToString::to_string).collect();
    assert_eq!(
        shown,
        [
            "column gone removed: text",
            "column kind: i64 -> text",
            "column fresh added: list[f64]",
        ]
    );
    assert!(found.is_drifted());
    // What both have is compared: the id.
    assert_eq!(found.whole_rows.unchanged, 1);
}

#[test]
fn more_nulls_are_drift() {
    let old = rows(200, 0.5, &["pick"]);
    let new = old
        .iter()
        .enumerate()
        .map(|(index, row)| {
            if index % 2 == 0 {
                row.replace("\"pick\"", "null")
            } else {
                row.clone()
            }
        })
        .collect();
    let found = compare(old, new, &DiffOptions::default());
    let tool = found.columns.iter().find(|it| it.column == "tool").unwrap();
    assert!(tool.drifted);
    assert_eq!(tool.null_share, [0.0, 0.5]);
}

#[test]
fn keys_have_to_be_there_and_comparable() {
    let folder = TempDir::new().unwrap();
    let numbers = table(&lines(
        folder.path(),
        "a.jsonl",
        [r#"{"id": 1}"#.to_owned()],
    ));
    let texts = table(&lines(
        folder.path(),
        "b.jsonl",
        [r#"{"id": "1"}"#.to_owned()],
    ));
    let error = diff(
        &numbers,
        &texts,
        &DiffOptions {
            by: vec![],
            ..keyed()
        },
    )
    .unwrap_err();
    assert!(matches!(error, DataError::KeyType { .. }), "{error}");
    let missing = DiffOptions {
        keys: vec!["uid".to_owned()],
        ..DiffOptions::default()
    };
    let error = diff(&numbers, &texts, &missing).unwrap_err().to_string();
    assert!(
        error.starts_with("no column 'uid'; there are id: "),
        "{error}"
    );
}

#[test]
fn longer_answers_drift() {
    let row = |length: usize| {
        let answer = "x".repeat(length);
        format!(
            r#"{{"messages": [{{"role": "user", "content": "?"}}, {{"role": "assistant", "content": "{answer}"}}]}}"#
        )
    };
    let old = (0..100).map(|index| row(10 + index % 20)).collect();
    let new = (0..100).map(|index| row(20 + index % 20)).collect();
    let found = compare(old, new, &DiffOptions::default());
    let drift = |name: &str| found.columns.iter().find(|it| it.column == name).unwrap();
    assert!(drift("conversation.answer_characters").drifted, "{found}");
    assert_eq!(
        drift("conversation.answer_characters").mean,
        Some([19.5, 29.5])
    );
    assert_eq!(drift("conversation.turns").psi, 0.0);
    assert_eq!(drift("messages").psi, 0.0);
}

#[test]
fn texts_that_name_their_rows_are_compared_by_length() {
    let rows = |prefix: &str| {
        (0..50)
            .map(|row| format!(r#"{{"id": "{prefix}{row:02}"}}"#))
            .collect()
    };
    let found = compare(rows("a"), rows("b"), &DiffOptions::default());
    assert_eq!(found.columns[0].compared, "characters");
    assert!(!found.is_drifted());
}
