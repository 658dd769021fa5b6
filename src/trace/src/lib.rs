//! Episodes to MCAP and back: a recorder that survives being killed, and a
//! reader that believes nothing.
//!
//! A trace is one MCAP file: our protobuf messages (`schemas/reel/v1`), one type a channel, beside
//! Foxglove's well-known ones for viewers, and task and scene as attachments. While it is recorded
//! it is `<path>.part`, without chunks; every message reached the operating system before the call
//! returns. The finished file is compressed, indexed, and covered by checksums and the hash chain.
//! Equal records give equal bytes: log times are simulation time after a fixed epoch; of episodes
//! that were not simulated here, the time their policy took. What a robot measured (`/robot/...`,
//! `/camera/original`) stands beside the records, with the clock of the robot in it; so does what else
//! its recording holds (`/recorded/...`), in the robot's own messages, what an MCP server answered (`/mcp/answer`), what
//! was said of the result where the episode ran (`/reported`), and how many secrets were replaced before it was written
//! (`/redacted`).
//!
//! Never: physics, a clock, threads. A trace opens without the simulator.

mod assembly;
mod buffer;
mod chain;
mod codec;
mod container;
mod content;
mod disk;
mod doctor;
mod error;
mod files;
mod image;
mod journal;
mod lengths;
mod limits;
mod logprobs;
mod mcp_answer;
mod reader;
mod recorder;
mod recover;
mod rewrite;
pub mod robot;
mod schema;
pub mod sensors;
mod shard;
mod trace_files;
mod unpack;
mod viewer;
mod webp;

pub use content::content;
pub use disk::{Disk, DiskFile, LocalDisk};
pub use doctor::{DoctorReport, Finding, examine};
pub use error::TraceError;
pub use files::write_new;
pub use image::{
    decode_png, decode_webp, encode_png, encode_png_fastest, encode_png16, encode_webp,
};
pub use limits::Limits;
pub use logprobs::ScoredTokens;
pub use mcp_answer::{AnsweredRequest, McpAnswers};
pub use reader::{RecordsReader, Redactions, Trace};
pub use recorder::{
    Durability, FrameLayers, Images, RecordOptions, Recorder, Timing, TraceSummary,
};
pub use recover::{Recovery, RecoveryStatus, RestoreScorer, recover, recover_on};
pub use rewrite::Rendering;
pub use shard::{
    PackedEpisode, Shard, ShardSummary, ShardWriter, member, name_of_member, trace_stem,
};
pub use trace_files::{FileMetadata, PackedFs, RemoteFs, TraceFiles, is_remote};
