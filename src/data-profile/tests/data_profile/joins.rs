//! Which rows a join writes, and what it tells.

use std::{fs, path::Path};

use reel_data_profile::{DataError, JoinHow, JoinOptions, JoinReport, join};
use serde_json::Value;
use tempfile::TempDir;

use crate::write::{lines, parquet, table};

fn read(path: &Path) -> Vec<Value> {
    let text = fs::read_to_string(path).unwrap();
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

fn joined(
    folder: &Path,
    how: JoinHow,
    left: &[&str],
    right: &[&str],
) -> Result<(JoinReport, Vec<Value>), DataError> {
    let owned = |rows: &[&str]| rows.iter().map(|row| (*row).to_owned()).collect::<Vec<_>>();
    let left = lines(folder, "left.jsonl", owned(left));
    let right = lines(folder, "right.jsonl", owned(right));
    let out = folder.join("out.jsonl");
    let _ = fs::remove_file(&out);
    let options = JoinOptions {
        on: vec!["id".to_owned()],
        how,
        out: out.clone(),
    };
    let report = join(&table(&left), &table(&right), &options)?;
    Ok((report, read(&out)))
}

const LEFT: [&str; 5] = [
    r#"{"id": 3, "text": "c", "meta": {"ok": true, "n": [1, 2]}}"#,
    r#"{"id": 1, "text": "a", "meta": {"ok": false, "n": []}}"#,
    r#"{"id": 1, "text": "again", "meta": null}"#,
    r#"{"id": null, "text": "nobody", "meta": null}"#,
    r#"{"id": 9, "text": "alone", "meta": null}"#,
];
const RIGHT: [&str; 4] = [
    r#"{"id": 1, "label": "one", "text": "r1"}"#,
    r#"{"id": 3, "label": "three", "text": "r3"}"#,
    r#"{"id": 5, "label": "five", "text": "r5"}"#,
    r#"{"id": null, "label": "none", "text": "r0"}"#,
];

#[test]
fn each_kind_keeps_its_rows_in_the_order_of_the_left_set() {
    let folder = TempDir::new().unwrap();
    let texts = |how| {
        let (report, rows) = joined(folder.path(), how, &LEFT, &RIGHT).unwrap();
        assert_eq!(report.written, rows.len() as u64);
        let texts: Vec<String> = rows
            .iter()
            .map(|row| row["text"].as_str().unwrap().to_owned())
            .collect();
        (report, rows, texts)
    };
    let (report, rows, inner) = texts(JoinHow::Inner);
    assert_eq!(inner, ["c", "a", "again"]);
    assert_eq!(
        rows[0]["meta"],
        serde_json::json!({"ok": true, "n": [1, 2]})
    );
    assert_eq!(rows[0]["text_right"], "r3");
    assert_eq!(
        report.renamed,
        [("text".to_owned(), "text_right".to_owned())]
    );
    assert_eq!((report.rows, report.unmatched), ([5, 4], [2, 2]));
    assert_eq!(
        (report.duplicate_keys, report.without_key),
        ([1, 0], [1, 1])
    );
    assert!(!report.multiplies());
    let (_, rows, left) = texts(JoinHow::Left);
    assert_eq!(left, ["c", "a", "again", "nobody", "alone"]);
    assert_eq!(rows[3]["label"], Value::Null);
    assert_eq!(texts(JoinHow::Semi).2, ["c", "a", "again"]);
    assert_eq!(texts(JoinHow::Anti).2, ["nobody", "alone"]);
}

#[test]
fn a_join_that_multiplies_rows_is_told() {
    let folder = TempDir::new().unwrap();
    let twice = [RIGHT[0], RIGHT[0], RIGHT[1]];
    let (report, rows) = joined(folder.path(), JoinHow::Left, &LEFT, &twice).unwrap();
    assert_eq!(rows.len(), 7);
    assert!(report.multiplies());
    assert_eq!((report.many_to_many, report.duplicate_keys), (1, [1, 1]));
    let text = report.to_string();
    assert!(
        text.contains("the join multiplies rows: 5 of the left set became 7"),
        "{text}"
    );
}

#[test]
fn parquet_and_jsonl_join_into_parquet() {
    let folder = TempDir::new().unwrap();
    let rows = |name: &str| {
        let rows = (0..5_000).map(|id| format!(r#"{{"id": {id}, "{name}": "{}"}}"#, id % 7));
        lines(folder.path(), &format!("{name}.jsonl"), rows)
    };
    let left = parquet(&rows("a"), "id");
    let out = folder.path().join("out.parquet");
    let options = JoinOptions {
        on: vec!["id".to_owned()],
        how: JoinHow::Inner,
        out: out.clone(),
    };
    let report = join(&table(&left), &table(&rows("b")), &options).unwrap();
    assert_eq!((report.written, report.unmatched), (5_000, [0, 0]));
    assert_eq!(table(&out).columns().len(), 3);
}

#[test]
fn what_cannot_be_joined_is_refused_and_leaves_no_file() {
    let folder = TempDir::new().unwrap();
    let root = folder.path();
    let error = joined(root, JoinHow::Inner, &LEFT, &[r#"{"id": "1"}"#]).unwrap_err();
    assert!(matches!(error, DataError::KeyType { .. }), "{error}");
    let mixed = [r#"{"id": 1, "v": 1}"#, r#"{"id": 1, "v": "1"}"#];
    let error = joined(root, JoinHow::Inner, &LEFT, &mixed).unwrap_err();
    assert!(matches!(error, DataError::Mixed { .. }), "{error}");
    // The right side of a semi-join is not written.
    joined(root, JoinHow::Semi, &LEFT, &mixed).unwrap();
    let (left, right) = (
        table(&root.join("left.jsonl")),
        table(&root.join("right.jsonl")),
    );
    let mut options = JoinOptions {
        on: vec!["id".to_owned()],
        how: JoinHow::Semi,
        out: root.join("out.jsonl"),
    };
    let error = join(&left, &right, &options).unwrap_err();
    assert!(matches!(error, DataError::Exists { .. }), "{error}");
    options.out = root.join("out.csv");
    let error = join(&left, &right, &options).unwrap_err();
    assert!(matches!(error, DataError::OutputFormat { .. }), "{error}");
    options.out = root.join("missing/out.jsonl");
    let error = join(&left, &right, &options).unwrap_err().to_string();
    assert!(error.starts_with("cannot write: "), "{error}");
    let left_over: Vec<_> = fs::read_dir(root)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name.starts_with(".reel"))
        .collect();
    assert_eq!(left_over, [""; 0]);
}

#[test]
fn a_key_of_several_columns_joins_on_all_of_them() {
    let folder = TempDir::new().unwrap();
    let rows = |name: &str, step: u32| {
        let rows = (0..100).map(|row| {
            format!(
                r#"{{"episode": "e{}", "call": {}, "{name}": {row}}}"#,
                row / 10,
                row % 10 * step
            )
        });
        lines(folder.path(), &format!("{name}.jsonl"), rows)
    };
    let options = JoinOptions {
        on: vec!["episode".to_owned(), "call".to_owned()],
        how: JoinHow::Inner,
        out: folder.path().join("out.jsonl"),
    };
    let report = join(&table(&rows("a", 1)), &table(&rows("b", 2)), &options).unwrap();
    assert_eq!((report.written, report.unmatched), (50, [50, 50]));
}

#[test]
fn fields_of_structs_are_keys_too() {
    let folder = TempDir::new().unwrap();
    let rows = |name: &str, range: std::ops::Range<u32>| {
        let rows =
            range.map(|row| format!(r#"{{"{name}": {row}, "from": {{"id": {row}, "x": 1}}}}"#));
        table(&lines(folder.path(), &format!("{name}.jsonl"), rows))
    };
    let options = JoinOptions {
        on: vec!["from.id".to_owned()],
        how: JoinHow::Inner,
        out: folder.path().join("out.jsonl"),
    };
    let (left, right) = (rows("a", 0..10), rows("b", 5..20));
    let report = join(&left, &right, &options).unwrap();
    assert_eq!((report.written, report.unmatched), (5, [5, 10]));
    let first = &read(&options.out)[0];
    let expected = serde_json::json!({
        "a": 5, "from": {"id": 5, "x": 1}, "b": 5, "from_right": {"id": 5, "x": 1},
    });
    assert_eq!(*first, expected);
    let keyed = reel_data_profile::DiffOptions {
        keys: vec!["from.id".to_owned()],
        ..Default::default()
    };
    let found = reel_data_profile::diff(&left, &right, &keyed).unwrap();
    let keys = found.by_key.unwrap();
    assert_eq!((keys.unchanged, keys.removed, keys.added), (5, 5, 10));
}
