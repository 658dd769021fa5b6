//! What cannot be read: a whole path ([`LintError`]), or one row of a file that
//! is otherwise fine ([`RowError`]).

use std::{io, path::PathBuf};

use parquet::errors::ParquetError;

use crate::lint::RowLocation;

/// Why a dataset does not open.
#[derive(thiserror::Error, Debug)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum LintError {
    /// The path cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Io { path: PathBuf, source: io::Error },
    /// A folder without a file of rows.
    #[error("no .json, .jsonl or .parquet file with training rows: name the folder that holds them: {}", path.display())]
    NoRows { path: PathBuf },
    /// None of the six formats.
    #[error("not a training set: {found}; expected {expected}: {}", path.display())]
    NotRecognised {
        path: PathBuf,
        found: String,
        expected: &'static str,
    },
    /// Not a Parquet file, or a torn one.
    #[error("not a whole Parquet file: {source}: {}", path.display())]
    Parquet { path: PathBuf, source: ParquetError },
}

/// A row that cannot be read; the rows after it can.
#[derive(thiserror::Error, Clone, PartialEq, Eq, Debug)]
#[error("{message}")]
pub struct RowError {
    /// Location of the unreadable row in the dataset.
    pub location: RowLocation,
    /// Column of the offending character in its line, from 1; 0 where there is none.
    pub column: usize,
    /// What is wrong and what was expected.
    pub message: String,
}
