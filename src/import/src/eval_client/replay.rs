//! Recorded traces as a server and an agent, so that [`super::run`] writes the files that the
//! client would have written.

use std::path::PathBuf;

use base64::{Engine, engine::general_purpose::STANDARD};
use reel_trace::{Trace, TraceError, TraceFiles, encode_png};
use reel_world::{
    DoorState, ErrorCode, FRAME_HEIGHT, FRAME_WIDTH, Tool, ToolSpec, WorldGraph,
    record::{EndReason, MarkerTarget, PolicyOutput, StepRecord},
};
use serde_json::{Map, Value, json};

use super::{Content, Decision, EvalDriver, ToolResult, result::DEBUG_TEXT, run::Stop};

/// What stands where a recording ends whose episode was broken off: nothing failed, and the client
/// has no word for that.
pub(crate) const BROKEN_OFF: &str = "the recording ends here: the episode was broken off";

/// Traces of one model, in the order of their episodes.
#[derive(Debug)]
pub struct RecordedRun<'a> {
    files: &'a TraceFiles,
    paths: std::slice::Iter<'a, PathBuf>,
    /// `episode_idx` of the next trace.
    index: u32,
    playing: Option<Playing>,
    problem: Option<TraceError>,
}

#[derive(Debug)]
struct Playing {
    trace: Trace,
    next: usize,
    graph: WorldGraph,
    landmark: Option<String>,
}

impl<'a> RecordedRun<'a> {
    /// The traces of these files.
    pub fn new(files: &'a TraceFiles, paths: &'a [PathBuf]) -> Self {
        Self {
            files,
            paths: paths.iter(),
            index: 0,
            playing: None,
            problem: None,
        }
    }

    /// The trace that could not be read, if that is what ended the run.
    pub fn problem(&mut self) -> Option<TraceError> {
        self.problem.take()
    }
}

impl EvalDriver for RecordedRun<'_> {
    fn tools(&mut self) -> Vec<String> {
        ToolSpec::POLICY
            .iter()
            .map(|spec| spec.repo_name.to_owned())
            .collect()
    }

    fn call(&mut self, tool: &str, _args: &Value) -> Result<Vec<Content>, String> {
        if tool != "finish" {
            let playing = self.playing.as_mut().ok_or("no episode is under way")?;
            return playing.result();
        }
        let Some(path) = self.paths.next() else {
            return Ok(vec![Content::Text(super::run::END.to_owned())]);
        };
        let trace = self.files.read(path).map_err(|error| {
            let what = error.to_string();
            self.problem = Some(error);
            what
        })?;
        let task = payload(&trace, self.index);
        self.index += 1;
        let graph = trace.start.graphs.registry.clone();
        self.playing = Some(Playing {
            trace,
            next: 0,
            graph,
            landmark: None,
        });
        Ok(vec![Content::Text(Value::Object(task).to_string())])
    }

    fn begin(&mut self, _task: &Map<String, Value>) {}

    fn decide(&mut self) -> Result<Decision, Stop> {
        let ended = || Stop::Failed("no episode is under way".to_owned());
        self.playing.as_mut().ok_or_else(ended)?.decide()
    }

    fn observe(&mut self, _tool: &str, _result: &ToolResult) {}
}

impl Playing {
    fn decide(&mut self) -> Result<Decision, Stop> {
        let Some(record) = self.trace.steps.get(self.next) else {
            return Err(match self.trace.end.as_ref().map(|end| end.reason) {
                Some(EndReason::Horizon) => Stop::OutOfSteps,
                Some(EndReason::Aborted) | None => Stop::Failed(BROKEN_OFF.to_owned()),
                Some(reason) => Stop::Failed(format!("the recording ends here: {reason:?}")),
            });
        };
        self.next += 1;
        let policy = record.input.policy.as_ref();
        let (tool, args) = (tool(record), arguments(record));
        Ok(Decision {
            raw: policy
                .and_then(|policy| answer(policy, tool.as_deref(), &args))
                .map(Value::from),
            tool,
            args,
            user_message: None,
            seconds: policy
                .and_then(|policy| policy.latency_ns)
                .map_or(0.0, |latency| latency as f64 / 1e9),
        })
    }

