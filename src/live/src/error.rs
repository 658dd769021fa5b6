//! Why a household does not do what was asked.

use reel_episode::EpisodeError;
use reel_trace::TraceError;
use reel_world::record::EndReason;

/// Why a household does not do what was asked.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum LiveError {
    /// A call without an episode.
    #[error("no episode runs here: 'finish' begins the next one, 'finish_with_id' a certain one")]
    NoEpisode,
    /// A call after the end.
    #[error("the episode is over ({}): 'finish' begins the next one", match .0 {
        EndReason::Finished => "it was finished",
        EndReason::Horizon => "its last decision was made",
        EndReason::Fault => "the simulation failed",
        EndReason::Aborted => "it was aborted",
    })]
    Over(EndReason),
    /// A task that is not among those served.
    #[error("task '{0}' not found: 'list_tasks' says which there are")]
    UnknownTask(String),
    /// No household of this name.
    #[error("there is no session '{0}': it was closed, or never opened")]
    Unknown(String),
    /// A name that could not be one of a file.
    #[error(
        "'{0}' is no name for a session: 1 to 64 letters, digits, '-', '_' and '.', the first a letter or digit"
    )]
    Name(String),
    /// The name belongs to another prompt group.
    #[error("session '{0}' is in use; release it, or take another name")]
    Taken(String),
    /// The server is full.
    #[error("{0} sessions are open, which is the limit; close one, or raise max_sessions")]
    Full(usize),
    /// All workers are taken for too long.
    #[error("the server is busy: the call waited {0} s for a worker and was not made; call again")]
    Busy(u64),
    /// The server is about to stop.
    #[error("the server is shutting down; the call was not made")]
    Closing,
    /// What runs here broke down, and was left.
    #[error("the episode broke down and was ended: {0}; 'finish' begins the next one")]
    Broken(String),
    /// The simulator could not start the episode or restore its snapshot.
    #[error(transparent)]
    Episode(#[from] EpisodeError),
    /// The recording cannot be written.
    #[error("the recording cannot go on, so the episode was ended: {0}")]
    Recording(#[from] TraceError),
    /// A folder cannot be made.
    #[error("cannot make the folder {path}: {source}")]
    Folder {
        path: String,
        source: std::io::Error,
    },
}
