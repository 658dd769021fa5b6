//! What REAL's published trainer makes of a server's answers: categories, refused graphs, listed
//! errors, answers of the user. The rules are those of `src/real_trainer.rs`, which runs on
//! facts; [`TrainerRollout`] feeds them with payloads and results as they come over MCP. Never
//! talks to a server.

mod categories;
mod graph;
mod rollout;
mod texts;

pub use categories::Categories;
pub(crate) use categories::lower;
pub use graph::{Graph, GraphRejection, GraphSize, OBJECT_DRIFT_MAX, graph_rejection, is_unknown};
pub use rollout::{ResetError, TrainerRollout, TrainerStep, Turn};
pub use texts::{
    HandViolation, TextError, is_dropped, is_not_found, marker_in_answer, observation,
};
