//! The writers over recorded episodes: the golden traces, and those of
//! folders named by `REEL_TRACES`.

mod model;
mod published;
mod real_contract;
mod rules;
mod validator;

use reel_vectors::{golden_traces, scripted, traces_in};

use reel_annotate::{Annotation, PublicTask, Step, annotate};
use reel_trace::Trace;

/// Every trace to test with: the golden ones of all families and several policies,
/// then those of `REEL_TRACES`.
pub fn traces() -> Vec<Trace> {
    let mut paths = golden_traces();
    if let Some(folders) = std::env::var_os("REEL_TRACES") {
        paths.extend(std::env::split_paths(&folders).flat_map(|folder| traces_in(&folder)));
    }
    paths
        .iter()
        .map(|path| Trace::read(path).unwrap())
        .collect()
}

/// What the rules write about a trace.
pub fn notes(trace: &Trace) -> Vec<Annotation> {
    annotate(
        &PublicTask::of(&trace.task, &trace.scene),
        &Step::all(trace),
        7,
    )
}

/// All words of a note.
pub fn words(note: &Annotation) -> String {
    [
        &note.reasoning,
        &note.history,
        &note.schedule,
        &note.subtask,
    ]
    .map(String::as_str)
    .join("\n")
}
