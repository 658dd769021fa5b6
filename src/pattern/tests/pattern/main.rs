//! Matching against a reference.
