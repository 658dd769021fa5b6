//! What training needs more of than was published: scenes that come along or are made by seed,
//! their check and their floor plans, tasks for any scene from any library of objects, and
//! questions in their plans.
//!
//! Reads no file and knows no clock; whether a task can be done in a scene is found
//! out by running it.

pub mod scene;
pub mod social;
pub mod task;
mod thumbnail;

pub use thumbnail::object_thumbnail;
