//! Logs of Inspect (`.eval`, or one JSON document), which its viewer and Inspect Scout open: each
//! sample of a log as a trace, and traces as samples of a log.
//!
//! A sample becomes a trajectory ([`crate::atif`]) and the other way round; what stands there of
//! turns, calls and results holds here, too. Beside that:
//! - `eval.model`: name of the policy. `eval.task` and the sample's `id`: the task; its `target`
//!   and `metadata` are facts of the task that no agent sees.
//! - `scores`: the scores that were reported; which of them says success is for [`SuccessRule`](crate::SuccessRule).
//! - `error`, `limit`: the episode ended with a fault, or at its horizon.
//! - Several epochs: attempts of one group.
//! - `metadata.reel`, of samples and of assistant messages: what a trace of Reel has beyond that.

mod archive;
mod model;
mod reading;
mod writing;

pub use reading::{import, logs};
pub use writing::LogWriter;
