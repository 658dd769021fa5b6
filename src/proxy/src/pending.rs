//! The call of a session whose result is to come: as the response, on another stream, or later as the result of a
//! task. Says which messages belong to it; passes and records nothing.

use std::{collections::VecDeque, time::Instant};

use reel_world::ToolCall;
use serde_json::Value;

use crate::{
    episode::Kind,
    tap::{self, Call, TaskMethod},
};

/// Requests about a task that are awaited at a time; the oldest are forgotten.
const ASKED_MAX: usize = 256;

/// A call that was passed on and has no result.
pub(crate) struct PendingCall {
    pub id: Value,
    pub kind: Kind,
    pub called_unix_ns: u64,
    pub passed_on: Instant,
    /// Whether whatever would have brought the result is gone; it may still come otherwise.
    adrift: bool,
    /// Whether the stream that is gone may be resumed.
    resumable: bool,
    /// As it is recorded.
    call: ToolCall,
    awaits: Awaited,
}

/// What a call waits for.
enum Awaited {
    /// The result, as the response to the request.
    Result,
    /// The agent's answers to what the server asks; then it makes the call again with them.
    Input,
    /// The result of a task.
    Task(PendingTask),
}

/// A task in whose name the result comes.
struct PendingTask {
    task_id: String,
    /// What the agent asked about it, by the id of the request.
    asked: VecDeque<(Value, TaskMethod)>,
    /// How it ended, where its result was not seen.
    ended: Option<String>,
}

impl PendingCall {
    pub(crate) fn new(call: Call, kind: Kind, called_unix_ns: u64) -> Self {
        Self {
            id: call.id,
            kind,
            called_unix_ns,
            passed_on: Instant::now(),
            adrift: false,
            resumable: false,
            call: call.call,
            awaits: Awaited::Result,
        }
    }

    /// Whether a message is this call again: the agent sends it a second time because the connection broke, or with the
    /// input that the server asked for.
    pub(crate) fn is_repeated_by(&self, call: &Call) -> bool {
        match self.awaits {
            Awaited::Result | Awaited::Task(_) => call.id == self.id && call.call == self.call,
            Awaited::Input => call.has_input && call.call.name == self.call.name,
        }
    }

    /// Goes on with the message that repeats the call.
    pub(crate) fn repeat(&mut self, id: Value) {
        self.id = id;
        (self.adrift, self.resumable) = (false, false);
        self.awaits = Awaited::Result;
    }

    /// Whether the next call waits for the result of this one. `one_way_in` is a transport on which what the agent has to
    /// say about a task stands behind its next call.
    pub(crate) fn holds_the_next(&self, one_way_in: bool) -> bool {
        match &self.awaits {
            Awaited::Result => !self.adrift || self.resumable,
            Awaited::Input => false,
            Awaited::Task(task) => task.ended.is_none() && !one_way_in,
        }
    }

    /// Whether its result may be a long time in coming, so that a silent session is over all the same.
    pub(crate) fn may_be_abandoned(&self) -> bool {
        self.adrift || !matches!(self.awaits, Awaited::Result)
    }

    /// Notes that the response will not bring the result.
    pub(crate) fn lose_response(&mut self, resumable: bool) {
        self.resumable = resumable;
        // A task, or a further round, was told of in the response.
        self.adrift = matches!(self.awaits, Awaited::Result);
    }

    /// Notes what the agent asks about a task.
    pub(crate) fn ask(&mut self, id: Value, method: TaskMethod, about: &str) {
        if let Awaited::Task(task) = &mut self.awaits
            && task.task_id == about
        {
            if task.asked.len() == ASKED_MAX {
                task.asked.pop_front();
            }
            task.asked.push_back((id, method));
        }
    }

    /// What a message of the server says of this call: its result or error, as a value that is not redacted. `None` if
    /// it says nothing of it, or that it is still to come, which is noted.
    pub(crate) fn answered_by(&mut self, message: &[u8]) -> Option<tap::Answer> {
        let message = tap::from_server(message)?;
        if let Awaited::Task(task) = &mut self.awaits {
            return message.into_iter().find_map(|message| task.heard(message));
        }
        let answer = message
            .into_iter()
            .find_map(|message| message.answer_to(&self.id))?;
        if let Some(task_id) = answer.task() {
            self.awaits = Awaited::Task(PendingTask {
                task_id,
                asked: VecDeque::new(),
                ended: None,
            });
            return None;
        }
        if answer.asks_for_input() {
            self.awaits = Awaited::Input;
            return None;
        }
        Some(answer)
    }

    /// Why it has no result, in more words than `why`.
    pub(crate) fn why_unanswered(&self, why: &str) -> String {
        match &self.awaits {
            Awaited::Result => why.to_owned(),
            Awaited::Input => format!("{why}; the server had asked for input"),
            Awaited::Task(task) => match &task.ended {
                Some(ended) => format!("{why}; its task {ended}"),
                None => format!("{why}; its task was not finished"),
            },
        }
    }
}

impl PendingTask {
    fn heard(&mut self, message: tap::ServerMessage) -> Option<tap::Answer> {
        let told = match message.task_notification(&self.task_id) {
            Some(told) => told,
            None => {
                let place = self
                    .asked
                    .iter()
                    .position(|(id, _)| message.is_answer_to(id))?;
                let (id, method) = self.asked.remove(place)?;
                let answer = message.answer_to(&id)?;
                if method == TaskMethod::Result {
                    return Some(answer);
                }
                answer.result()?
            }
        };
        match tap::task_status(told)? {
            tap::TaskStatus::Final(answer) => return Some(answer),
            tap::TaskStatus::Ended(how) => self.ended = Some(how),
        }
        None
    }
}
