//! Documents of trajectories are found, read and written as traces.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
};

use reel_reward::{Preset, metrics, rewards};
use reel_trace::{Images, Recorder, TraceError};
use reel_world::{
    Digest, Scene, WorldGraph,
    record::{Backend, EndReason, EndRecord, EpisodeHeader, PolicyInfo, Reported, StartRecord},
};
use serde_json::Value;

use super::{
    KeptEpisode, OURS, Trajectory,
    model::{FORMAT, NEWEST_KNOWN, VERSIONS},
    turns::{Decision, Opening, digests},
};
use crate::{
    ImportError, ImportLoss, ImportOptions, ImportedEpisode, TaskSetup,
    episode::file_stem,
    layout::files_below,
    lenient,
    observe::{self, ObservedState, same_graph_for_both},
    unknown_task,
};

/// Tells folders of unfinished traces apart.
static NEXT: AtomicU64 = AtomicU64::new(0);
/// Largest document that is read.
const BYTES_MAX: u64 = 1 << 30;

/// The documents under a folder, or the file itself: files `.json` that begin like a trajectory.
///
/// # Errors
/// When a folder cannot be listed, or there is none.
pub fn documents(root: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let found = files_below(root, |path| {
        path.extension().is_some_and(|end| end == "json") && is_trajectory(path)
    })?;
    if found.is_empty() {
        return Err(ImportError::NoTrajectory {
            root: root.to_owned(),
        });
    }
    Ok(found)
}

/// Whether a file names the format; reading says what is wrong with it.
fn is_trajectory(path: &Path) -> bool {
    read_file(path, BYTES_MAX).is_ok_and(|bytes| {
        let named = bytes
            .windows(FORMAT.len())
            .any(|part| part == FORMAT.as_bytes());
        named && without_mark(&bytes).trim_ascii_start().first() == Some(&b'{')
    })
}

/// Writes the trajectory of a document, and those of agents to which it delegated, as traces into
/// the folder `out`, which exists. Equal documents give equal bytes under an equal name. A
/// trajectory that cannot be imported has its error in its place.
///
/// # Errors
/// When the file is no trajectory, or a trace cannot be written.
pub fn import(
    source: &Path,
    out: &Path,
    options: &ImportOptions<'_>,
) -> Result<Vec<Result<ImportedEpisode, ImportError>>, ImportError> {
    let refuse = |reason: String| ImportError::Storage {
        path: source.to_owned(),
        reason,
    };
    let bytes = read_file(source, BYTES_MAX).map_err(&refuse)?;
    let trajectory: Trajectory = lenient::document(without_mark(&bytes))
        .map_err(|error| refuse(format!("not a trajectory of ATIF: {error}")))?;
    let mut results = Vec::new();
    // JSON itself is read to a bounded depth.
    let mut open = vec![trajectory];
    while let Some(mut trajectory) = open.pop() {
        let delegated = std::mem::take(&mut trajectory.subagent_trajectories);
        open.extend(delegated.into_iter().rev());
        let version = trajectory.schema_version.escape_debug().to_string();
        let written = if let Some(minor) = trajectory.schema_version.strip_prefix(VERSIONS) {
            let known = minor
                .parse::<u32>()
                .is_ok_and(|minor| minor <= NEWEST_KNOWN);
            let mut episode = Episode::new(source, options, LogFacts::default());
            if !known {
                episode.note(format!(
                    "version '{version}' is read as {VERSIONS}{NEWEST_KNOWN}, the newest that is known; what is new in it is left out"
                ));
            }
            episode.write(trajectory, out)
        } else {
            Err(refuse(format!(
                "version '{version}' is not read; ATIF-v1.0 and what follows it are"
            )))
        };
        match written {
            Err(ImportError::Trace(error)) => return Err(error.into()),
            result => results.push(result),
        }
    }
    let without_value = lenient::numbers_without_value(&bytes);
    if let (1.., Some(first)) = (without_value, results.iter_mut().flatten().next()) {
        first.notes.push(format!(
            "numbers that are NaN or Infinity are read as null: {without_value}"
        ));
    }
    if let (Some(what), Some(first)) = (
        lenient::long_integers_told(&bytes),
        results.iter_mut().flatten().next(),
    ) {
        first.losses.push(ImportLoss {
            file: source.to_owned(),
            message: what,
        });
    }
    Ok(results)
}

