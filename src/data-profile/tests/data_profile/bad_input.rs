//! Errors name what is wrong, the file and the line; nothing panics.

use std::{
    fs,
    panic::{AssertUnwindSafe, catch_unwind},
    path::PathBuf,
};

use polars::{df, prelude::ParquetWriter};
use reel_data_profile::{JoinHow, JoinOptions, ProfileOptions, Table, join, profile};
use tempfile::TempDir;

use crate::write::{error, lines, parquet, table, text};

fn rows(count: u32) -> Vec<String> {
    (0..count)
        .map(|id| format!(r#"{{"id": {id}, "text": "row {id}", "list": [{{"a": {id}}}]}}"#))
        .collect()
}

#[test]
fn a_broken_row_is_named_by_file_and_line() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str, content: &str| {
        let path = text(folder.path(), name, content);
        error(&path)
            .to_string()
            .replace(&format!("{}/", folder.path().display()), "")
    };
    assert_eq!(
        at("a.jsonl", "{\"a\": 1}\n\n{\"a\": x}\n"),
        "not JSON: expected value; correct or delete the row: a.jsonl:3:7"
    );
    assert_eq!(
        at("b.jsonl", "{\"a\": 1}\n{\"a\": "),
        "the last line is torn off: not JSON: EOF while parsing a value; expected one whole JSON object a line; correct or delete the row: b.jsonl:2:6"
    );
    let number = at("c.jsonl", "{\"a\": 1}\n7\n");
    assert!(
        number.contains("expected an object") && number.contains("c.jsonl:2:"),
        "{number}"
    );
    let list = at("d.json", "[{\"a\": 1},\n {\"a\": }]");
    assert!(list.contains("d.json:2:"), "{list}");
    let torn = at("e.json", "[{\"a\": 1},\n {\"a\":");
    assert!(torn.contains("torn off"), "{torn}");
}

#[test]
fn files_that_are_no_sets_are_told_as_such() {
    let folder = TempDir::new().unwrap();
    let root = folder.path();
    let message = |path: PathBuf| error(&path).to_string();
    assert!(message(root.join("missing.jsonl")).starts_with("cannot read: "));
    assert!(message(root.to_owned()).starts_with("no file of rows"));
    assert!(message(root.join("*.parquet")).starts_with("no file of rows"));
    assert!(message(text(root, "a.txt", "words")).starts_with("neither Parquet nor JSON"));
    assert!(message(text(root, "empty.jsonl", "")).starts_with("the files hold no rows"));
    assert!(message(text(root, "blank.jsonl", "\n \n")).starts_with("the files hold no rows"));
    let bare = message(text(root, "bare.jsonl", "{}\n{}\n"));
    assert!(
        bare.starts_with("the files hold no rows, or rows without a column"),
        "{bare}"
    );
    let twice = message(text(
        root,
        "twice.jsonl",
        "{\"b\": 1, \"a\": 1}\n{\"a\": 1, \"b\": 2, \"a\": 3}\n",
    ));
    assert!(twice.contains("the key \"a\" is there twice"), "{twice}");
    assert!(twice.contains("twice.jsonl:2:"), "{twice}");
    let within = message(text(
        root,
        "within.jsonl",
        "{\"a\": {\"b\": 1, \"b\": 2}}\n",
    ));
    assert!(within.contains("the key \"b\" is there twice"), "{within}");
    // a row that ends too early is named by its own line
    let torn = message(text(
        root,
        "torn.jsonl",
        "{\"a\": 1}\n{\"a\": 2\n{\"a\": 3}\n",
    ));
    assert!(torn.contains("torn.jsonl:2:8"), "{torn}");
    assert!(message(text(root, "empty.parquet", "")).starts_with("not a whole Parquet file"));
    assert!(message(text(root, "bad.parquet", "PAR1PAR1")).starts_with("not a whole Parquet file"));
    assert!(message(root.join("a[")).starts_with("invalid pattern"));
}

#[test]
fn types_that_do_not_meet_name_both_files() {
    let folder = TempDir::new().unwrap();
    let numbers = lines(
        folder.path(),
        "set/a.jsonl",
        [r#"{"id": 1, "v": 1}"#.to_owned()],
    );
    let texts = lines(
        folder.path(),
        "other/b.jsonl",
        [r#"{"id": 1, "v": "x"}"#.to_owned()],
    );
    let paths = [parquet(&numbers, "id"), parquet(&texts, "id")];
    let Err(error) = Table::open(&paths) else {
        panic!("the types meet");
    };
    let error = error.to_string();
    assert!(
        error.starts_with("column 'v' is i64 in one file and text in another"),
        "{error}"
    );
    assert!(
        error.contains("a.parquet and ") && error.contains("b.parquet"),
        "{error}"
    );
}

/// A Parquet file that is cut or has wrong bytes anywhere gives an error or other rows.
#[test]
fn damaged_parquet_never_panics() {
    let folder = TempDir::new().unwrap();
    let json = lines(folder.path(), "rows.jsonl", rows(300));
    let whole = fs::read(parquet(&json, "id")).unwrap();
    let path = folder.path().join("damaged.parquet");
    let mut refused = 0;
    let mut attempt = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        let result = catch_unwind(AssertUnwindSafe(|| {
            let table = Table::open(std::slice::from_ref(&path))?;
            profile(&table, &ProfileOptions::default())
        }));
        match result.expect("no panic") {
            Ok(_) => {}
            Err(error) => {
                refused += 1;
                assert!(error.to_string().contains("damaged.parquet"), "{error}");
            }
        }
    };
    for part in 1..8 {
        attempt(&whole[..whole.len() * part / 8]);
    }
    for step in 0..200 {
        let mut bytes = whole.clone();
        let place = 4 + step * (bytes.len() - 8) / 200;
        bytes[place] ^= if step % 2 == 0 { 0x55 } else { 0x80 };
        attempt(&bytes);
    }
    assert!(refused >= 20, "{refused}");
}

#[test]
fn a_damaged_page_is_blamed_on_its_file() {
    let folder = TempDir::new().unwrap();
    let first = parquet(&lines(folder.path(), "set/a.jsonl", rows(300)), "id");
    let second = parquet(&lines(folder.path(), "set/b.jsonl", rows(300)), "id");
    let mut bytes = fs::read(&second).unwrap();
    bytes[4..64].fill(0xff);
    fs::write(&second, bytes).unwrap();
    let table = Table::open(&[first, second]).unwrap();
    let error = profile(&table, &ProfileOptions::default())
        .unwrap_err()
        .to_string();
    assert!(error.starts_with("not a whole Parquet file"), "{error}");
    assert!(error.ends_with("b.parquet"), "{error}");
}

#[test]
fn a_column_that_is_not_there_names_those_that_are() {
    let folder = TempDir::new().unwrap();
    let table = table(&lines(folder.path(), "rows.jsonl", rows(3)));
    let options = ProfileOptions {
        keys: vec!["uid".to_owned()],
        ..ProfileOptions::default()
    };
    let error = profile(&table, &options).unwrap_err().to_string();
    assert!(
        error.starts_with("no column 'uid'; there are id, text, list: "),
        "{error}"
    );
}

#[test]
fn bytes_do_not_go_to_json() {
    let folder = TempDir::new().unwrap();
    let mut frame = df!("id" => [1_i64], "image" => [&b"\x89PNG"[..]]).unwrap();
    let path = folder.path().join("images.parquet");
    let file = fs::File::create(&path).unwrap();
    ParquetWriter::new(file).finish(&mut frame).unwrap();
    let table = table(&path);
    let options = JoinOptions {
        on: vec!["id".to_owned()],
        how: JoinHow::Semi,
        out: folder.path().join("out.jsonl"),
    };
    let error = join(&table, &table, &options).unwrap_err().to_string();
    assert!(
        error.starts_with("JSONL cannot hold column 'image'"),
        "{error}"
    );
}

#[cfg(target_os = "linux")]
#[test]
fn a_folder_that_cannot_be_written_is_told() {
    let folder = TempDir::new().unwrap();
    let table = table(&lines(folder.path(), "rows.jsonl", rows(3)));
    let options = JoinOptions {
        on: vec!["id".to_owned()],
        how: JoinHow::Semi,
        out: PathBuf::from("/proc/out.jsonl"),
    };
    let error = join(&table, &table, &options).unwrap_err().to_string();
    assert!(
        error.starts_with("cannot write: ") && error.ends_with("/proc/out.jsonl"),
        "{error}"
    );
}
