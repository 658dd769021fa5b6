//! REAL-Bench tasks, scenes, the object library and the task generator.
//!
//! Reads outside files, so everything here that fails says which file, which line and which field. Never
//! simulates: whether a task can be done is found out by running it.

pub mod attributes;
pub mod scene;

mod document;
mod error;
mod field;
mod load;
mod oddity;
mod real_schema;

pub use error::TaskError;
pub use load::{LoadReport, load, parse};
pub use oddity::{Oddity, OddityKind};
