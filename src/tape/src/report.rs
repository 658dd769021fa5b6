//! How an agent went along a recording, for people and machines.

use std::path::PathBuf;

use serde::Serialize;

use crate::Deviation;

/// How an agent went along a recording.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EpisodeStatus {
    /// Every recorded call was made, and no other.
    OnTape,
    /// A call differs, is missing, or was made after the last.
    Deviated,
    /// The episode began and no call was made in it.
    Unplayed,
    /// The recording cannot be answered from.
    Refused,
}

/// How an agent went along one recording.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct EpisodeReport {
    /// The session in which it was played.
    pub session: String,
    /// Path of the recording that was answered from.
    pub trace: PathBuf,
    /// Id of the recorded task.
    pub task_id: String,
    /// How the agent went along it.
    pub status: EpisodeStatus,
    /// How many recorded calls were made before the first that differs.
    pub calls_on_tape: u32,
    /// How many calls the recording has.
    pub calls_recorded: u32,
    /// Where the agent left it; `None` if it did not.
    pub deviation: Option<Deviation>,
    /// The trace of what followed in the simulator; `None` if nothing did.
    pub branch: Option<PathBuf>,
    /// Whether the goal held at the end of what followed in the simulator, else whether the
    /// recording succeeded; `None` if nobody judged it, as where its task has no goal.
    pub success: Option<bool>,
    /// Why the recording cannot be answered from, or what followed could not be simulated.
    pub reason: Option<String>,
}
