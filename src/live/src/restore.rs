//! Recordings that broke off, made whole: scored as their end would have been.

use std::path::Path;

use reel_reward::{Preset, metrics, rewards};
use reel_trace::{Recovery, RestoreScorer, Trace, TraceError, TraceFiles, recover_on};
use reel_world::record::{Graphs, Metrics, RewardTerm, StepRecord};

/// [`reel_trace::recover()`] with the rewards and metrics of the episode so far.
///
/// # Errors
/// As [`reel_trace::recover()`].
pub fn restore(recording: &Path, folder: Option<&Path>) -> Result<Recovery, TraceError> {
    restore_on(&TraceFiles::default(), recording, folder)
}

/// [`restore`] on the disk of these files.
///
/// # Errors
/// As [`restore`].
pub fn restore_on(
    files: &TraceFiles,
    recording: &Path,
    folder: Option<&Path>,
) -> Result<Recovery, TraceError> {
    recover_on(files, recording, folder, ByPreset)
}

/// Scores by the preset that a trace names, if it is built in.
struct ByPreset;

fn preset(trace: &Trace) -> Preset {
    Preset::parse(&trace.header.reward_preset).unwrap_or_default()
}

impl RestoreScorer for ByPreset {
    fn metrics(&self, trace: &Trace, graphs: &Graphs) -> Metrics {
        metrics(
            &preset(trace),
            &trace.task,
            &trace.start,
            &trace.steps,
            graphs,
        )
    }

    fn terms(&self, trace: &Trace, step: &StepRecord) -> Option<Vec<RewardTerm>> {
        let steps = [trace.steps.as_slice(), std::slice::from_ref(step)].concat();
        rewards(
            &preset(trace),
            &trace.task,
            &trace.scene,
            &trace.start,
            &steps,
        )
        .pop()
    }
}
