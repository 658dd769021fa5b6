//! Recordings to answer from, as they lie in files.

use std::{
    ops::Range,
    path::{Path, PathBuf},
    sync::Arc,
};

use reel_trace::{AnsweredRequest, Trace};
use reel_world::{
    Profile, ToolCall,
    record::{Backend, EndReason, StepRecord},
};
use serde::Deserialize;
use serde_json::Value;

use crate::TapeError;

/// A recording to answer from.
#[derive(Clone, Debug)]
pub struct Tape {
    trace: Arc<Trace>,
}

/// Recordings of one kind of server, in the order in which they are played.
#[derive(Clone, Debug)]
pub struct Tapes(Vec<Tape>);

/// A call as a recorder of another server keeps it where a mapping stood between.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawCall {
    name: String,
    arguments: Value,
}

/// An answer of another server: the one member of its message.
#[derive(Clone, PartialEq, Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum RecordedAnswer {
    /// The result of the request.
    Result(Value),
    /// The error of JSON-RPC instead of a result.
    Error(Value),
}

impl Tape {
    /// A recording that was read.
    pub fn new(trace: Trace) -> Self {
        let trace = Arc::new(trace);
        Self { trace }
    }

    /// The records of the recording.
    pub fn trace(&self) -> &Trace {
        &self.trace
    }

    /// Path of the trace that was read.
    pub fn path(&self) -> &Path {
        &self.trace.path
    }

    /// Whether Reel's simulator recorded it, so that it can go on.
    pub fn is_simulated(&self) -> bool {
        self.trace.header.backend == Backend::Sim
    }

    /// Which server answered in it.
    pub fn profile(&self) -> Profile {
        self.trace.header.profile
    }

    /// The recorded call at a step, as the agent sent it; `None` after the last.
    pub fn call(&self, step: usize) -> Option<ToolCall> {
        let input = &self.trace.steps.get(step)?.input;
        let raw = input.policy.as_ref().filter(|_| !self.is_simulated());
        let raw = raw.and_then(|policy| serde_json::from_str::<RawCall>(&policy.raw).ok());
        Some(raw.map_or_else(
            || input.call.clone(),
            |raw| ToolCall::new(raw.name, raw.arguments),
        ))
    }

    /// The steps from this one on whose calls an agent may make in any order: it made each of them
    /// before it had the result of the one before, so that no result decided it.
    pub(crate) fn made_at_once(&self, step: usize) -> Range<usize> {
        // The recorder notes no time to decide where a call came before the result of the last one.
        let is_undecided = |step: &&StepRecord| {
            let policy = step.input.policy.as_ref();
            policy.and_then(|policy| policy.latency_ns) == Some(0)
        };
        let later = self.trace.steps.iter().skip(step + 1);
        let more = later
            .take_while(|step| !self.is_simulated() && is_undecided(step))
            .count();
        step..step + 1 + more
    }

    /// Whether an agent gets its task by a call of `finish`, which is no step of the recording.
    pub fn begins_with_finish(&self) -> bool {
        let answers = &self.trace.mcp_answers;
        self.is_simulated() || answers.contains_key(&AnsweredRequest::Start)
    }

    /// What the server answered to a request of the recording, as it came: `result` or `error` of the
    /// message. `None` if the recording does not keep it.
    pub(crate) fn recorded(&self, request: AnsweredRequest) -> Option<RecordedAnswer> {
        let json = self.trace.mcp_answers.get(&request)?;
        serde_json::from_str(json).ok()
    }

    /// How many calls it has.
    pub fn len(&self) -> usize {
        self.trace.steps.len()
    }

    /// Whether it has no call.
    pub fn is_empty(&self) -> bool {
        self.trace.steps.is_empty()
    }

    /// Why the server ended the episode with its last call; `None` if it was left running.
    pub fn ended(&self) -> Option<EndReason> {
        let reason = self.trace.end.as_ref()?.reason;
        (reason != EndReason::Aborted).then_some(reason)
    }

    /// What kind of server it is of, in words.
    fn server(&self) -> String {
        match self.is_simulated() {
            true => format!("the simulator in profile {:?}", self.profile()),
            false => "another server".to_owned(),
        }
    }
}

impl Tapes {
    /// Recordings in the order in which they are played.
    ///
    /// # Errors
    /// When there is none, or they are of different kinds of server: tools and texts differ then.
    pub fn new(tapes: Vec<Tape>) -> Result<Self, TapeError> {
        let first = tapes.first().ok_or(TapeError::Empty)?;
        let kind = |tape: &Tape| {
            (
                tape.is_simulated(),
                tape.is_simulated().then(|| tape.profile()),
            )
        };
        if let Some(other) = tapes.iter().find(|other| kind(other) != kind(first)) {
            let path = |tape: &Tape| -> PathBuf { tape.path().to_owned() };
            return Err(TapeError::Mixed {
                first: path(first),
                first_server: first.server(),
                other: path(other),
                other_server: other.server(),
            });
        }
        Ok(Self(tapes))
    }

    /// How many there are; at least one.
    #[expect(clippy::len_without_is_empty, reason = "there is always one")]
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// A recording by its place in the order.
    pub fn get(&self, index: usize) -> Option<&Tape> {
        self.0.get(index)
    }

    /// All recordings in their order.
    pub fn iter(&self) -> impl Iterator<Item = &Tape> {
        self.0.iter()
    }

    /// Whether Reel's simulator recorded them.
    pub fn is_simulated(&self) -> bool {
        self.0[0].is_simulated()
    }

    /// Which server answered in them.
    pub fn profile(&self) -> Profile {
        self.0[0].profile()
    }

    /// The recording that an id of a task means, from this one on and then from the first: the
    /// whole id, or its part after the family.
    pub(crate) fn find(&self, id: &str, from: usize) -> Option<usize> {
        let from = from.min(self.len());
        let order = || (from..self.len()).chain(0..from);
        let task = |index: usize| &self.0[index].trace.task;
        order()
            .find(|index| task(*index).task_id == id)
            .or_else(|| order().find(|index| task(*index).short_id() == id))
    }
}
