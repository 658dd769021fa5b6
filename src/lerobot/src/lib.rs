//! LeRobot datasets of version 3: traces as one, for LeRobot's trainers, and what is wrong with one of any origin.
//!
//! Owns the folder (`meta`, `data`, `videos`), its columns and statistics. Every frame comes from executing a
//! trace again; a trace that does not replay exactly adds nothing.

mod card;
mod columns;
mod episode;
pub mod lint;
mod statistics;
mod writer;

use std::path::PathBuf;

use reel_replay::Verdict;
use reel_view::Mp4Error;

pub use card::DatasetDescription;
pub use columns::{CAMERA, PHASES, VECTOR};
pub use episode::{EncodedEpisode, ExportSettings, encode};
pub use writer::{DatasetCounts, LeRobotWriter};

/// The version of the format, as `info.json` names it.
pub const CODEBASE_VERSION: &str = "v3.0";

/// Why a dataset is not written.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum LeRobotError {
    /// The trace does not replay, or not exactly.
    #[error("not exported: {verdict}: {path}", path = path.display())]
    NotExact {
        path: PathBuf,
        verdict: Box<Verdict>,
    },
    /// An episode without a decision has no frame.
    #[error("not exported, since it has no call: {path}", path = path.display())]
    Empty { path: PathBuf },
    /// Images cannot be made smaller.
    #[error("cannot resize a frame: {reason}")]
    Resize { reason: String },
    /// A video cannot be encoded or written.
    #[error(transparent)]
    Video(#[from] Mp4Error),
    /// Columns do not hold what was meant for them.
    #[error("cannot make a table of the frames: {0}")]
    Arrow(#[from] arrow::error::ArrowError),
    /// A Parquet file cannot be written.
    #[error("cannot write a table: {source}: {path}", path = path.display())]
    Parquet {
        path: PathBuf,
        source: parquet::errors::ParquetError,
    },
    /// A file cannot be written.
    #[error("cannot write: {source}: {path}", path = path.display())]
    Write {
        path: PathBuf,
        source: std::io::Error,
    },
    /// The manifest cannot be made.
    #[error(transparent)]
    Manifest(#[from] reel_dataset::DatasetError),
}
