//! Why an episode could not be imported at all.

use std::{io, path::PathBuf};

use reel_trace::TraceError;

/// Every error of this crate.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum ImportError {
    /// A folder cannot be listed.
    #[error("cannot list the folder: {source}; check the path and its permissions: {path}")]
    List { path: PathBuf, source: io::Error },
    /// No episode lies in the folder or below it.
    #[error(
        "no episode here: an episode's folder holds task_meta.json and step_000, step_001, ...; give the eval_output folder: {root}"
    )]
    NoEpisode { root: PathBuf },
    /// The agent passed the episode over.
    #[error("skipped by the agent, nothing to import: {path}")]
    Skipped { path: PathBuf },
    /// No step can be read.
    #[error("no step can be imported ({reason}): {path}")]
    NoStep { path: PathBuf, reason: String },
    /// The task is not known.
    #[error("the task is not known: {reason}; give its task file with --tasks: {path}")]
    Task { path: PathBuf, reason: String },
    /// No recording lies in the folder or below it.
    #[error(
        "no recording here: give a file .mcap, a folder that rosbag2 wrote, or a folder of such: {root}"
    )]
    NoRecording { root: PathBuf },
    /// No trajectory lies in the folder or below it.
    #[error(
        "no trajectory of ATIF here: give a .json file with a schema_version, or a folder of such: {root}"
    )]
    NoTrajectory { root: PathBuf },
    /// No log lies in the folder or below it.
    #[error(
        "no log of Inspect here: give a file .eval, a log in one .json file, or a folder of such: {root}"
    )]
    NoLog { root: PathBuf },
    /// No spans lie in the folder or below it.
    #[error(
        "no spans of OpenTelemetry here: give a file of OTLP (.json or .jsonl with resourceSpans, .pb, .binpb, .otlp; also .gz), or a folder of such: {root}"
    )]
    NoSpans { root: PathBuf },
    /// A recording in a form that is not read.
    #[error("{reason}: {path}")]
    Storage { path: PathBuf, reason: String },
    /// Nothing of a recording became an episode.
    #[error("no episode in the recording ({reason}): {path}")]
    Empty { path: PathBuf, reason: String },
    /// The trace cannot be written.
    #[error(transparent)]
    Trace(#[from] TraceError),
}
