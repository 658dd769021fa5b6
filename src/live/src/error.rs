//! Errors of live sessions. Clients hear them: they name traces, and never where these lie.

use reel_episode::EpisodeError;
use reel_trace::TraceError;
use reel_world::record::EndReason;

/// An error of a live session.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum LiveError {
    /// A call without an episode.
    #[error(
        "no episode is running; call 'finish' to begin the next one, or 'finish_with_id' to choose its task"
    )]
    NoEpisode,
    /// A call after the end.
    #[error("the episode is over ({}): call 'finish' to begin the next one", match .0 {
        EndReason::Finished => "it was finished",
        EndReason::Horizon => "its last decision was made",
        EndReason::Fault => "the simulation failed",
        EndReason::Aborted => "it was aborted",
    })]
    Over(EndReason),
    /// A task that is not among those served.
    #[error("task '{0}' not found; call 'list_tasks' to list the tasks")]
    UnknownTask(String),
    /// No session has this name.
    #[error("unknown session '{0}': it was closed, or never opened")]
    Unknown(String),
    /// A name that could not be one of a file.
    #[error(
        "invalid session name '{0}': 1 to 64 letters, digits, '-', '_' and '.', the first a letter or digit"
    )]
    Name(String),
    /// The name belongs to another prompt group.
    #[error("session '{0}' is in use; release it, or take another name")]
    Taken(String),
    /// Another token opened the session.
    #[error("session '{0}' belongs to another token; take another name")]
    OtherOwner(String),
    /// A token has as many sessions as it may have.
    #[error(
        "token '{owner}' has {limit} sessions, as many as it may (limits.sessions_per_token); close one"
    )]
    Quota { owner: String, limit: usize },
    /// The server is full.
    #[error("the limit of {0} open sessions is reached; close one, or raise limits.sessions")]
    Full(usize),
    /// All workers are taken for too long.
    #[error(
        "the server is busy: the call waited {0} s for a worker and was not executed; call again"
    )]
    Busy(u64),
    /// Nobody says what a query means.
    #[error(
        "what this category means cannot be looked up now; the call was not executed; call again later"
    )]
    NoLookUp,
    /// The user who is to answer does not.
    #[error(
        "the user cannot be reached now; the question was not executed; ask again later, or go on without an answer"
    )]
    NoUser,
    /// Another call came first, or the episode ended.
    #[error(
        "another call was made, or the episode ended, while this one waited; it was not executed"
    )]
    Overtaken,
    /// The server is about to stop.
    #[error("the server is shutting down; the call was not executed")]
    Closing,
    /// What runs here broke down, and was left.
    #[error("the episode failed and was ended: {0}; call 'finish' to begin the next one")]
    Broken(String),
    /// A recorded episode cannot be continued from the call that was asked for.
    #[error("no episode can start from that call: {0}")]
    Branch(String),
    /// The simulator could not start the episode or restore its snapshot.
    #[error(transparent)]
    Episode(#[from] EpisodeError),
    /// The recording cannot be written.
    #[error("recording failed and the episode was ended: {}", refused(.0))]
    Recording(#[from] TraceError),
    /// A folder cannot be made.
    #[error("the folder of traces cannot be made: {source}")]
    Folder {
        path: String,
        source: std::io::Error,
    },
}

/// Why a trace cannot be written, by its name.
fn refused(error: &TraceError) -> String {
    let Some((path, source)) = error.refused() else {
        return "its trace cannot be written".to_owned();
    };
    let file = path.file_name().unwrap_or_default().to_string_lossy();
    let name = file.split(".mcap").next().unwrap_or_default();
    format!("{source}: trace {name}")
}
