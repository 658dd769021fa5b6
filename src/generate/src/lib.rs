//! What training needs more of than was published: scenes that come along or are made by seed, their check and their floor
//! plans, a large object library, and tasks for any scene from any library.
//!
//! Reads no file and knows no clock; whether a task can be done in a scene is found out by running it.

pub mod objects;
pub mod scene;
pub mod task;
