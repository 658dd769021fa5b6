//! Sessions for clients of [OpenEnv](https://github.com/meta-pytorch/OpenEnv), by the contract of
//! `openenv-core` 0.3.0: a WebSocket is a session (`/ws`), and there are HTTP routes beside it.
//! An action is a call of a tool; what an agent observes is what the profile says of the call
//! (`reel_mcp::tool_result`), nothing else. Simulates nothing: sessions are those of the pool.

mod branch;
mod environment;
pub(crate) mod http;
mod message;
mod observation;
mod refusal;
mod rpc;
mod socket;

use std::sync::Arc;

use axum::{Router, routing::get};
use reel_mcp::Caller;

pub(crate) use branch::SiblingCounts;

use crate::{Role, service::App};

/// The WebSocket of the contract.
pub(crate) fn router(app: &Arc<App>) -> Router {
    Router::new()
        .route("/ws", get(socket::connect))
        .with_state(app.clone())
}

/// Whether a caller may see rewards and recorded episodes: role `act` alone may not.
fn reads(app: &App, caller: &Caller) -> bool {
    let has = |role| app.tokens.has_role(&caller.owner, role);
    !app.demands_tokens() || has(Role::Read) || has(Role::Admin)
}

/// 64 bits that name a session.
fn random_name() -> String {
    let mut bytes = [0; 8];
    getrandom::fill(&mut bytes).expect("the system has randomness");
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
