//! The replay server as a process: its address, who may call it, and its end. What it answers is
//! `reel_tape`'s.

use std::{
    net::{Ipv4Addr, SocketAddr},
    sync::Arc,
    time::Duration,
};

use axum::middleware;
use reel_mcp::Guard;
use reel_tape::{TapeSessions, TapeTransports};
use tokio::{net::TcpListener, runtime::Runtime, task::JoinHandle};
use tokio_util::sync::CancellationToken;

use crate::{
    Config, ServeError,
    run::{AT_LAST, runtime, stopped},
    start_logs,
};

/// How long connections may take to close when the server stops.
const LAST_ANSWERS: Duration = Duration::from_secs(2);

/// A replay server that listens, with threads of its own. Dropping it stops it.
pub struct ReplayServer {
    address: SocketAddr,
    sessions: TapeSessions,
    closing: CancellationToken,
    serving: Option<JoinHandle<()>>,
    runtime: Option<Runtime>,
}

impl ReplayServer {
    /// Answers at an address of this machine. There are no tokens, so no other is taken.
    ///
    /// # Errors
    /// When the address is no loopback address, or cannot be taken.
    pub fn start(sessions: TapeSessions, listen: SocketAddr) -> Result<Self, ServeError> {
        if !listen.ip().is_loopback() {
            return Err(ServeError::ReplayOpen(listen));
        }
        let limits = Config::default().limits;
        let transports = TapeTransports {
            sessions: limits.sessions,
            keep_alive: Duration::from_secs(limits.close_after_s),
            max_body: limits.body_mib << 20,
        };
        let closing = CancellationToken::new();
        let guard = middleware::from_fn_with_state(Arc::new(Guard::default()), Guard::middleware);
        let router = sessions.router(transports, closing.clone()).layer(guard);
        let runtime = runtime(None)?;
        let failed = |source| ServeError::Listen {
            address: listen,
            source,
        };
        let listener = runtime
            .block_on(TcpListener::bind(listen))
            .map_err(failed)?;
        let address = listener.local_addr().map_err(ServeError::System)?;
        let stops = closing.clone().cancelled_owned();
        let serving = runtime.spawn(async move {
            let served = axum::serve(listener, router).with_graceful_shutdown(stops);
            if let Err(error) = served.await {
                tracing::error!(%error, "the replay server stopped");
            }
        });
        Ok(Self {
            address,
            sessions,
            closing,
            serving: Some(serving),
            runtime: Some(runtime),
        })
    }

    /// [`ReplayServer::start`] at a free port of 127.0.0.1.
    ///
    /// # Errors
    /// When there is none.
    pub fn start_anywhere(sessions: TapeSessions) -> Result<Self, ServeError> {
        Self::start(sessions, SocketAddr::from((Ipv4Addr::LOCALHOST, 0)))
    }

    /// The address that it listens on, with its port.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Waits for Ctrl-C, or what a service manager sends.
    pub fn wait_for_signal(&self) {
        if let Some(runtime) = &self.runtime {
            runtime.block_on(async { stopped().await });
        }
    }

    /// Ends every session and its episode, and tells how they went.
    pub fn stop(mut self) {
        self.close();
    }

    fn close(&mut self) {
        self.closing.cancel();
        self.sessions.end_all();
        let Some(runtime) = self.runtime.take() else {
            return;
        };
        if let Some(serving) = self.serving.take() {
            let _ = runtime.block_on(async { tokio::time::timeout(LAST_ANSWERS, serving).await });
        }
        runtime.shutdown_timeout(AT_LAST);
    }
}

impl Drop for ReplayServer {
    fn drop(&mut self) {
        self.close();
    }
}

/// Serves recordings to one agent over standard input and output, until it goes.
///
/// # Errors
/// When what comes in is not the protocol.
pub fn run_replay_stdio(sessions: &TapeSessions) -> Result<(), ServeError> {
    let _logs = start_logs(&Config::default());
    let runtime = runtime(Some(2))?;
    let served = runtime.block_on(async {
        tokio::select! {
            served = sessions.stdio() => served,
            () = stopped() => Ok(()),
        }
    });
    sessions.end_all();
    // A thread may still wait for standard input.
    runtime.shutdown_background();
    served.map_err(|error| ServeError::Protocol(error.to_string()))
}
