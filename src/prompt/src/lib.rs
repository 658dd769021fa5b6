//! The texts in which a decision is put to a model, and the answer that is wanted: one wording for
//! training sets and for the agents that are driven by a model, so that a model is asked as it was
//! taught. The single-turn form is that of REAL's published trainer, with its template file or
//! ours; [`published`] holds what its clients read, remember and show.
//!
//! Knows no file, no endpoint and no format of a trainer.

mod answer;
mod conversation;
pub mod published;
pub mod python;
mod single_turn;
mod template;
mod wording;

pub use answer::{CallLog, DecisionAnswer, HistoryLines, action, log_line};
pub use conversation::{SYSTEM_MULTI_TURN, VIEW, arguments, briefing, functions, thought};
pub use single_turn::{CallOutcome, EpisodePrompt, MemoryOptions, Prompt, SingleTurn, TEMPLATE};
pub use template::{Slots, Template, TemplateError, check};
pub use wording::PromptWording;
