//! Why the recorder cannot start.

use std::{io, net::SocketAddr};

/// Every error of this crate that ends it.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum ProxyError {
    /// The address cannot be had.
    #[error("cannot listen: {source}; choose another address with --listen: {address}")]
    Listen {
        address: SocketAddr,
        source: io::Error,
    },
    /// The address of the server is none.
    #[error("{problem}; write e.g. http://127.0.0.1:8000: {url}")]
    Url { url: String, problem: &'static str },
    /// No client of TLS can be made.
    #[error(
        "cannot speak TLS: {0}; install the certificates of authorities (Debian: ca-certificates), or name a file of them with SSL_CERT_FILE"
    )]
    Tls(io::Error),
    /// The server's program does not start.
    #[error("cannot start the server: {source}; check the words behind --stdio: {command}")]
    Spawn { command: String, source: io::Error },
    /// The system refused something else.
    #[error("the system refused: {0}")]
    System(#[from] io::Error),
}
