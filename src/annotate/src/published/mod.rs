//! The files of REAL's published annotation: the stream of events it reads, the records it asks a
//! model about, and what it keeps of the answers. Tools have their old names here, and `open` and
//! `close` name a receptacle.
//!
//! Owns the forms and their rules, and none of the published wording: [`RequestWording`]
//! is ours or the caller's.

mod action;
mod answer;
mod record;
mod stream;
mod trace;

pub use action::{action_text, normalise};
pub use answer::{Thought, json_text, thought};
pub use record::{Episode, RequestWording, StreamStep, TaskMeta};
pub use stream::{Pair, pairs};
pub use trace::{answers, episode, events, meta};
