//! Waiting for whoever ends this process: Ctrl-C, or what a service manager sends.

use std::io;

use tokio::{runtime::Builder, signal};

/// Returns when the process shall end.
pub(crate) fn wait() -> io::Result<()> {
    let runtime = Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        #[cfg(unix)]
        {
            let mut terminated = signal::unix::signal(signal::unix::SignalKind::terminate())?;
            tokio::select! {
                interrupted = signal::ctrl_c() => interrupted,
                _ = terminated.recv() => Ok(()),
            }
        }
        #[cfg(not(unix))]
        signal::ctrl_c().await
    })
}