/// What a log tells of an episode beside its turns, for which trajectories have no field.
#[derive(Default)]
pub(crate) struct LogFacts {
    /// Name of the task, where it is not that of the run.
    pub(crate) task_id: Option<String>,
    /// The set of tasks that it belongs to.
    pub(crate) task_type: Option<String>,
    /// Further facts of the task, which no agent sees.
    pub(crate) task_facts: BTreeMap<String, Value>,
    /// Settings of the agent.
    pub(crate) parameters: BTreeMap<String, Value>,
    /// The attempts at one task, and which of them it is.
    pub(crate) group: Option<(String, u32)>,
    /// The calls that failed, by their ids.
    pub(crate) failed_calls: BTreeSet<String>,
    /// Why it ended, where the log says so.
    pub(crate) end: Option<EndReason>,
    /// What was said of the result.
    pub(crate) reported: Reported,
}

/// An episode on its way from a trajectory to a trace.
pub(crate) struct Episode<'a> {
    pub(super) source: &'a Path,
    options: &'a ImportOptions<'a>,
    pub(super) facts: LogFacts,
    losses: Vec<ImportLoss>,
    pub(super) notes: Vec<String>,
}

impl<'a> Episode<'a> {
    pub(crate) fn new(source: &'a Path, options: &'a ImportOptions<'a>, facts: LogFacts) -> Self {
        Self {
            source,
            options,
            facts,
            losses: Vec::new(),
            notes: Vec::new(),
        }
    }

    pub(crate) fn write(
        mut self,
        mut told: Trajectory,
        out: &Path,
    ) -> Result<ImportedEpisode, ImportError> {
        let kept = self.kept::<KeptEpisode>(told.extra.remove(OURS), "extra");
        let (opening, mut decisions) = self.read(std::mem::take(&mut told.steps));
        if decisions.is_empty() {
            return Err(ImportError::NoStep {
                path: self.source.to_owned(),
                reason: "the agent does nothing in it".to_owned(),
            });
        }
        let kept = self.fitting(kept, &opening, &mut decisions);
        let TaskSetup { task, scene, .. } = self.setting(&told, &opening, kept.as_ref());
        let graphs = match &kept {
            Some(kept) => kept.graphs.clone(),
            None => same_graph_for_both(&task.initial),
        };
        let start = StartRecord {
            graphs,
            shortest_path_m: kept.as_ref().and_then(|kept| kept.shortest_path_m),
            digests: digests(opening.frame.as_ref()),
            ..StartRecord::default()
        };
        let state = ObservedState {
            graph: Some(task.initial.clone()),
            ..ObservedState::default()
        };
        let (mut records, mut frames) = (Vec::new(), Vec::new());
        for (step, decision) in (0..).zip(decisions) {
            let (record, frame) = decision.record(step, &state);
            records.push(record);
            frames.push(frame);
        }
        let preset = Preset::default();
        if kept.is_none() {
            let terms = rewards(&preset, &task, &scene, &start, &records);
            for (record, terms) in records.iter_mut().zip(terms) {
                record.reward = terms;
            }
        }
        let mut header = self.header(&told, &opening, kept.as_ref(), &task, &scene);
        // A document of ours without an end is of a recording that broke off.
        let broken_off = told.continued_trajectory_ref.is_some() || kept.is_some();
        let reported = std::mem::take(&mut self.facts.reported);
        let end = kept.and_then(|kept| kept.end).unwrap_or_else(|| {
            let mut graphs = start.graphs.clone();
            for record in &records {
                graphs.physics.apply(&record.changes.physics);
                graphs.registry.apply(&record.changes.registry);
            }
            EndRecord {
                reason: match self.facts.end {
                    _ if broken_off => EndReason::Aborted,
                    Some(reason) => reason,
                    None => EndReason::Finished,
                },
                metrics: metrics(&preset, &task, &start, &records, &graphs),
                graphs,
                steps: records.len() as u32,
                reported,
            }
        });
        // Two runs of an agent have equal inputs as far as they are known: what came of them tells
        // them apart.
        let content = Digest::of_json(&(&header, &start, &records, &end));
        header.episode_id = content.to_string()[..16].to_owned();
        header.build = env!("CARGO_PKG_VERSION").to_owned();
        if let Some(next) = &told.continued_trajectory_ref {
            let next = next.escape_debug();
            self.notes.push(format!(
                "the trajectory goes on in {next}, which is an episode of its own"
            ));
        }
        let trace = out.join(format!("{}.mcap", file_stem(&header)));
        if trace.exists() {
            self.notes
                .push("the same episode was there already".to_owned());
        }
        // Equal documents may be imported at the same time.
        let folder = out.join(format!(
            ".{}-{}-{}",
            file_stem(&header),
            std::process::id(),
            NEXT.fetch_add(1, Ordering::Relaxed)
        ));
        let write = || -> Result<u64, TraceError> {
            let at_folder = |source| TraceError::Io {
                action: "write",
                path: folder.clone(),
                source,
            };
            fs::create_dir(&folder).map_err(at_folder)?;
            let unfinished = folder.join("trace.mcap");
            let mut recorder = Recorder::create(&unfinished, &header, &task, &scene, Images::Full)?;
            recorder.start(&start, opening.frame.as_ref())?;
            for (record, frame) in records.iter().zip(&frames) {
                recorder.input(record.step, &record.input)?;
                recorder.step(record, frame.as_ref())?;
            }
            let summary = recorder.end(&end)?;
            fs::rename(&unfinished, &trace).map_err(at_folder)?;
            Ok(summary.bytes)
        };
        let written = write();
        let _ = fs::remove_dir_all(&folder);
        Ok(ImportedEpisode {
            source: self.source.to_owned(),
            bytes: written?,
            trace,
            success: end.success(&task),
            task_id: task.task_id,
            steps: end.steps,
            images: frames.iter().chain([&opening.frame]).flatten().count() as u32,
            end: end.reason,
            losses: self.losses,
            notes: self.notes,
        })
    }

