//! Who sent a request, as far as a token says. Whoever checks tokens says it; here it decides which
//! sessions a request may use.

use std::future::Future;

use axum::http::request::Parts;
use reel_live::Owner;
use rmcp::{RoleServer, service::RequestContext};
use tokio_util::sync::CancellationToken;

tokio::task_local! {
    static CALLER: Caller;
}

/// Who sent a request. Without tokens every request is anyone's.
#[derive(Clone, Debug, Default)]
pub struct Caller {
    /// Whose the sessions are that the request opens.
    pub owner: Owner,
    /// Cancelled when the token is taken back.
    pub revoked: CancellationToken,
}

impl Caller {
    /// Answers a request of this caller.
    pub async fn scope<T>(self, answer: impl Future<Output = T>) -> T {
        CALLER.scope(self, answer).await
    }

    /// Who sent the request that this task answers; none where it answers none.
    pub fn current() -> Option<Self> {
        CALLER.try_with(Clone::clone).ok()
    }

    /// Who sent the request of a handler, which rmcp runs in a task of its own.
    pub fn of(context: &RequestContext<RoleServer>) -> Option<&Self> {
        context.extensions.get::<Parts>()?.extensions.get()
    }

    /// Whether the request that this task answers, if any, may use what this caller opened.
    pub(crate) fn lets_current(&self) -> bool {
        let lets = |caller: Self| !self.revoked.is_cancelled() && self.owner.lets(&caller.owner);
        Self::current().is_none_or(lets)
    }
}
