//! Live worlds for agents that come from outside: households, each with an exclusive simulator that
//! plays one episode after another and records it; and the pool that keeps hundreds of them in one
//! process.
//!
//! Knows nothing of protocols. Every call goes through [`reel_episode::Episode`], and is on tape
//! before it is answered.

mod error;
mod household;
mod pool;
mod restore;
mod setup;

pub use error::LiveError;
pub use household::{
    CallResult, EndedEpisode, PrivilegedState, Session, SessionStatus, StartedEpisode,
};
pub use pool::{Entry, Limits, Pool};
pub use restore::restore;
pub use setup::{Lease, PreparedTaskCache, Setup, check_name};
