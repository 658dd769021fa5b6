//! Agents, users and matchers behind an OpenAI-compatible endpoint (paper, "Task Formulation" and
//! "Simulated User Module"; SPEC sections 3 and 4).
//!
//! Owns how a model is asked at every step and what is made of its answer. Never decides whether an
//! answer is a good call: the tools do, and tell the model. Whatever a model says becomes an input
//! of the trace, so that replay asks nobody.

mod agent;
mod functions;
mod matcher;
pub mod script;
mod single_turn;
mod user;

pub use agent::{AgentStyle, agent};
pub use functions::FunctionCalling;
pub use matcher::{Embeddings, SIMILARITY_DEFAULT};
pub use single_turn::SingleTurn;
pub use user::ModelUser;
