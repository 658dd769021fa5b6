//! The writers over recorded episodes: the golden traces, and those of
//! folders named by `REEL_TRACES`.

mod model;
mod published;
mod real_contract;
mod rules;
#[path = "../../../llm/tests/model/scripted.rs"]
#[expect(
    dead_code,
    reason = "the writer needs not all that the client's tests do"
)]
mod scripted;
mod validator;

use std::path::{Path, PathBuf};

use reel_annotate::{Annotation, PublicTask, Step, annotate};
use reel_trace::Trace;

/// Every trace to test with: the golden ones of all families and several policies,
/// then those of `REEL_TRACES`.
pub fn traces() -> Vec<Trace> {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../traces/golden");
    let mut paths = in_folder(&golden);
    assert!(
        paths.len() > 20,
        "{} holds {} traces",
        golden.display(),
        paths.len()
    );
    match std::env::var_os("REEL_TRACES") {
        Some(folders) => {
            paths.extend(std::env::split_paths(&folders).flat_map(|folder| in_folder(&folder)))
        }
        None => eprintln!("skipped: further traces, for want of a folder in REEL_TRACES"),
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

fn in_folder(folder: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    paths.retain(|path| {
        path.extension()
            .is_some_and(|extension| extension == "mcap")
    });
    paths.sort();
    paths
}
