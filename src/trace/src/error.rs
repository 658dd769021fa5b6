//! Why a trace could not be written or is not believed.

use std::{
    io,
    path::{Path, PathBuf},
};

use mcap::McapError;
use reel_world::{Digest, LogprobError};

/// Every error of this crate.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum TraceError {
    /// The operating system refused.
    #[error(
        "cannot {action} a trace: {source}; check that the folder exists and has space: {path}"
    )]
    Io {
        /// The operation that failed, e.g. `create`, `read` or `write`.
        action: &'static str,
        path: PathBuf,
        source: io::Error,
    },
    /// A recording could not be continued.
    #[error(
        "cannot write to the recording: {source}; what was acknowledged before ({}) is in it: make room, then `reel trace recover` it: {part}",
        acknowledged(*.steps)
    )]
    Write {
        /// Path of the `.part` file that holds the acknowledged steps.
        part: PathBuf,
        /// How many steps are acknowledged; none: not even the start.
        steps: Option<u32>,
        source: io::Error,
    },
    /// Somebody is writing this recording.
    #[error("the recording is still being written; recover it when its process has ended: {part}")]
    InUse {
        /// Path of the `.part` file that its recorder still holds locked.
        part: PathBuf,
    },
    /// Another file is where the recovered one should go.
    #[error(
        "cannot recover {of}: another file is in the way, and it does not hold these steps; choose a folder with --out: {path}"
    )]
    TargetExists { of: PathBuf, path: PathBuf },
    /// A file that recovery wrote because it could restore nothing.
    #[error(
        "no part of the recording {source_name} could be restored ({lost}); this file only records that: {path}"
    )]
    NothingRestored {
        path: PathBuf,
        source_name: String,
        lost: String,
    },
    /// Written again, the trace would have another last link, and nothing that names it would be true.
    #[error(
        "the messages of the trace are not in the order of a recorder, so it cannot be written again with its links; another program wrote it: {path}"
    )]
    OtherOrder { path: PathBuf },
    /// A shard does not hold the episode that is asked for.
    #[error(
        "no episode '{episode}' is among the {episodes} of the shard; name it by its id or a number from 0: {path}"
    )]
    NotInShard {
        path: PathBuf,
        episode: String,
        /// How many episodes the shard holds.
        episodes: u32,
    },
    /// An episode of a shard is not there until it is executed.
    #[error("{problem}: {path}")]
    Packed {
        path: PathBuf,
        /// Why it cannot be executed, or what came of it instead.
        problem: String,
    },
    /// A recording of this name was left unfinished.
    #[error("an unfinished recording is in the way; recover or delete it first: {part}")]
    PartExists {
        /// Path of the `.part` file that is in the way.
        part: PathBuf,
    },
    /// There is only an unfinished recording of this name.
    #[error("the recording was never finished; read what there is from {part}")]
    Unfinished {
        /// Path of the `.part` file that there is instead of the trace.
        part: PathBuf,
    },
    /// The file is larger than the reader's limit.
    #[error(
        "the trace has {found} bytes, more than the limit of {limit}; raise the limit if it is yours: {path}"
    )]
    TooLarge {
        path: PathBuf,
        /// Largest file that the reader accepts, in bytes.
        limit: u64,
        /// Size of the file that was found, in bytes.
        found: u64,
    },
    /// Not an MCAP file.
    #[error("not an MCAP file: it does not begin with the magic bytes: {path}")]
    NotMcap { path: PathBuf },
    /// The file ends too early.
    #[error(
        "the trace is torn at byte {offset}: {lost}; {steps_readable} steps are readable, recover them: {path}"
    )]
    Torn {
        path: PathBuf,
        offset: u64,
        steps_readable: u32,
        lost: String,
    },
    /// A checksum or a record of the container is wrong.
    #[error(
        "the trace is damaged at byte {offset}: {problem}; take another copy or record it again: {path}"
    )]
    Damaged {
        path: PathBuf,
        /// Byte offset of the damaged record or chunk; 0 for an attachment that does not parse.
        offset: u64,
        problem: String,
    },
    /// A message is not what its schema says, or is missing, twice or in the wrong place.
    #[error(
        "{topic} at byte {offset} does not belong in a trace: {problem}; it was changed or written by another program: {path}"
    )]
    Message {
        path: PathBuf,
        offset: u64,
        /// Topic of the message's channel, e.g. `/tool/call`.
        topic: String,
        problem: String,
    },
    /// Something that every trace holds is not there.
    #[error("the trace holds no {part}; it was cut or written by another program: {path}")]
    Missing {
        path: PathBuf,
        /// What the trace lacks, e.g. `end of the episode` or `task.json`.
        part: &'static str,
    },
    /// An attachment is not the one that the header names, or no valid one.
    #[error(
        "{attachment} is not the one of this episode (expected digest {expected}, found {found}): {path}"
    )]
    Attachment {
        path: PathBuf,
        /// Name of the attachment: `task.json` or `scene.json`.
        attachment: &'static str,
        expected: Digest,
        found: Digest,
    },
    /// A record is not what was recorded: the hash chain does not hold.
    #[error("the hash chain breaks at {}: expected {expected}, found {found}; the records were changed: {path}", position(*.step))]
    ChainBroken {
        path: PathBuf,
        /// The step; none: the start.
        step: Option<u32>,
        expected: Digest,
        found: Digest,
    },
    /// An image cannot be read or is not the recorded one.
    #[error("the image of {} {problem}; it was changed or damaged: {path}", position(*.step))]
    Image {
        path: PathBuf,
        /// The step; none: the start.
        step: Option<u32>,
        problem: String,
    },
    /// Log-probabilities that are not of the recorded tokens.
    #[error("log-probabilities of step {step} are refused: {source}: {path}")]
    Logprobs {
        path: PathBuf,
        /// Number of the decision, from 0.
        step: u32,
        source: LogprobError,
    },
    /// A decision without recorded tokens.
    #[error(
        "step {step} has no recorded tokens to score; record the episode with `reel bench --logprobs`: {path}"
    )]
    NoTokens {
        path: PathBuf,
        /// Number of the decision, from 0.
        step: u32,
    },
    /// A line that holds no log-probabilities of a decision.
    #[error(
        "line {line} is not a JSON object of episode_id, step, policy, logprobs and, if known, tokens ({problem}); `reel trace logprobs list` shows the form: {path}"
    )]
    ScoredLine {
        path: PathBuf,
        /// Line of the file, counted from 1.
        line: u32,
        problem: String,
    },
    /// The recorder was called out of turn.
    #[error("cannot record {record}: {expected} comes next: {path}")]
    UnexpectedCall {
        path: PathBuf,
        record: String,
        expected: String,
    },
}