    /// What the call that was decided last came to: its text, the image after it, and what is
    /// known of the world.
    fn result(&mut self) -> Result<Vec<Content>, String> {
        let record = self
            .next
            .checked_sub(1)
            .and_then(|index| self.trace.steps.get(index))
            .ok_or("no call was decided")?;
        self.graph.apply(&record.changes.registry);
        let leads_there = match Tool::parse(&record.input.call) {
            Ok(Tool::NavTo { .. } | Tool::WalkAround) => true,
            // A look at a receptacle leads there in profile `paper` alone.
            Ok(Tool::GazeAt { .. }) => !self.trace.header.profile.is_published(),
            _ => false,
        };
        if let Some(receptacle) = &record.receptacle
            && leads_there
            && record.outcome.is_ok()
        {
            self.landmark = Some(receptacle.to_string());
        }
        let mut content = Vec::new();
        if !record.outcome.text.is_empty() {
            content.push(Content::Text(record.outcome.text.clone()));
        }
        if let Some(rgb) = self
            .trace
            .frame_rgb(Some(record.step))
            .map_err(|error| error.to_string())?
        {
            content.push(Content::Image(STANDARD.encode(encode_png(
                &rgb,
                FRAME_WIDTH as u32,
                FRAME_HEIGHT as u32,
            ))));
        }
        let markers: Map<String, Value> = record
            .markers
            .iter()
            .map(|marker| {
                let target = match &marker.target {
                    MarkerTarget::Object(object) => json!(object),
                    MarkerTarget::Receptacle(receptacle) => json!(receptacle),
                };
                (marker.id.to_string(), target)
            })
            .collect();
        // The published server says it by an empty map alone; no map is one before any search.
        let found_nothing =
            record.outcome.error == Some(ErrorCode::NothingFound) && record.outcome.text.is_empty();
        let debug = json!({
            "CURRENT_LANDMARK": self.landmark,
            "CURRENT_POS": record.robot.camera,
            "CURRENT_INV": record.held,
            "CURRENT_MARKER_MAP": (!markers.is_empty() || found_nothing).then_some(markers),
            "world_graph": graph_json(&self.graph),
        });
        content.push(Content::Text(format!("{DEBUG_TEXT}{debug}")));
        Ok(content)
    }
}

/// What the model answered. The words of a policy that is no model are written as REAL's agents
/// answer: no other file has a place for its History. `None` if it said nothing.
fn answer(policy: &PolicyOutput, tool: Option<&str>, args: &Value) -> Option<String> {
    let PolicyOutput {
        raw,
        reasoning,
        history,
        plan,
        ..
    } = policy;
    if !raw.is_empty() {
        return Some(raw.clone());
    }
    if reasoning.is_empty() && history.is_empty() && plan.is_empty() {
        return None;
    }
    let plan = plan.strip_prefix("New Schedule: ").unwrap_or(plan);
    let (schedule, subtask) = plan.split_once(" Current subtask: ").unzip();
    let answer = json!({
        "summary": {
            "History": history,
            "New Schedule": schedule.unwrap_or(plan),
            "Current subtask": subtask.unwrap_or_default(),
        },
        "next action": { "tool_name": tool, "args": args },
    });
    Some(format!(
        "<think>\n{reasoning}\n</think>\n```json\n{answer}\n```\n"
    ))
}

/// The tool of a call under its canonical name; `None` if the agent named none.
fn tool(record: &StepRecord) -> Option<String> {
    let name = record.input.call.name.as_str();
    (!name.is_empty()).then(|| {
        ToolSpec::by_name(name)
            .map_or(name, |spec| spec.repo_name)
            .to_owned()
    })
}

/// The arguments of a call; the number of a marker is a text in the published schema.
fn arguments(record: &StepRecord) -> Value {
    let mut arguments = record
        .input
        .call
        .arguments
        .as_object()
        .cloned()
        .unwrap_or_default();
    if let Some(marker) = arguments.get_mut("marker_id")
        && let Value::Number(number) = marker
    {
        *marker = json!(number.to_string());
    }
    Value::Object(arguments)
}

/// A task as the server tells it.
fn payload(trace: &Trace, index: u32) -> Map<String, Value> {
    let task = &trace.task;
    let target = task.target_object();
    let (is_benchmark, short) = match task.task_id.split_once('/') {
        Some((_, short)) => (true, short),
        None => (false, task.task_id.as_str()),
    };
    let extra = |key: &str| {
        task.extra
            .get(&format!("episodes[0].{key}"))
            .or_else(|| task.extra.get(key))
            .cloned()
    };
    let payload = json!({
        "task_id": short,
        "benchmark_task_id": is_benchmark.then_some(&task.task_id),
        "family": is_benchmark.then_some(task.family),
        "global_index": extra("global_index"),
        "episode_idx": index,
        "task_description": task.instruction,
        "scene_id": task.scene_id,
        "initial_world_graph": graph_json(&trace.start.graphs.registry),
        "target_world_graph": graph_json(&task.goal),
        "target_object": { "id": target.asset, "name": target.instance, "category": target.category },
        "source_furniture": task.src,
        "destination_furniture": task.dest,
    });
    payload.as_object().cloned().unwrap_or_default()
}

/// A graph as the server writes it: names in lists, doors as booleans.
fn graph_json(graph: &WorldGraph) -> Value {
    let state = |(id, state): (&reel_world::ReceptacleId, &reel_world::ReceptacleState)| {
        let mut entry = json!({ "content": graph.objects_on(id) });
        if let Some(door) = state.door {
            entry["door"] = json!(door == DoorState::Open);
        }
        (id.to_string(), entry)
    };
    Value::Object(graph.receptacles.iter().map(state).collect())
}
