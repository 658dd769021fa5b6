//! The records of an episode from its files: what each step did to the world, its rewards, the
//! end.

use reel_reward::{Preset, metrics, open_reward, rewards};
use reel_world::{
    AssetId, Digest, Frame, InstanceId, ReceptacleId, Scene, Task, Tool, ToolCall, WorldGraph,
    record::{
        EndReason, EndRecord, EpisodeHeader, PolicyInfo, Reported, StartRecord, StepInput,
        StepRecord,
    },
};
use serde_json::{Map, Value};

use crate::{
    ImportError, ImportLoss, ImportOptions, graph,
    layout::{After, Files, StepFiles},
    observe::{self, CallObservation, ObservedState, same_graph_for_both},
    outcome, response,
    task::{self, ObservedWorld, TaskSetup, TaskSource, text},
};

/// Longest latency that is believed.
const LATENCY_MAX_S: f64 = 86_400.0;

/// An episode ready to be recorded.
pub(crate) struct Built {
    pub header: EpisodeHeader,
    pub task: Task,
    pub scene: Scene,
    pub start: StartRecord,
    /// Records of the steps in order, each with its frame; `None` if it has none.
    pub steps: Vec<(StepRecord, Option<Frame>)>,
    pub end: EndRecord,
    pub losses: Vec<ImportLoss>,
    pub notes: Vec<String>,
}

impl Built {
    /// Name of the trace: task, policy and content, so that equal episodes have one
    /// name and others another.
    pub(crate) fn file_stem(&self) -> String {
        file_stem(&self.header)
    }
}

/// File name of the trace without its extension: task, policy and episode id.
pub(crate) fn file_stem(header: &EpisodeHeader) -> String {
    let safe = |text: &str| {
        text.replace(
            |letter: char| !letter.is_ascii_alphanumeric() && !"._-".contains(letter),
            "_",
        )
    };
    let EpisodeHeader {
        task_id,
        policy,
        episode_id,
        ..
    } = header;
    let short = |text: &str| safe(text).chars().take(80).collect::<String>();
    let stem = format!("{}--{}--{episode_id}", short(task_id), short(&policy.name));
    // No hidden file.
    match stem.strip_prefix('.') {
        Some(rest) => format!("_{rest}"),
        None => stem,
    }
}

/// Makes the records of an episode.
///
/// # Errors
/// When there is no step, or the task is not known.
pub(crate) fn build(mut files: Files, options: &ImportOptions<'_>) -> Result<Built, ImportError> {
    let status = files
        .summary
        .as_ref()
        .and_then(|summary| text(summary, "status"));
    if status.as_deref() == Some("skipped") {
        return Err(ImportError::Skipped { path: files.folder });
    }
    if files.steps.is_empty() {
        let first = files
            .losses
            .iter()
            .find(|loss| loss.file.starts_with(files.folder.join("step_000")));
        let what = first.map_or_else(|| "there is none".to_owned(), ToString::to_string);
        let what = if files.after == After::Fault {
            "the agent failed in the first one".to_owned()
        } else {
            what
        };
        return Err(ImportError::NoStep {
            path: files.folder,
            reason: what,
        });
    }
    let read = std::mem::take(&mut files.steps);
    let (seen, states) = look(&mut files, &read);
    let folders = [files.folder_name(1), files.folder_name(2)];
    let mut told = TaskSource {
        meta: &files.meta,
        folders,
        path: &files.folder,
        notes: Vec::new(),
    };
    let TaskSetup {
        task,
        scene,
        settings,
    } = task::setting(&mut told, &seen, options)?;
    let notes = told.notes;
    files.notes.extend(notes);
    let reason = end_reason(&mut files, status.as_deref(), &read);

    let initial = seen.first.clone().unwrap_or_else(|| task.initial.clone());
    let start = StartRecord {
        graphs: same_graph_for_both(&initial),
        ..StartRecord::default()
    };
    let mut before = ObservedState {
        graph: Some(initial),
        ..ObservedState::default()
    };
    let (mut records, mut frames) = (Vec::new(), Vec::new());
    for (step, (read, state)) in (0..).zip(read.into_iter().zip(states)) {
        let state = ObservedState {
            graph: state.graph.or_else(|| before.graph.clone()),
            ..state
        };
        let (record, frame) = record(step, read, &before, &state, &mut files);
        records.push(record);
        frames.push(frame);
        before = state;
    }
    let graphs = same_graph_for_both(&before.graph.unwrap_or_default());
    let preset = Preset::default();
    let terms = rewards(&preset, &task, &scene, &start, &records);
    for (record, terms) in records.iter_mut().zip(terms) {
        record.reward = terms;
    }
    let open = open_reward(&preset, options.tasks, &task, &scene, &start, &records);
    files.notes.extend(open.map(|open| open.to_string()));

    let name = text(&files.meta, "model")
        .or_else(|| files.folder_name(0))
        .unwrap_or_else(|| "unknown".to_owned());
    let mut header = EpisodeHeader {
        run_id: options.run_id.to_owned(),
        reward_preset: preset.name().to_owned(),
        policy: PolicyInfo {
            name,
            checkpoint: None,
            parameters: settings,
        },
        ..observe::header(&task, &scene)
    };
    // Two runs of a model on a task have equal inputs as far as they are known: what came of
    // them tells them apart.
    header.episode_id = Digest::of_json(&(&header, &start, &records)).to_string()[..16].to_owned();
    header.build = env!("CARGO_PKG_VERSION").to_owned();

    let metrics = metrics(&preset, &task, &start, &records, &graphs);
    let told = files
        .summary
        .as_ref()
        .and_then(|summary| summary.get("success")?.as_bool());
    if told.is_some_and(|told| told != metrics.success) {
        files.notes.push(format!(
            "the agent's summary says success {}, the graphs {}",
            !metrics.success, metrics.success
        ));
    }
    let end = EndRecord {
        reason,
        graphs,
        metrics,
        steps: records.len() as u32,
        reported: Reported {
            success: told,
            ..Reported::default()
        },
    };
    let steps = records.into_iter().zip(frames).collect();
    Ok(Built {
        header,
        task,
        scene,
        start,
        steps,
        end,
        losses: files.losses,
        notes: files.notes,
    })
}

