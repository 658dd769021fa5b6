//! What episodes are played in: scenes that come along or are made by seed, their check and their floor plans, and the
//! large object library.
//!
//! Reads no file and knows no clock; whether a task can be done in a scene is found out by running it.

pub mod objects;
pub mod scene;
