//! Questions answered by many machines: a scheduler, executors and the engine of sessions that ask
//! them, all of Ballista.
//!
//! A store's files have to be where every machine sees them under the same name: in a bucket, or in
//! a folder that all share. What an executor may open besides, for functions that call the
//! simulator, it is told when it starts.
//!
//! Knows no SQL and no table: sessions plan as they do alone, and plans name files.

mod client;
mod engine;
mod executor;
mod files;
mod identity;
mod lost_work;
mod scheduler;
mod work;

use reel_query::STACK_BYTES;
use tokio::runtime::{Builder, Runtime};

pub use client::{Address, Cluster};
pub use executor::{ExecutorOptions, run as run_executor};
pub use identity::{Credentials, Identity, issue};
pub use scheduler::{SchedulerOptions, run as run_scheduler};
pub use work::TraceJob;

/// What scheduler and executors run in: plans are walked by recursion.
fn runtime() -> std::io::Result<Runtime> {
    Builder::new_multi_thread()
        .thread_stack_size(STACK_BYTES)
        .enable_all()
        .build()
}

/// Whether a process may listen there. Of an address that is taken the server below says
/// "transport error", and that of an executor nothing.
fn check_listen(address: std::net::SocketAddr) -> Result<(), String> {
    std::net::TcpListener::bind(address)
        .map(drop)
        .map_err(|error| format!("cannot listen at {address}: {error}"))
}

/// Why there is no cluster.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum ClusterError {
    /// An address is none.
    #[error("'{text}' is no address of a scheduler: {reason}; give host:port or df://host:port")]
    Address { text: String, reason: String },
    /// No scheduler can be reached at the address.
    #[error("no scheduler answers at {address}: {reason}; `reel cluster scheduler` starts one")]
    Silent { address: String, reason: String },
    /// An executor will not do what it is asked for.
    #[error("the cluster refused the request: {reason}")]
    Refused { reason: String },
    /// Work failed for so long that it is given up.
    #[error(
        "the cluster of {address} failed: {reason}; finished parts are kept, run the command again once it is healthy"
    )]
    Lost { address: String, reason: String },
    /// The user pressed Ctrl-C while the cluster was working.
    #[error("stopped; the work on the cluster is cancelled")]
    Stopped,
    /// A file of identity cannot be used or made.
    #[error("{path}: {reason}; `reel cluster cert` makes files of identity", path = path.display())]
    Identity {
        path: std::path::PathBuf,
        reason: String,
    },
    /// A scheduler or an executor cannot run.
    #[error("{action}: {reason}")]
    Run {
        /// What failed, as the message begins, e.g. `the scheduler ended`.
        action: &'static str,
        reason: String,
    },
}
