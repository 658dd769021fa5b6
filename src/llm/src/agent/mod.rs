//! Agents, users and matchers behind an OpenAI-compatible endpoint (paper,
//! "Problem Formulation and Context Management" and "Simulated User
//! Module"; docs/spec.md#simulated-user and docs/spec.md#policy-context).
//!
//! Owns how a model is asked at every step and what is made of its answer. Never decides whether an
//! answer is a good call: the tools do, and tell the model. Whatever a model says becomes an input
//! of the trace, so that replay asks nobody.

mod functions;
mod matcher;
pub mod script;
mod single_turn;
mod style;
mod user;

pub use functions::FunctionCalling;
pub use matcher::{
    MatchRule, SIMILARITY_DEFAULT, TextVectors, UselessVector, VectorFileError, VectorMatcher,
};
pub use single_turn::SingleTurn;
pub use style::{AgentStyle, agent};
pub use user::ModelUser;
