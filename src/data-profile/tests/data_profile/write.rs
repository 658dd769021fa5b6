//! Files of the tests.

use std::{
    fs,
    path::{Path, PathBuf},
};

use reel_data_profile::{DataError, JoinHow, JoinOptions, Table, join};

/// Writes a text and gives its path.
pub fn text(folder: &Path, name: &str, text: &str) -> PathBuf {
    let path = folder.join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(&path, text).unwrap();
    path
}

/// Lines of JSON as a file.
pub fn lines(folder: &Path, name: &str, rows: impl IntoIterator<Item = String>) -> PathBuf {
    let rows: Vec<String> = rows.into_iter().collect();
    text(folder, name, &format!("{}\n", rows.join("\n")))
}

/// A JSONL file as Parquet, beside it: a semi-join of the file with itself.
pub fn parquet(path: &Path, key: &str) -> PathBuf {
    let out = path.with_extension("parquet");
    let (left, right) = (table(path), table(path));
    let options = JoinOptions {
        on: vec![key.to_owned()],
        how: JoinHow::Semi,
        out: out.clone(),
    };
    join(&left, &right, &options).unwrap();
    out
}

pub fn table(path: &Path) -> Table {
    Table::open(&[path.to_owned()]).unwrap_or_else(|error| panic!("{error}"))
}

pub fn error(path: &Path) -> DataError {
    match Table::open(&[path.to_owned()]) {
        Ok(_) => panic!("{} is read", path.display()),
        Err(error) => error,
    }
}
