//! Why episodes fail.

pub mod judge;
