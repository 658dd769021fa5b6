//! TLS to the server. A connection is a pair on this machine: one end speaks in the clear, as to any
//! server; what comes out of the other is encrypted and passed on by tasks of a runtime of its own.

use std::{
    io,
    net::{Ipv4Addr, TcpListener, TcpStream},
    sync::Arc,
    time::Duration,
};

use rustls_platform_verifier::BuilderVerifierExt;
use tokio::{
    io::copy_bidirectional_with_sizes,
    runtime::{Builder, Runtime},
    time::timeout,
};
use tokio_rustls::{
    TlsConnector,
    rustls::{ClientConfig, crypto::ring, pki_types::ServerName},
};

/// How long a handshake may take.
const HANDSHAKE_PATIENCE: Duration = Duration::from_secs(10);
/// Bytes that are encrypted at a time.
const PIECE: usize = 64 << 10;

/// A client of TLS, which trusts what this machine trusts.
pub(crate) struct Tls {
    runtime: Runtime,
    connector: TlsConnector,
}

impl Tls {
    pub(crate) fn new() -> io::Result<Self> {
        let mut config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .and_then(BuilderVerifierExt::with_platform_verifier)
            .map_err(io::Error::other)?
            .with_no_client_auth();
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        Ok(Self {
            runtime: Builder::new_multi_thread()
                .worker_threads(2)
                .enable_all()
                .build()?,
            connector: TlsConnector::from(Arc::new(config)),
        })
    }

    /// Shakes hands with the server of that name on a connection; gives the end that speaks in the
    /// clear.
    pub(crate) fn connect(&self, server: TcpStream, host: &str) -> io::Result<TcpStream> {
        let name = ServerName::try_from(host.to_owned()).map_err(io::Error::other)?;
        server.set_nodelay(true)?;
        server.set_nonblocking(true)?;
        let mut encrypted = self.runtime.block_on(async {
            let server = tokio::net::TcpStream::from_std(server)?;
            timeout(HANDSHAKE_PATIENCE, self.connector.connect(name, server))
                .await
                .map_err(|_| io::Error::from(io::ErrorKind::TimedOut))?
        })?;
        let (clear, other) = pair()?;
        other.set_nonblocking(true)?;
        self.runtime.spawn(async move {
            // Both are closed as soon as one breaks off, which the recorder sees at its end.
            if let Ok(mut other) = tokio::net::TcpStream::from_std(other) {
                let _ =
                    copy_bidirectional_with_sizes(&mut encrypted, &mut other, PIECE, PIECE).await;
            }
        });
        Ok(clear)
    }
}

/// Two ends of a connection on this machine; whoever else connects at that moment is turned away.
fn pair() -> io::Result<(TcpStream, TcpStream)> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
    let one = TcpStream::connect(listener.local_addr()?)?;
    loop {
        let (other, from) = listener.accept()?;
        if from == one.local_addr()? {
            other.set_nodelay(true)?;
            return Ok((one, other));
        }
    }
}