    /// What is ours of a document, if it fits the rest: others may have changed that. Where it does
    /// not, the document counts as any agent's.
    fn fitting(
        &mut self,
        kept: Option<KeptEpisode>,
        opening: &Opening,
        decisions: &mut [Decision],
    ) -> Option<KeptEpisode> {
        let kept = kept?;
        let numbered = |(number, decision): (usize, &Decision)| {
            let record = decision.kept.as_ref();
            record.is_some_and(|record| record.step as usize == number)
        };
        let why = if !decisions.iter().enumerate().all(numbered) {
            "the turns are not those of the trace"
        } else if kept
            .end
            .as_ref()
            .is_some_and(|end| end.steps as usize != decisions.len())
        {
            "it ends after another number of steps"
        } else if kept.header.task_id != kept.task.task_id {
            "its header and its task are of two episodes"
        } else if kept.task.instruction != opening.instruction {
            "the first turn is not the instruction of its task"
        } else {
            return Some(kept);
        };
        self.lose(format!("extra.{OURS} does not fit and is left out: {why}"));
        for decision in decisions {
            decision.kept = None;
        }
        None
    }

    /// What a document of ours keeps under `extra.reel`; what is not understood is lost.
    pub(super) fn kept<T: serde::de::DeserializeOwned>(
        &mut self,
        value: Option<Value>,
        place: &str,
    ) -> Option<T> {
        match serde_json::from_value(value?) {
            Ok(kept) => Some(kept),
            Err(error) => {
                self.lose(format!(
                    "{place}.{OURS} is not understood and left out: {error}"
                ));
                None
            }
        }
    }

    pub(crate) fn lose(&mut self, message: String) {
        self.losses.push(ImportLoss {
            file: self.source.to_owned(),
            message,
        });
    }

    pub(crate) fn note(&mut self, message: String) {
        self.notes.push(message);
    }

