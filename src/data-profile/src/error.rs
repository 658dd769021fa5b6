//! What can go wrong while data is read, compared and written, with the file and the line.

use std::{io, path::PathBuf};

use reel_dataset::lint::LintError;

/// Why a data set cannot be profiled, compared or joined.
#[derive(thiserror::Error, Debug)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum DataError {
    /// A file or folder cannot be opened, read or written.
    #[error("cannot {action}: {source}: {}", path.display())]
    Io {
        action: &'static str,
        path: PathBuf,
        source: io::Error,
    },
    /// A folder cannot be searched.
    #[error(transparent)]
    Folder(#[from] LintError),
    /// A path, folder or pattern without a file of rows.
    #[error("no file of rows: name a .parquet, .jsonl or .json file, or a folder that holds some: {}", path.display())]
    NoFiles { path: PathBuf },
    /// A pattern that is not valid.
    #[error("invalid pattern: {message}: {}", path.display())]
    Pattern { path: PathBuf, message: String },
    /// A file whose name and content are neither Parquet nor JSON.
    #[error("neither Parquet nor JSON lines; convert it, or leave it out: {}", path.display())]
    UnknownFormat { path: PathBuf },
    /// Files without any row or column.
    #[error("the files hold no rows, or rows without a column: {}", path.display())]
    Empty { path: PathBuf },
    /// A row of a JSON file that cannot be read.
    #[error("{message}; correct or delete the row: {}:{line}:{column}", path.display())]
    Row {
        path: PathBuf,
        line: u32,
        column: usize,
        message: String,
    },
    /// A Parquet file that cannot be read.
    #[error("not a whole Parquet file: {message}; write or download it again: {}", path.display())]
    Parquet { path: PathBuf, message: String },
    /// Two files give one column types that have no common type.
    #[error("column '{column}' is {left} in one file and {right} in another; convert one of them: {} and {}", left_path.display(), right_path.display())]
    Conflict {
        column: String,
        left: String,
        right: String,
        left_path: PathBuf,
        right_path: PathBuf,
    },
    /// A column that the set does not have.
    #[error("no column '{column}'; there are {known}: {}", path.display())]
    NoColumn {
        column: String,
        known: String,
        path: PathBuf,
    },
    /// Keys of two sets whose types cannot be equal.
    #[error(
        "key '{column}' is {left} in the first set and {right} in the second; convert one of them"
    )]
    KeyType {
        column: String,
        left: String,
        right: String,
    },
    /// A column that has no single type, where values are written.
    #[error("column '{column}' holds {kinds}; a join writes one type a column: convert the column, or leave it out: {}", path.display())]
    Mixed {
        column: String,
        kinds: String,
        path: PathBuf,
    },
    /// A type that the output format cannot hold.
    #[error("JSONL cannot hold column '{column}' of type {kind}; write a .parquet file instead: {}", path.display())]
    NotInJson {
        column: String,
        kind: String,
        path: PathBuf,
    },
    /// An output that is there already.
    #[error("the output exists; name another file, or delete it: {}", path.display())]
    Exists { path: PathBuf },
    /// An output of a format that is not written.
    #[error("the output must end in .parquet or .jsonl: {}", path.display())]
    OutputFormat { path: PathBuf },
    /// Polars gives up on the data.
    #[error("the data cannot be processed: {message}: {}", path.display())]
    Engine { path: PathBuf, message: String },
}

impl DataError {
    /// An input or output error with what was attempted.
    pub(crate) fn io(action: &'static str, path: &std::path::Path, source: io::Error) -> Self {
        Self::Io {
            action,
            path: path.to_owned(),
            source,
        }
    }
}
