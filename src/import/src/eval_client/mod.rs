//! The evaluation client of REAL's published agents: how it names folders, reads results,
//! scores an episode, loops over tasks, and which files it writes. What it writes, the importer
//! of this crate reads.
//!
//! [`run`] is its loop over any [`EvalDriver`]; [`replay::RecordedRun`] is one over recorded
//! traces, so that REAL's own analysis reads them.

mod files;
mod names;
pub mod replay;
mod result;
mod run;
mod score;

pub use files::EvalError;
pub use names::{model_slug, path_component};
pub(crate) use result::DEBUG_TEXT;
pub use result::{Content, ToolResult};
pub use run::{Decision, EvalDriver, RunSettings, Stop, run};
pub use score::{is_success, world_graph};
