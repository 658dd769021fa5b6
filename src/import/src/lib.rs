//! Episodes that agents of the published REAL framework played (`eval_output`,
//! docs/spec.md#evaluation-agents) as traces; [`robot`] does the same for what robots recorded, [`atif`]
//! for trajectories of any agent, [`inspect`] for logs of evaluations, [`otel`] for spans of OpenTelemetry.
//!
//! Owns what their files mean. Reads every field leniently: a missing file is less information; a
//! torn one is a loss that is named, and the steps before it are imported. Never simulates, never
//! guesses a value: what the files do not say (sizes, poses, pixels of objects, the robot's
//! heading, paths) is zero or absent in the trace.
//!
//! # What becomes of what
//! - `task_meta.json`: the task, unless [`ImportOptions::tasks`] has it; the model's name; further
//!   keys are settings of the policy. The published agents store no graph in it, so the start is
//!   the first graph that a step shows: before that nothing could be changed, because every tool
//!   that changes something needs markers.
//! - `tool_call.json`: the call as it was made. `raw_response.txt` or `.json`: the policy's output.
//! - `inference_time.json`: latency. `textual_observation.txt`: the outcome. A result without it
//!   was an image alone.
//! - `image_observation_N.png`: the image, to the pixel; of several the last.
//! - `debug_info.json`: the registry graph, held object, markers, camera position. There is no
//!   second authority: the physical graph of the trace is the same. Objects that got a marker count
//!   as listed, since they were shown.
//! - `inference_error.txt`, `action_error.txt`: the episode ended with a fault; what was decided
//!   there is not in the files.
//! - `episode_summary.json`: how it ended. The client's own success is compared, not taken.
//!
//! Whoever stands by while such an episode is played (the recording proxy) reads the same things as
//! they come: [`started_episode`] is the task that a server tells, [`ObservedState`] what its
//! results show, [`record`] the step that follows.

pub mod atif;
mod episode;
mod error;
pub mod eval_client;
mod graph;
mod image;
pub mod inspect;
mod layout;
mod lenient;
mod mapping;
mod observe;
pub mod otel;
mod outcome;
mod response;
pub mod robot;
mod success;
mod task;

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use reel_trace::{Images, Recorder};
use reel_world::{Scenes, Task, record::EndReason};
use serde::Serialize;
use serde_json::{Map, Value};

pub use error::ImportError;
pub use layout::cut_debug_info;
pub use lenient::long_integers;
pub use mapping::{Entries, MappingError, MappingFile, Tools};
pub use observe::{CallObservation, ObservedState, header, record, same_graph_for_both};
pub use outcome::{outcome, reply};
pub use success::SuccessRule;
pub use task::{TaskSetup, unknown_task};

/// What is known besides the files of an episode.
#[derive(Clone, Copy, Debug)]
pub struct ImportOptions<'a> {
    /// Run that the traces belong to.
    pub run_id: &'a str,
    /// Task files: the one with an episode's task id is used instead of
    /// what its `task_meta.json` says.
    pub tasks: &'a [Arc<Task>],
    /// The scenes of the tasks. Without them, or for episodes of another scene, one of names alone.
    pub scenes: Option<&'a Scenes>,
}

/// An episode that was imported.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct ImportedEpisode {
    /// Where it came from.
    pub source: PathBuf,
    /// The trace, named after task, model and content.
    pub trace: PathBuf,
    /// Size of the trace in bytes.
    pub bytes: u64,
    /// Id of the task that the episode plays.
    pub task_id: String,
    /// How many steps it has.
    pub steps: u32,
    /// How many frames the trace holds.
    pub images: u32,
    /// Why the episode ended, as its end record says.
    pub end: EndReason,
    /// SR under the default preset, or what was reported where the task has no goal; `None` where
    /// nobody knows.
    pub success: Option<bool>,
    /// What was there and could not be read.
    pub losses: Vec<ImportLoss>,
    /// What the files leave open, and how it was decided.
    pub notes: Vec<String>,
}

/// Something of an episode that could not be read.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct ImportLoss {
    /// The file or folder.
    pub file: PathBuf,
    /// What is wrong with it, and what that cost.
    pub message: String,
}

impl std::fmt::Display for ImportLoss {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.file.display(), self.message)
    }
}

/// The folders of episodes under a folder (itself included), sorted: those with a `task_meta.json`,
/// an `episode_summary.json` or a step.
///
/// # Errors
/// When a folder cannot be listed, or there is none.
pub fn episodes(root: &Path) -> Result<Vec<PathBuf>, ImportError> {
    layout::episodes(root)
}

/// Writes the episode of one folder as a trace into the folder `out`, which exists. Equal files
/// give equal bytes under an equal name, wherever they lie.
///
/// # Errors
/// When nothing of it can be imported, or the trace cannot be written.
pub fn import(
    source: &Path,
    out: &Path,
    options: &ImportOptions<'_>,
) -> Result<ImportedEpisode, ImportError> {
    let files = layout::read(source)?;
    let built = episode::build(files, options)?;
    let trace = out.join(format!("{}.mcap", built.file_stem()));
    let mut recorder = Recorder::create(
        &trace,
        &built.header,
        &built.task,
        &built.scene,
        Images::Full,
    )?;
    recorder.start(&built.start, None)?;
    for (record, frame) in &built.steps {
        recorder.input(record.step, &record.input)?;
        recorder.step(record, frame.as_ref())?;
    }
    let summary = recorder.end(&built.end)?;
    Ok(ImportedEpisode {
        source: source.to_owned(),
        trace,
        bytes: summary.bytes,
        success: built.end.success(&built.task),
        task_id: built.task.task_id,
        steps: built.end.steps,
        images: built
            .steps
            .iter()
            .filter(|(_, frame)| frame.is_some())
            .count() as u32,
        end: built.end.reason,
        losses: built.losses,
        notes: built.notes,
    })
}

/// An episode that a server has begun.
#[derive(Clone, PartialEq, Debug)]
pub struct StartedEpisode {
    /// Task and scene of the episode, and the settings that the run reported.
    pub setting: TaskSetup,
    /// Before the first call.
    pub state: ObservedState,
    /// What was left open, and how it was decided.
    pub notes: Vec<String>,
}

/// Reads the task that the published server tells when an episode begins (the payload of `finish`),
/// and the debug information that came with it.
///
/// # Errors
/// When they do not say what shall go where.
pub fn started_episode(
    payload: &Map<String, Value>,
    debug_info: &Map<String, Value>,
    options: &ImportOptions<'_>,
) -> Result<StartedEpisode, ImportError> {
    let told_graph = payload.get("initial_world_graph").and_then(graph::parse);
    let mut state = ObservedState {
        graph: told_graph.clone(),
        ..ObservedState::default()
    }
    .after(debug_info);
    let mut seen = task::ObservedWorld {
        first: told_graph,
        ..task::ObservedWorld::default()
    };
    for graph in seen.first.clone().iter().chain(&state.graph) {
        seen.take_in(graph);
    }
    let path = Path::new("the payload of finish");
    let mut told = task::TaskSource {
        meta: payload,
        folders: [None, None],
        path,
        notes: Vec::new(),
    };
    let setting = task::setting(&mut told, &seen, options)?;
    let notes = told.notes;
    state
        .graph
        .get_or_insert_with(|| setting.task.initial.clone());
    Ok(StartedEpisode {
        setting,
        state,
        notes,
    })
}
