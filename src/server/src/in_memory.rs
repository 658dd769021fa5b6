//! The whole service behind pipes of this process: what a client sends goes through the same
//! connections, gate and handlers as over a socket. For the fuzz targets.

use std::{io, net::SocketAddr, time::Duration};

use axum::serve::Listener;
use reel_live::Host;
use reel_mcp::AnswerSources;
use reel_trace::TraceFiles;
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _, DuplexStream, duplex},
    runtime::Runtime,
    sync::{mpsc, oneshot},
    task::JoinHandle,
    time::timeout,
};

use crate::{Config, ServeError, Service};

/// Bytes that wait in a pipe.
const PIPE: usize = 64 << 10;
/// How long a client waits for more of an answer: streams of events have no end.
const PATIENCE: Duration = Duration::from_millis(100);

/// A service with its runtime.
#[doc(hidden)]
pub struct InMemoryServer {
    runtime: Runtime,
    pipes: mpsc::UnboundedSender<DuplexStream>,
    /// The service ends when the sender goes.
    serving: Option<(oneshot::Sender<()>, JoinHandle<()>)>,
}

/// Connections that clients of this process open.
struct Pipes(mpsc::UnboundedReceiver<DuplexStream>);

impl InMemoryServer {
    /// Starts a service without an address.
    ///
    /// # Errors
    /// As [`Service::start`].
    pub fn start(config: Config) -> Result<Self, ServeError> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(ServeError::System)?;
        let (pipes, accepted) = mpsc::unbounded_channel();
        let listen = async { Ok(Pipes(accepted)) };
        let service = Service::start_on(
            Host::default(),
            config,
            TraceFiles::default(),
            AnswerSources::default(),
            listen,
        );
        let service = runtime.block_on(service)?;
        let (stop, stopped) = oneshot::channel();
        let serving = runtime.spawn(service.run(async { drop(stopped.await) }));
        Ok(Self {
            runtime,
            pipes,
            serving: Some((stop, serving)),
        })
    }

    /// What a client reads that sends these bytes on a connection of its own.
    pub fn exchange(&self, sent: &[u8]) -> Vec<u8> {
        self.runtime.block_on(self.converse(sent))
    }

    async fn converse(&self, sent: &[u8]) -> Vec<u8> {
        let (mut ours, theirs) = duplex(PIPE);
        let mut read = Vec::new();
        if self.pipes.send(theirs).is_ok()
            && let Ok(Ok(())) = timeout(PATIENCE, ours.write_all(sent)).await
        {
            while let Ok(Ok(1..)) = timeout(PATIENCE, ours.read_buf(&mut read)).await {}
        }
        read
    }
}

impl Drop for InMemoryServer {
    fn drop(&mut self) {
        if let Some((stop, serving)) = self.serving.take() {
            drop(stop);
            let _ = self.runtime.block_on(serving);
        }
    }
}

impl Listener for Pipes {
    type Io = DuplexStream;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (DuplexStream, SocketAddr) {
        match self.0.recv().await {
            Some(pipe) => (pipe, SocketAddr::from(([127, 0, 0, 1], 9))),
            None => std::future::pending().await,
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        Err(io::ErrorKind::Unsupported.into())
    }
}
