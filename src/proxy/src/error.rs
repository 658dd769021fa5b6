//! Why the recorder cannot start.

use std::{io, net::SocketAddr};

/// Every error of this crate that ends it.
#[derive(Debug, thiserror::Error)]
pub enum ProxyError {
    /// The address cannot be had.
    #[error("cannot listen: {source}; choose another address with --listen: {address}")]
    Listen {
        /// The address that the recorder could not listen on.
        address: SocketAddr,
        /// The error that the operating system reported.
        source: io::Error,
    },
    /// The address of the server is none.
    #[error("{problem}; write e.g. http://127.0.0.1:8000: {url}")]
    Url {
        /// The server's URL, as it was given.
        url: String,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// The server's program does not start.
    #[error("cannot start the server: {source}; check the words behind --stdio: {command}")]
    Spawn {
        /// Command line of the server, its words joined by spaces.
        command: String,
        /// The error that the operating system reported.
        source: io::Error,
    },
    /// The system refused something else.
    #[error("the system refused: {0}")]
    System(#[from] io::Error),
}
