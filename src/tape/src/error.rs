//! Why recordings cannot be answered from.

use std::path::PathBuf;

use reel_replay::Verdict;
use reel_trace::TraceError;

/// Why recordings cannot be answered from.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum TapeError {
    /// There is no recording to answer from.
    #[error("no trace to answer from")]
    Empty,
    /// The recordings are of servers that answer differently.
    #[error(
        "{first} is of {first_server} and {other} of {other_server}: serve each kind with a server of its own",
        first = first.display(), other = other.display()
    )]
    Mixed {
        first: PathBuf,
        first_server: String,
        other: PathBuf,
        other_server: String,
    },
    /// A recording does not replay, and does not hold all that its answers need.
    #[error(
        "the answers of this recording cannot be made again: {verdict}; `reel replay {path}` tells more",
        path = path.display()
    )]
    NotExact {
        path: PathBuf,
        verdict: Box<Verdict>,
    },
    /// An image of the recording is damaged.
    #[error(transparent)]
    Trace(#[from] TraceError),
}