/// Follows the states of the world through all steps, and gathers what they show of it.
fn look(files: &mut Files, steps: &[StepFiles]) -> (ObservedWorld, Vec<ObservedState>) {
    let mut seen = ObservedWorld::default();
    let mut known: Option<WorldGraph> =
        files.meta.get("initial_world_graph").and_then(graph::parse);
    seen.first = known.clone();
    let mut states: Vec<ObservedState> = Vec::new();
    for (number, step) in steps.iter().enumerate() {
        let mut state = ObservedState {
            graph: None,
            ..states.last().cloned().unwrap_or_default()
        };
        state.update(&step.debug_info);
        state.graph = graph::of_debug_info(&step.debug_info, known.as_ref());
        if let Some(graph) = &state.graph {
            if seen.first.is_none() {
                seen.first = Some(first_graph(files, graph, state.held.as_ref(), number));
            }
            known = Some(graph.clone());
        }
        if let Some(text) = &step.text {
            seen.categories.extend(told_categories(
                text,
                state.markers.as_deref().unwrap_or_default(),
            ));
        }
        states.push(state);
    }
    for graph in seen
        .first
        .clone()
        .iter()
        .chain(states.iter().filter_map(|state| state.graph.as_ref()))
    {
        seen.take_in(graph);
    }
    (seen, states)
}

/// The graph before the first decision, from the first that a step shows.
fn first_graph(
    files: &mut Files,
    graph: &WorldGraph,
    held: Option<&InstanceId>,
    step: usize,
) -> WorldGraph {
    let mut first = graph.clone();
    if step > 0 {
        files.notes.push(format!(
            "no step before step {step} shows a graph; the start is taken from there"
        ));
    }
    if let Some(held) = held {
        match home_of(held).filter(|home| graph.receptacles.contains_key(home)) {
            Some(home) => first.add(&home, held),
            None => files.notes.push(format!(
                "{held} is held in the first graph, and where it stood is not in the files"
            )),
        }
    }
    first
}

/// The receptacle in the key `<asset>_on_<receptacle>_at_<task>`.
fn home_of(object: &InstanceId) -> Option<ReceptacleId> {
    let (_, rest) = object.as_str().split_once("_on_")?;
    Some(rest.split_once("_at_")?.0.into())
}

