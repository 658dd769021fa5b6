//! Recorded episodes as MCP servers. On tape, while an agent makes the recorded calls, it gets the
//! recorded answers, byte for byte. The first call that differs is named; from there an episode of
//! the simulator goes on live, as a branch of its recording, and any other answers what was expected.
//!
//! Never decides a call, and never writes to a recording that it answers from.

mod answers;
mod deviation;
mod error;
mod future;
mod report;
mod server;
mod session;
mod tape;

pub use deviation::{Deviation, DeviationKind, Difference, deviation};
pub use error::TapeError;
pub use report::{EpisodeReport, EpisodeStatus};
pub use server::{TapeServer, TapeSessions, TapeTransports};
pub use session::{TapeSession, TapeSettings};
pub use tape::{Tape, Tapes};
