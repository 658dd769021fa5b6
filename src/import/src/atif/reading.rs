//! Trajectories as traces.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use reel_reward::{Preset, metrics, rewards};
use reel_trace::{Images, Recorder, decode_webp};
use reel_world::{
    Digest, ErrorCode, FRAME_HEIGHT, FRAME_WIDTH, Frame, Outcome, Scene, Tool, ToolCall,
    WorldGraph,
    record::{
        Backend, EndReason, EndRecord, EpisodeHeader, PolicyInfo, PolicyOutput, StartRecord,
        StateDigests, StepInput, StepRecord,
    },
};
use serde_json::{Value, json};

use super::{
    CallResult, Content, KeptEpisode, MESSAGE, OURS, Part, Source, Step, Trajectory,
    model::VERSIONS,
};
use crate::{
    ImportError, ImportLoss, ImportOptions, ImportedEpisode, TaskSetup,
    episode::file_stem,
    image,
    observe::{self, CallObservation, ObservedState, same_graph_for_both},
    outcome, unknown_task,
};

/// Largest document that is read.
const BYTES_MAX: u64 = 1 << 30;
/// Deepest nesting of agents that delegate.
const DEPTH_MAX: usize = 8;

/// The documents under a folder, or the file itself: files `.json` that begin like a trajectory.
///
/// # Errors
/// When a folder cannot be listed, or there is none.
pub fn documents(root: &Path) -> Result<Vec<PathBuf>, ImportError> {
    if root.is_file() {
        return Ok(vec![root.to_owned()]);
    }
    let (mut found, mut open) = (Vec::new(), vec![root.to_owned()]);
    while let Some(folder) = open.pop() {
        let listed = fs::read_dir(&folder).and_then(Iterator::collect::<Result<Vec<_>, _>>);
        let entries = listed.map_err(|source| ImportError::List {
            path: folder.clone(),
            source,
        })?;
        for entry in entries {
            let path = entry.path();
            let kind = entry.file_type();
            if kind.is_ok_and(|kind| kind.is_dir()) {
                open.push(path);
            } else if path.extension().is_some_and(|end| end == "json") && is_trajectory(&path) {
                found.push(path);
            }
        }
    }
    if found.is_empty() {
        return Err(ImportError::NoTrajectory {
            root: root.to_owned(),
        });
    }
    found.sort();
    Ok(found)
}

/// Whether a file names the format; reading says what is wrong with it.
fn is_trajectory(path: &Path) -> bool {
    fs::read(path).is_ok_and(|bytes| {
        let named = bytes
            .windows(VERSIONS.len())
            .any(|part| part == VERSIONS.as_bytes());
        named && bytes.trim_ascii_start().first() == Some(&b'{')
    })
}

/// Writes the trajectory of a document, and those of agents to which it delegated, as traces into
/// the folder `out`, which exists. Equal documents give equal bytes under an equal name.
///
/// # Errors
/// When the file is no trajectory, nothing of it can be imported, or a trace cannot be written.
pub fn import(
    source: &Path,
    out: &Path,
    options: &ImportOptions<'_>,
) -> Result<Vec<ImportedEpisode>, ImportError> {
    let refuse = |reason: String| ImportError::Storage {
        path: source.to_owned(),
        reason,
    };
    let size = fs::metadata(source).map_or(0, |facts| facts.len());
    if size > BYTES_MAX {
        return Err(refuse(format!(
            "the document has {size} bytes; {BYTES_MAX} are read at most"
        )));
    }
    let bytes = fs::read(source).map_err(|error| refuse(format!("cannot be read: {error}")))?;
    let trajectory: Trajectory = serde_json::from_slice(&bytes)
        .map_err(|error| refuse(format!("not a trajectory of ATIF: {error}")))?;
    let mut imported = Vec::new();
    let mut open = vec![(trajectory, 0)];
    while let Some((mut trajectory, depth)) = open.pop() {
        if !trajectory.schema_version.starts_with(VERSIONS) {
            let version = &trajectory.schema_version;
            return Err(refuse(format!(
                "version '{version}' is not read; ATIF-v1.0 to v1.8 are"
            )));
        }
        let delegated = std::mem::take(&mut trajectory.subagent_trajectories);
        if depth < DEPTH_MAX {
            open.extend(delegated.into_iter().rev().map(|one| (one, depth + 1)));
        } else if !delegated.is_empty() {
            return Err(refuse(format!(
                "agents delegate more than {DEPTH_MAX} deep"
            )));
        }
        imported.push(Episode::new(source, options).write(trajectory, out)?);
    }
    Ok(imported)
}

