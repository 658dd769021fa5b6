//! What an agent says it has done (`History`, docs/spec.md#policy-context), sentence by sentence,
//! beside what the record says was done.
//!
//! Owns the reading of sentences as claims, the verdict on each, and the mending of a text. Never
//! writes a History of its own, and never judges what is neither shown nor refuted by the record.
//!
//! The way of a sentence: `lex` cuts it into tokens, `clause` finds the verbs and what belongs
//! to each with the word classes of `grammar` and the episode's own `names`, `judge` compares
//! each with the `facts`.

mod checker;
mod claim;
mod clause;
mod content;
mod facts;
mod grammar;
mod judge;
mod lex;
mod names;
mod repair;
mod states;
mod step_facts;

pub use checker::{CHECKER_VERSION, Checker};
pub use claim::{Claim, ClaimKind, ClaimVerdict};
pub use repair::{RepairedHistory, repair_history};
pub use step_facts::{EpisodeFacts, MarkerFacts, ObjectFacts, ReceptacleFacts, StepFacts};
