//! Training examples: what a policy saw and should answer, as the formats that trainers load (SPEC sections 4, 8 and 11).
//!
//! Owns the prompt, the removal of what is privileged, the formats, pictures on disk, splits and what a dataset says of
//! itself. Never reads a trace or a table: it is given episodes as plain text and pictures as pixels.

mod privileged;

pub use privileged::{Leak, LeakKind, Secrets, privileged, strip};