/// An episode on its way from a trajectory to a trace.
struct Episode<'a> {
    source: &'a Path,
    options: &'a ImportOptions<'a>,
    losses: Vec<ImportLoss>,
    notes: Vec<String>,
}

/// A call of a trajectory with what came of it.
struct Decision {
    input: StepInput,
    result: Outcome,
    frame: Option<Frame>,
    kept: Option<StepRecord>,
}

/// What a trajectory tells before the first turn of the agent.
#[derive(Default)]
struct Opening {
    system: String,
    instruction: String,
    frame: Option<Frame>,
}

impl<'a> Episode<'a> {
    fn new(source: &'a Path, options: &'a ImportOptions<'a>) -> Self {
        Self {
            source,
            options,
            losses: Vec::new(),
            notes: Vec::new(),
        }
    }

    fn write(mut self, mut told: Trajectory, out: &Path) -> Result<ImportedEpisode, ImportError> {
        let kept = self.kept::<KeptEpisode>(told.extra.remove(OURS), "extra");
        let (opening, decisions) = self.read(std::mem::take(&mut told.steps));
        if decisions.is_empty() {
            return Err(ImportError::NoStep {
                path: self.source.to_owned(),
                reason: "the agent does nothing in it".to_owned(),
            });
        }
        let TaskSetup { task, scene, .. } = self.setting(&told, &opening, kept.as_ref());
        let digests = |frame: Option<&Frame>| StateDigests {
            frame: frame.map(Frame::digests),
            ..StateDigests::default()
        };
        let graphs = kept.as_ref().map_or_else(
            || same_graph_for_both(&task.initial),
            |kept| kept.graphs.clone(),
        );
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
            let frame = decision.frame.as_ref().map(Frame::digests);
            records.push(match decision.kept {
                Some(record) => StepRecord {
                    step,
                    digests: digests(decision.frame.as_ref()),
                    ..record
                },
                None => {
                    let tool = Tool::parse(&decision.input.call).ok();
                    let shown = CallObservation {
                        reply: outcome::reply(tool.as_ref(), &decision.result),
                        input: decision.input,
                        tool,
                        outcome: decision.result,
                        frame,
                    };
                    observe::record(step, shown, &state, &state)
                }
            });
            frames.push(decision.frame);
        }
        let preset = Preset::default();
        if kept.is_none() {
            let terms = rewards(&preset, &task, &scene, &start, &records);
            for (record, terms) in records.iter_mut().zip(terms) {
                record.reward = terms;
            }
        }
        let mut header = self.header(&told, &opening, kept.as_ref(), &task, &scene);
        // Two runs of an agent have equal inputs as far as they are known: what came of them tells
        // them apart.
        header.episode_id =
            Digest::of_json(&(&header, &start, &records)).to_string()[..16].to_owned();
        header.build = env!("CARGO_PKG_VERSION").to_owned();
        let end = kept.and_then(|kept| kept.end).unwrap_or_else(|| {
            let graphs = start.graphs.clone();
            let broken_off = told.continued_trajectory_ref.is_some();
            EndRecord {
                reason: if broken_off {
                    EndReason::Aborted
                } else {
                    EndReason::Finished
                },
                metrics: metrics(&preset, &task, &start, &records, &graphs),
                graphs,
                steps: records.len() as u32,
            }
        });
        if let Some(next) = &told.continued_trajectory_ref {
            self.notes.push(format!(
                "the trajectory goes on in {next}, which is an episode of its own"
            ));
        }
        let trace = out.join(format!("{}.mcap", file_stem(&header)));
        let mut recorder = Recorder::create(&trace, &header, &task, &scene, Images::Full)?;
        recorder.start(&start, opening.frame.as_ref())?;
        for (record, frame) in records.iter().zip(&frames) {
            recorder.input(record.step, &record.input)?;
            recorder.step(record, frame.as_ref())?;
        }
        let summary = recorder.end(&end)?;
        Ok(ImportedEpisode {
            source: self.source.to_owned(),
            trace,
            bytes: summary.bytes,
            task_id: task.task_id,
            steps: end.steps,
            images: frames.iter().chain([&opening.frame]).flatten().count() as u32,
            end: end.reason,
            success: end.metrics.success,
            losses: self.losses,
            notes: self.notes,
        })
    }

    /// What a document of ours keeps under `extra.reel`; what is not understood is lost.
    fn kept<T: serde::de::DeserializeOwned>(
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

    fn lose(&mut self, message: String) {
        self.losses.push(ImportLoss {
            file: self.source.to_owned(),
            message,
        });
    }

    /// The turns as calls, and what was told before the first.
    fn read(&mut self, turns: Vec<Step>) -> (Opening, Vec<Decision>) {
        let (mut opening, mut decisions) = (Opening::default(), Vec::<Decision>::new());
        for turn in turns {
            if turn.is_copied_context == Some(true) {
                self.notes.push(format!(
                    "step {} is copied from an earlier trajectory and left out",
                    turn.step_id
                ));
                continue;
            }
            let place = format!("step {}", turn.step_id);
            if turn.source == Source::Agent {
                self.decide(turn, &place, &mut decisions);
                continue;
            }
            let (mut text, frame) = self.content(turn.message, &place);
            for result in turn.observation.into_iter().flat_map(|seen| seen.results) {
                let (more, _) = self.result(result, &place);
                join(&mut text, &more);
            }
            match (decisions.last_mut(), turn.source) {
                (None, Source::System) => join(&mut opening.system, &text),
                (None, _) => {
                    join(&mut opening.instruction, &text);
                    opening.frame = frame.or(opening.frame);
                }
                (Some(last), _) => {
                    join(&mut last.result.text, &text);
                    last.frame = frame.or(last.frame.take());
                }
            }
        }
        (opening, decisions)
    }

    /// A turn of the agent: one decision for each call, the first of which has what was said.
    fn decide(&mut self, mut turn: Step, place: &str, decisions: &mut Vec<Decision>) {
        let kept = turn.extra.remove(OURS);
        let kept = self.kept::<StepRecord>(kept, &format!("{place}: extra"));
        let (raw, _) = self.content(turn.message, place);
        let metrics = turn.metrics.unwrap_or_default();
        let tokens = [metrics.prompt_tokens, metrics.completion_tokens];
        let policy = PolicyOutput {
            raw,
            reasoning: turn.reasoning_content.unwrap_or_default(),
            tokens: tokens
                .iter()
                .any(Option::is_some)
                .then(|| tokens.map(Option::unwrap_or_default)),
            ..PolicyOutput::default()
        };
        if kept.is_none() && metrics.logprobs.is_some() {
            self.notes.push(format!(
                "{place}: log-probabilities without the texts of their tokens are left out"
            ));
        }
        let first = decisions.len();
        let mut ids = Vec::new();
        for call in turn.tool_calls {
            ids.push(call.tool_call_id);
            decisions.push(Decision::new(ToolCall::new(
                call.function_name,
                call.arguments,
            )));
        }
        if ids.is_empty() {
            decisions.push(Decision::new(ToolCall::new(MESSAGE, json!({}))));
        }
        for result in turn.observation.into_iter().flat_map(|seen| seen.results) {
            let of = result.source_call_id.as_ref();
            let number = of.and_then(|id| ids.iter().position(|known| known == id));
            let number = number.map_or(decisions.len() - 1, |number| first + number);
            let (text, frame) = self.result(result, place);
            let decision = &mut decisions[number];
            join(&mut decision.result.text, &text);
            decision.frame = frame.or(decision.frame.take());
        }
        for decision in &mut decisions[first..] {
            let text = &decision.result.text;
            let ours = Tool::parse(&decision.input.call).is_ok();
            decision.result.error = ErrorCode::from_message(text).filter(|_| ours);
        }
        let decision = &mut decisions[first];
        match kept {
            // A document of ours has one call a turn.
            Some(mut record) => {
                record.outcome.text.clone_from(&decision.result.text);
                let called = &decision.input.call;
                let arguments = std::mem::take(&mut record.input.call.arguments);
                record.input.call = ToolCall {
                    arguments: if arguments.is_null() {
                        called.arguments.clone()
                    } else {
                        arguments
                    },
                    ..called.clone()
                };
                if let Some(kept) = &mut record.input.policy {
                    (kept.raw, kept.reasoning, kept.tokens) =
                        (policy.raw, policy.reasoning, policy.tokens);
                }
                decision.kept = Some(record);
            }
            None => {
                let spoke = policy != PolicyOutput::default();
                decision.input.policy = spoke.then_some(policy);
            }
        }
    }

    fn result(&mut self, result: CallResult, place: &str) -> (String, Option<Frame>) {
        result
            .content
            .map_or_else(Default::default, |content| self.content(content, place))
    }

    /// The texts of a content, and the last of its images.
    fn content(&mut self, content: Content, place: &str) -> (String, Option<Frame>) {
        let parts = match content {
            Content::Text(text) => return (text, None),
            Content::Parts(parts) => parts,
        };
        let (mut texts, mut frame) = (String::new(), None);
        for part in parts {
            match part {
                Part::Text { text } => join(&mut texts, &text),
                Part::Image { source } => match self.image(&source.path) {
                    Ok(image) => frame = Some(image),
                    Err(why) => {
                        self.lose(format!("{place}: image {} is left out: {why}", source.path))
                    }
                },
                Part::Audio { source } => {
                    self.lose(format!("{place}: sound {} is left out", source.path));
                }
            }
        }
        (texts, frame)
    }

    /// An image beside the document; addresses are not asked.
    fn image(&self, path: &str) -> Result<Frame, String> {
        if path.contains("://") {
            return Err("it lies elsewhere; download it and name the file".to_owned());
        }
        let folder = self.source.parent().unwrap_or(Path::new("."));
        let bytes = fs::read(folder.join(path)).map_err(|error| error.to_string())?;
        if !bytes.starts_with(b"RIFF") {
            return image::decode(&bytes);
        }
        let pixels = (FRAME_WIDTH * FRAME_HEIGHT) as u32;
        match decode_webp(&bytes, pixels) {
            Some((rgb, width, height))
                if (width as usize, height as usize) == (FRAME_WIDTH, FRAME_HEIGHT) =>
            {
                Ok(Frame::of_rgb(rgb))
            }
            _ => Err(format!(
                "not a WebP image of {FRAME_WIDTH} x {FRAME_HEIGHT} pixels"
            )),
        }
    }

    fn setting(
        &self,
        told: &Trajectory,
        opening: &Opening,
        kept: Option<&KeptEpisode>,
    ) -> TaskSetup {
        let id = [&told.session_id, &told.trajectory_id]
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
            return unknown_task(
                task_id,
                opening.instruction.clone(),
                "unknown".to_owned(),
                WorldGraph::default(),
            );
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
                    ..PolicyInfo::default()
                },
                ..of_task
            },
        };
        header.backend = Backend::Proxy;
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
        for (name, fact) in facts {
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

impl Decision {
    fn new(call: ToolCall) -> Self {
        Self {
            input: StepInput::from_call(call),
            result: Outcome::ok(""),
            frame: None,
            kept: None,
        }
    }
}

/// Adds a text on a line of its own.
fn join(text: &mut String, more: &str) {
    if !text.is_empty() && !more.is_empty() {
        text.push('\n');
    }
    text.push_str(more);
}
