//! What can go wrong; nothing of it spoils a trace.

use std::{io, path::PathBuf};

use reel_llm::client::ModelError;
use reel_world::Digest;

/// Every error of the crate.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum AnnotateError {
    /// A file of notes cannot be read.
    #[error(
        "cannot read the notes: {source}; annotate the trace first, or check the permissions: {path}"
    )]
    Read { path: PathBuf, source: io::Error },
    /// A file of notes cannot be written.
    #[error("cannot write the notes: {source}; check free space and permissions: {path}")]
    Write { path: PathBuf, source: io::Error },
    /// A line of a file of notes is none.
    #[error("line {line} is not a {expected}: {message}; annotate the trace again: {path}")]
    Malformed {
        path: PathBuf,
        /// Number of the malformed line, counted from 1.
        line: usize,
        expected: &'static str,
        /// Parser message, or that the file is empty.
        message: String,
    },
    /// The notes are those of another recording.
    #[error("the notes belong to trace {found}, not to {expected}: the trace was recorded again; annotate it again: {path}",
        found = found.short(), expected = expected.short())]
    OtherTrace {
        path: PathBuf,
        expected: Digest,
        found: Digest,
    },
    /// Some decisions have no note.
    #[error("{found} of {expected} decisions have a note; annotate the trace again: {path}")]
    Incomplete {
        path: PathBuf,
        expected: usize,
        found: usize,
    },
    /// The model did not answer.
    #[error(
        "{source}; the notes written so far are kept, run the command again to continue (decisions {from} to {to})"
    )]
    Model {
        from: usize,
        /// Last decision that was asked about, counted from 0.
        to: usize,
        source: ModelError,
    },
}
