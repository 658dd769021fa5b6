//! Why an episode could not be imported at all.

use std::{io, path::PathBuf};

use reel_trace::TraceError;

/// Every error of this crate.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// A folder cannot be listed.
    #[error("cannot list the folder: {source}; check the path and its permissions: {path}")]
    List {
        /// The folder.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// No episode there.
    #[error(
        "no episode here: an episode's folder holds task_meta.json and step_000, step_001, ...; give the eval_output folder: {root}"
    )]
    NoEpisode {
        /// The folder.
        root: PathBuf,
    },
    /// The agent passed the episode over.
    #[error("skipped by the agent: there is nothing to import: {path}")]
    Skipped {
        /// The episode's folder.
        path: PathBuf,
    },
    /// No step can be read.
    #[error("no step can be imported ({what}): {path}")]
    NoStep {
        /// The episode's folder.
        path: PathBuf,
        /// What is wrong with the first one.
        reason: String,
    },
    /// The task is not known.
    #[error("the task is not known: {what}; give its task file with --tasks: {path}")]
    Task {
        /// The episode's folder.
        path: PathBuf,
        /// What is missing.
        reason: String,
    },
    /// No recording there.
    #[error(
        "no recording here: give a file .mcap, a folder that rosbag2 wrote, or a folder of such: {root}"
    )]
    NoRecording {
        /// What was given.
        root: PathBuf,
    },
    /// A recording in a form that is not read.
    #[error("{what}: {path}")]
    Storage {
        /// The file.
        path: PathBuf,
        /// What it is, and what to do.
        reason: String,
    },
    /// Nothing of a recording became an episode.
    #[error("no episode in the recording ({what}): {path}")]
    Empty {
        /// The recording.
        path: PathBuf,
        /// What it holds instead.
        reason: String,
    },
    /// The trace cannot be written.
    #[error(transparent)]
    Trace(#[from] TraceError),
}