    fn setting(
        &self,
        told: &Trajectory,
        opening: &Opening,
        kept: Option<&KeptEpisode>,
    ) -> TaskSetup {
        let id = [&self.facts.task_id, &told.session_id, &told.trajectory_id]
            .into_iter()
            .flatten()
            .next();
        let stem = || {
            self.source
                .file_stem()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned()
        };
        let task_id = kept.map_or_else(
            || id.cloned().unwrap_or_else(stem),
            |kept| kept.task.task_id.clone(),
        );
        let given = self
            .options
            .tasks
            .iter()
            .find(|task| task.task_id == task_id);
        let task = given
            .map(|task| (**task).clone())
            .or_else(|| kept.map(|kept| kept.task.clone()));
        let Some(task) = task else {
            let mut setup = unknown_task(
                task_id,
                opening.instruction.clone(),
                "unknown".to_owned(),
                WorldGraph::default(),
            );
            setup.task.task_type.clone_from(&self.facts.task_type);
            setup.task.extra.clone_from(&self.facts.task_facts);
            return setup;
        };
        let scene = self.options.scenes.and_then(|scenes| scenes.of(&task));
        let scene = scene.map_or_else(
            || Scene {
                scene_id: task.scene_id.clone(),
                rooms: Vec::new(),
                walls: None,
                robot_start: None,
                receptacles: Vec::new(),
                extra: BTreeMap::new(),
            },
            |scene| (**scene).clone(),
        );
        TaskSetup {
            task,
            scene,
            settings: BTreeMap::new(),
        }
    }

    fn header(
        &self,
        told: &Trajectory,
        opening: &Opening,
        kept: Option<&KeptEpisode>,
        task: &reel_world::Task,
        scene: &Scene,
    ) -> EpisodeHeader {
        let of_task = observe::header(task, scene);
        let mut header = match kept {
            Some(kept) => EpisodeHeader {
                task_digest: of_task.task_digest,
                scene_digest: of_task.scene_digest,
                meshes: BTreeMap::new(),
                parent: None,
                ..kept.header.clone()
            },
            None => EpisodeHeader {
                reward_preset: Preset::default().name().to_owned(),
                policy: PolicyInfo {
                    name: told.agent.name.clone(),
                    parameters: self.facts.parameters.clone(),
                    ..PolicyInfo::default()
                },
                group_id: self.facts.group.as_ref().map(|(group, _)| group.clone()),
                rollout_index: self.facts.group.as_ref().map(|(_, number)| *number),
                ..of_task
            },
        };
        header.backend = Backend::Imported;
        header.run_id = self.options.run_id.to_owned();
        header.episode_id.clear();
        header.build.clear();
        let facts = [
            ("model", told.agent.model_name.clone().map(Value::from)),
            ("version", Some(told.agent.version.clone().into())),
            (
                "tools",
                (!told.agent.tool_definitions.is_empty())
                    .then(|| told.agent.tool_definitions.clone().into()),
            ),
            (
                "system_prompt",
                (!opening.system.is_empty()).then(|| opening.system.clone().into()),
            ),
        ];
        let document = [
            ("session_id", &told.session_id),
            ("trajectory_id", &told.trajectory_id),
        ];
        let document = document
            .map(|(name, id)| (name, id.clone().filter(|_| kept.is_none()).map(Value::from)));
        for (name, fact) in facts.into_iter().chain(document) {
            if let Some(fact) = fact {
                header
                    .policy
                    .parameters
                    .entry(name.to_owned())
                    .or_insert(fact);
            }
        }
        header
    }
}

/// A file, unless it is no file or a large one.
pub(crate) fn read_file(path: &Path, most: u64) -> Result<Vec<u8>, String> {
    let facts = fs::metadata(path).map_err(|error| format!("cannot be read: {error}"))?;
    if !facts.is_file() {
        return Err("it is no file".to_owned());
    }
    if facts.len() > most {
        return Err(format!(
            "it has {} bytes; {most} are read at most",
            facts.len()
        ));
    }
    fs::read(path).map_err(|error| format!("cannot be read: {error}"))
}

/// A text without the mark of its encoding.
fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes)
}
