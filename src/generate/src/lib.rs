//! What training needs more of than was published: tasks, made for any scene from any library of objects.
//!
//! Pure but for the threads it computes on: scenes, library and seed are arguments, files are the caller's.

pub mod task;
