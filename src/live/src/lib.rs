//! Live worlds for agents that come from outside: sessions, each with an exclusive simulator
//! that plays one episode after another and records it; and the pool that keeps hundreds of
//! them in one process.
//!
//! Knows nothing of protocols. Every call goes through [`reel_episode::Episode`], and is persisted
//! before it is answered.

mod error;
mod host;
mod own;
mod pool;
mod restore;
mod session;
mod setup;
mod situation;
mod turns;

pub use error::LiveError;
pub use host::{Host, Work, program};
pub use own::OwnSession;
pub use pool::{Limits, SessionEntry, SessionPool};
pub use restore::{restore, restore_on};
pub use session::{
    BranchInputs, BranchedEpisode, CallResult, EndedEpisode, PrivilegedState, Session,
    SessionStatus, StartedEpisode,
};
pub use setup::{EpisodeRequest, Lease, PreparedTaskCache, Setup, TraceObserver, check_name};
pub use situation::{EpisodePosition, Situation};
pub use turns::{Owner, Turn, Turns};
