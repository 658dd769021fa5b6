//! Why an episode could not be imported at all.

use std::{io, path::PathBuf};

use reel_trace::TraceError;

/// Every error of this crate.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// A folder cannot be listed.
    #[error("cannot list the folder: {source}; check the path and its permissions: {path}")]
    List {
        /// The path that could not be listed.
        path: PathBuf,
        /// The error that the operating system reported.
        source: io::Error,
    },
    /// No episode lies in the folder or below it.
    #[error(
        "no episode here: an episode's folder holds task_meta.json and step_000, step_001, ...; give the eval_output folder: {root}"
    )]
    NoEpisode {
        /// The folder that was searched for episodes.
        root: PathBuf,
    },
    /// The agent passed the episode over.
    #[error("skipped by the agent: there is nothing to import: {path}")]
    Skipped {
        /// Folder of the episode that the agent skipped.
        path: PathBuf,
    },
    /// No step can be read.
    #[error("no step can be imported ({reason}): {path}")]
    NoStep {
        /// Folder of the episode without a step that can be imported.
        path: PathBuf,
        /// What is wrong with the first one.
        reason: String,
    },
    /// The task is not known.
    #[error("the task is not known: {reason}; give its task file with --tasks: {path}")]
    Task {
        /// The episode's folder, or whatever else should have told the task.
        path: PathBuf,
        /// What is missing to determine the task.
        reason: String,
    },
    /// No recording lies in the folder or below it.
    #[error(
        "no recording here: give a file .mcap, a folder that rosbag2 wrote, or a folder of such: {root}"
    )]
    NoRecording {
        /// The path that was searched for recordings.
        root: PathBuf,
    },
    /// A recording in a form that is not read.
    #[error("{reason}: {path}")]
    Storage {
        /// The file whose storage format is not supported.
        path: PathBuf,
        /// What it is, and what to do.
        reason: String,
    },
    /// Nothing of a recording became an episode.
    #[error("no episode in the recording ({reason}): {path}")]
    Empty {
        /// The recording that yields no episode.
        path: PathBuf,
        /// What it holds instead.
        reason: String,
    },
    /// The trace cannot be written.
    #[error(transparent)]
    Trace(#[from] TraceError),
}
