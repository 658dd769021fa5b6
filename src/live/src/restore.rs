//! Recordings that broke off, made whole: scored as their end would have been.

use std::path::Path;

use reel_reward::{Preset, metrics};
use reel_trace::{Recovery, TraceError, recover};

/// [`reel_trace::recover`] with the metrics of the episode so far.
///
/// # Errors
/// As [`reel_trace::recover`].
pub fn restore(recording: &Path, folder: Option<&Path>) -> Result<Recovery, TraceError> {
    recover(recording, folder, |trace, graphs| {
        let preset = Preset::parse(&trace.header.reward_preset).unwrap_or_default();
        metrics(&preset, &trace.task, &trace.start, &trace.steps, graphs)
    })
}
