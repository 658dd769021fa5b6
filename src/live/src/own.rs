//! Sessions that belong to one connection: closed with it, however it ends.

use std::{mem, sync::Arc};

use tokio::runtime::Handle;

use crate::{LiveError, SessionPool};

/// The session of one connection. When it is dropped, the session is closed: a call in it ends and
/// is recorded, then its episode ends as aborted and its simulator is freed.
pub struct OwnSession {
    name: String,
    pool: Arc<SessionPool>,
}

impl OwnSession {
    /// The session of that name, which need not be open yet.
    pub fn new(name: String, pool: Arc<SessionPool>) -> Self {
        Self { name, pool }
    }

    /// Name of the session in its pool.
    pub fn name(&self) -> &str {
        &self.name
    }
}

impl Drop for OwnSession {
    fn drop(&mut self) {
        let (pool, name) = (self.pool.clone(), mem::take(&mut self.name));
        // Without a runtime the process ends, and whoever ends it closes the pool.
        if let Ok(runtime) = Handle::try_current() {
            runtime.spawn(async move {
                match pool.close(&name).await {
                    Ok(state) => tracing::info!(
                        session = name,
                        episodes = state.episodes,
                        "closed with its connection"
                    ),
                    // Nothing was called, or it was closed before.
                    Err(LiveError::Unknown(_) | LiveError::Closing) => {}
                    Err(error) => tracing::warn!(session = name, %error, "could not be closed"),
                }
            });
        }
    }
}