impl TraceError {
    /// What the writer of MCAP files says of a trace, or of a shard.
    pub(crate) fn unwritten(path: &Path, error: McapError) -> Self {
        let source = match error {
            McapError::Io(source) => source,
            other => io::Error::other(other),
        };
        TraceError::Io {
            action: "write",
            path: path.to_owned(),
            source,
        }
    }

    /// Where in the file it is wrong, if that is one place.
    pub fn offset(&self) -> Option<u64> {
        match self {
            TraceError::Torn { offset, .. }
            | TraceError::Damaged { offset, .. }
            | TraceError::Message { offset, .. } => Some(*offset),
            TraceError::NotMcap { .. } => Some(0),
            _ => None,
        }
    }

    /// The file that the operating system refused, and why; none where it refused nothing.
    pub fn refused(&self) -> Option<(&Path, &io::Error)> {
        match self {
            TraceError::Io { path, source, .. }
            | TraceError::Write {
                part: path, source, ..
            } => Some((path, source)),
            _ => None,
        }
    }
}

/// What is acknowledged, in words.
fn acknowledged(steps: Option<u32>) -> String {
    steps.map_or_else(
        || "nothing".to_owned(),
        |steps| format!("the start and {steps} calls"),
    )
}

/// A step in words.
pub(crate) fn position(step: Option<u32>) -> String {
    step.map_or_else(|| "the start".to_owned(), |step| format!("step {step}"))
}
