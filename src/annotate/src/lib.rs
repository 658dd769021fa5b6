//! Reasoning, History, schedule and subtask for trajectories that came without
//! words (docs/spec.md#policy-context and docs/spec.md#sft-data).
//!
//! Owns the rule-based writer and the one that asks a model, and the files of REAL's annotation
//! ([`published`]). Never changes a trace: what is written lies beside it.

mod check;
mod english;
mod error;
mod history;
mod memory;
mod model;
mod plan;
mod privileged;
pub mod published;
mod reasoning;
mod rules;
mod sidecar;
mod step;
mod task;
mod voice;
mod wordings;

pub use check::history_check;
pub use error::AnnotateError;
#[doc(hidden)]
pub use model::parse_answer;
pub use model::{
    AnnotatedEpisode, BATCH, FrameBefore, HistoryCheck, ModelAnnotator, prompt_version,
};
pub use privileged::PrivilegedFacts;
pub use rules::{Annotation, annotate, episode_seed, version};
pub use sidecar::{Entry, Provenance, RequestForm, notes_path, read_notes, write_notes};
pub use step::{MarkedItem, ObservedObject, Step};
pub use task::{PublicReceptacle, PublicTask, ReceptacleRole};
