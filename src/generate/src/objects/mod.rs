//! The object library.