/// Categories in an inventory (`1: a(an) apple.`), by what its numbers stand for.
fn told_categories(text: &str, markers: &[(u32, String)]) -> Vec<(AssetId, String)> {
    let line = |line: &str| {
        let (number, rest) = line.trim().split_once(": a(an) ")?;
        let number: u32 = number.parse().ok()?;
        let (_, object) = markers.iter().find(|(id, _)| *id == number)?;
        Some((
            InstanceId::from(object.as_str()).asset(),
            rest.trim_end_matches('.').to_owned(),
        ))
    };
    text.lines().filter_map(line).collect()
}

/// One step. `before` and `after` know their graphs.
fn record(
    step: u32,
    read: StepFiles,
    before: &ObservedState,
    after: &ObservedState,
    files: &mut Files,
) -> (StepRecord, Option<Frame>) {
    let name = text(&read.call, "tool_name").unwrap_or_default();
    let arguments = read.call.get("args").cloned().unwrap_or(Value::Null);
    let call = ToolCall::new(name, arguments);
    let marked = read
        .debug_info
        .get("CURRENT_MARKER_MAP")
        .and_then(Value::as_object)
        .map(Map::len);
    let tool = Tool::parse(&call).ok();
    let mut outcome = outcome::outcome(&call, tool.as_ref(), read.text.as_deref(), marked);
    if read.failed && outcome.is_ok() {
        outcome.error = Some(reel_world::ErrorCode::BackendError);
    }
    let reply = outcome::reply(tool.as_ref(), &outcome);
    let mut policy = read.raw.map(response::parse);
    if let Some(latency_ns) = latency_ns(&read.time, step, files) {
        policy.get_or_insert_default().latency_ns = Some(latency_ns);
    }
    let input = StepInput {
        policy,
        user_reply: reply.clone(),
        ..StepInput::from_call(call)
    };
    let frame = read.image.as_ref().map(Frame::digests);
    (
        observe::record(
            step,
            CallObservation {
                input,
                tool,
                outcome,
                reply,
                frame,
            },
            before,
            after,
        ),
        read.image,
    )
}

/// How long the policy took. Older agents wrote `infer_time`.
fn latency_ns(time: &Map<String, Value>, step: u32, files: &mut Files) -> Option<u64> {
    let seconds = time
        .get("inference_time")
        .or_else(|| time.get("infer_time"))?
        .as_f64()?;
    if (0.0..=LATENCY_MAX_S).contains(&seconds) {
        return Some((seconds * 1e9).round() as u64);
    }
    files.notes.push(format!(
        "step {step}: a latency of {seconds} s is not believed"
    ));
    None
}

/// Why the episode ended: as its steps show, else as its summary says.
fn end_reason(files: &mut Files, status: Option<&str>, steps: &[StepFiles]) -> EndReason {
    let is_finish = |step: &StepFiles| text(&step.call, "tool_name").as_deref() == Some("finish");
    let told = files
        .summary
        .as_ref()
        .and_then(|summary| summary.get("total_steps")?.as_u64());
    // The client counts the step in which its own model failed; one that was not
    // written down is missing.
    let present = steps.len() as u64 + u64::from(files.after == After::Fault);
    let reason = match (files.after, status) {
        (After::Unreadable | After::Begun | After::BrokenOff, _) => EndReason::Aborted,
        (After::Fault, _) => EndReason::Fault,
        (After::Nothing, _) if told.is_some_and(|told| told > present) => {
            let what = format!(
                "it counts {} steps, but there are {present}; those are imported",
                told.unwrap_or_default()
            );
            files.lose(files.folder.join("episode_summary.json"), what);
            return EndReason::Aborted;
        }
        (After::Nothing, _) if steps.last().is_some_and(is_finish) => EndReason::Finished,
        (After::Nothing, Some("max_steps_reached")) => EndReason::Horizon,
        (After::Nothing, Some("inference_error" | "action_error")) => EndReason::Fault,
        (After::Nothing, Some(other)) => {
            files.notes.push(format!(
                "the status is {other}, but no step says so; taken as broken off"
            ));
            EndReason::Aborted
        }
        (After::Nothing, None) => EndReason::Aborted,
    };
    if files.after == After::Begun {
        files.notes.push(format!(
            "step {} was begun, and no call of it was written down",
            steps.len()
        ));
    } else if status.is_none() && reason == EndReason::Aborted && files.after == After::Nothing {
        files
            .notes
            .push("there is no status; the episode is taken as broken off".to_owned());
    }
    reason
}
