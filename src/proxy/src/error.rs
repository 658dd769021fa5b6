//! Why the recorder cannot start.

use std::{io, net::SocketAddr};

/// Every error of this crate that ends it.
#[derive(Debug, thiserror::Error)]
pub enum ProxyError {
    /// The address cannot be had.
    #[error("cannot listen: {source}; choose another address with --listen: {address}")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Why not.
        source: io::Error,
    },
    /// The address of the server is none.
    #[error("{what}; write e.g. http://127.0.0.1:8000: {url}")]
    Url {
        /// What was given.
        url: String,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// The server's program does not start.
    #[error("cannot start the server: {source}; check the words behind --stdio: {command}")]
    Spawn {
        /// Its words.
        command: String,
        /// Why not.
        source: io::Error,
    },
    /// The system refused something else.
    #[error("the system refused: {0}")]
    System(#[from] io::Error),
}
