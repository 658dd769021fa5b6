//! Spans of [OpenTelemetry](https://opentelemetry.io/docs/specs/semconv/gen-ai/): an episode as a trace of a collector, in
//! the semantic conventions for generative AI, and the traces of any instrumented agent as episodes.
//!
//! An episode becomes a trajectory ([`crate::atif`]) and the other way round; what stands there of turns, calls and
//! results holds here, too. Beside that:
//! - `invoke_agent`: the episode. `chat`: a response of the policy, with its tokens. `execute_tool`: a call with its
//!   arguments and result; one that failed has `error.type` and the status of an error.
//! - Events `gen_ai.evaluation.result`: success, completion, rewards and reported scores.
//! - `reel.*`: facts of Reel. `reel.episode` and `reel.record` hold what a trace has beyond the conventions.
//!
//! Ids of spans follow from the trace, so equal traces give equal spans.

mod convention;
mod conversation;
mod messages;
mod names;
mod reading;
mod writing;

pub use reading::{SpanEpisode, SpanFiles, documents, import, read, read_requests};
pub use writing::{ImageParts, SpanClock, SpanOptions, export, requests};

use crate::atif;

/// Bytes of spans that a request has at most: collectors refuse more than 4 MiB.
pub const REQUEST_BYTES_MAX: usize = 3 << 20;

/// What is lost besides [`LOST`] where images are named by their digest.
pub const LOST_IMAGES: (&str, &str) = (
    "images",
    "absent: spans name them by their digest, unless with --images blob",
);

/// What of a trace is not the same after `reel export otel --images blob` and `reel import otel`: the field, and what becomes of
/// it. It is what trajectories lose.
pub const LOST: &[(&str, &str)] = atif::LOST;
