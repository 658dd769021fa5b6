//! Live worlds as tools of the Model Context Protocol: over Streamable HTTP, legacy HTTP+SSE and
//! stdio, in the words of the paper or of the published server.
//!
//! Carries calls to the pool and says what came of them; never decides, never simulates. What a
//! profile shows is in `response`, and nothing else reaches a policy.

mod answers;
mod as_it_came;
mod caller;
mod catalogue;
mod event_store;
mod guard;
mod handler;
mod legacy_sse;
mod methods;
mod policy_output;
mod questions;
mod response;
mod router;
mod sessions;
mod waiting;

pub use answers::{AnsweredInput, OutsideAnswers};
pub use as_it_came::{call_as_it_came, outgoing_result, tools_as_they_came};
pub use caller::Caller;
pub use catalogue::tools;
pub use guard::{BrowserRequest, Guard};
pub use handler::{
    AnswerSources, AskResponder, AskUser, CallObserver, LookUp, ToolServer, ToolServerOptions,
    server_info,
};
pub use methods::{VERSIONS, WITH_SESSIONS, agreed_version, refusal};
pub use policy_output::policy_output;
pub use questions::{Decision, OpenQuestion, Question, Questions, SessionCalls, Wish, Withdrawn};
pub use response::{Response, image, refuse, task_ids, tool_result};
pub use router::{Transports, Worker, router, router_of, stdio, streamable_http};
pub use waiting::WaitingSessions;
