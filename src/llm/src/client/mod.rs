//! A blocking client of OpenAI-compatible endpoints (chat completions), as hosted services, vLLM,
//! Ollama and llama.cpp serve it.
//!
//! Owns what a request looks like on the wire, when a call is tried again, the folder in which
//! replies are kept and the log of calls. Never knows what is asked, never owns a clock, and never
//! shows, logs or stores the key.
//!
//! # When a call is tried again
//! After 408, 429 and 5xx, a refused or cut connection, an answer that ends too early, and a
//! timeout: 1, 2, 4, ... seconds later, 30 at most, or when the endpoint's `Retry-After` (in
//! seconds) says, 60 at most. There is no jitter: the same trouble gives the same calls. Everything
//! else would fail again and is an error at once.

mod cache;
mod clock;
mod endpoint;
mod error;
mod log;
mod reply;
mod request;
mod requests;

pub use cache::Cache;
pub use clock::Clock;
pub use endpoint::{ApiKey, Endpoint};
pub use error::ModelError;
pub use log::{CallLog, LoggedCall};
pub use reply::Reply;
#[doc(hidden)]
pub use reply::read_body;
pub use request::{Message, Part, Request, Role};
pub use requests::Client;
