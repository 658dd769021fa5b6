//! One session between an agent and a server: which messages are recorded before they are passed
//! on, one call after another, and what happens when that is not possible.

use std::{
    collections::VecDeque,
    sync::{
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use reel_redact::{Redactor, Scope};
use reel_trace::Timing;
use reel_world::record::EndReason;
use serde_json::Value;

use crate::{
    OnFull, ProxyEvent, Setup,
    episode::{Episodes, Kind, RecordingError},
    pending::PendingCall,
    tap::{self, Call, FromAgent, ToolResultContent},
};

/// How long a call waits for the result of the one before it. A trace knows one call at a time.
const PATIENCE: Duration = Duration::from_secs(30);
/// Refused results that are known when a resumed stream brings them again; the oldest are forgotten.
const REFUSED_MAX: usize = 64;

/// One session between an agent and a server.
pub(crate) struct Session {
    setup: Arc<Setup>,
    name: String,
    inner: Mutex<Inner>,
    answered: Condvar,
    /// Whether results come on a stream of their own, and not as responses.
    has_stream: AtomicBool,
    /// Whether everything that the agent says comes one after the other, so that nobody can ask for a task while the
    /// next call waits.
    one_way_in: AtomicBool,
}

struct Inner {
    episodes: Episodes,
    open: Option<PendingCall>,
    /// Calls whose results could not be recorded, and why.
    refused: VecDeque<RejectedRequest>,
    redactor: Redactor,
    /// The request for the tools that is not answered.
    lists_tools: Option<Value>,
    /// When the agent got the last result, or the session began.
    agent_has_it: Instant,
    last_seen: Instant,
}

/// A request that is not passed on: an error for whoever sent it.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct RejectedRequest {
    id: Value,
    why: String,
}

impl RejectedRequest {
    /// In the protocol; none where it may not be so long.
    pub(crate) fn json(&self, most: Option<usize>) -> Option<String> {
        tap::refusal(&self.id, &self.why, most)
    }
}

impl Session {
    pub(crate) fn new(setup: Arc<Setup>, number: u32) -> Arc<Self> {
        let (name, now) = (format!("s{number:04}"), Instant::now());
        let episodes = Episodes::new(setup.clone(), name.clone());
        let inner = Inner {
            episodes,
            open: None,
            refused: VecDeque::new(),
            redactor: Redactor::new(setup.rules.clone()),
            lists_tools: None,
            agent_has_it: now,
            last_seen: now,
        };
        Arc::new(Self {
            setup,
            name,
            inner: Mutex::new(inner),
            answered: Condvar::new(),
            has_stream: AtomicBool::new(false),
            one_way_in: AtomicBool::new(false),
        })
    }

    /// Notes that results come on a stream of their own.
    pub(crate) fn set_stream(&self) {
        self.has_stream.store(true, Ordering::Release);
    }

    pub(crate) fn has_stream(&self) -> bool {
        self.has_stream.load(Ordering::Acquire)
    }

    /// Notes that everything that the agent says comes one after the other.
    pub(crate) fn set_one_way_in(&self) {
        self.one_way_in.store(true, Ordering::Release);
    }

    /// Makes values of headers secrets of this session: nothing that repeats them writes them.
    pub(crate) fn learn(&self, secrets: &[(&str, &str)]) {
        if secrets.is_empty() {
            return;
        }
        let mut inner = self.lock();
        for (name, secret) in secrets {
            inner.redactor.learn(name, secret);
        }
    }

    /// Notes what the agent calls itself.
    pub(crate) fn set_client(&self, name: &str) {
        let inner = &mut *self.lock();
        let name = inner.redactor.text(name);
        inner
            .episodes
            .set_policy(&name, inner.redactor.take_redactions());
    }

    /// Takes a message of the agent before it is passed on; gives the id of the call in it whose
    /// result is awaited now. A refusal instead: nothing may be passed on.
    pub(crate) fn agent_says(&self, message: &[u8]) -> Result<Option<Value>, RejectedRequest> {
        let came = Instant::now();
        self.lock().last_seen = came;
        let mut calls = match tap::from_agent(message) {
            FromAgent::Strange => {
                self.setup.report.count(|counts| counts.strange += 1);
                return Ok(None);
            }
            FromAgent::Other => return Ok(None),
            FromAgent::Hello(name) => {
                if let Some(name) = name {
                    self.set_client(&name);
                }
                return Ok(None);
            }
            FromAgent::ListsTools(id) => {
                self.lock().lists_tools = Some(id);
                return Ok(None);
            }
            FromAgent::Cancelled(id) => {
                let mut inner = self.lock();
                if inner.open.as_ref().is_some_and(|open| open.id == id) {
                    self.give_up(&mut inner, "the agent took the call back");
                }
                return Ok(None);
            }
            FromAgent::AsksForTask {
                id,
                method,
                task_id,
            } => {
                if let Some(open) = &mut self.lock().open {
                    open.ask(id, method, &task_id);
                }
                return Ok(None);
            }
            FromAgent::Calls(calls) => calls,
        };
        let arguments = calls.iter().map(|call| &call.call.arguments);
        let rounded = arguments.map(|arguments| tap::rounded_integers(arguments, message));
        self.count_rounded(rounded.max().unwrap_or_default());
        match calls.pop() {
            Some(call) if calls.is_empty() => self.agent_calls(call, came),
            _ => self.several_calls(&calls),
        }
    }

    /// Takes a call before it is passed on.
    fn agent_calls(&self, mut call: Call, came: Instant) -> Result<Option<Value>, RejectedRequest> {
        let mut inner = self.lock();
        let redacted = call.redact(&mut inner.redactor);
        if let Some(open) = inner
            .open
            .as_mut()
            .filter(|open| open.is_repeated_by(&call))
        {
            open.repeat(call.id.clone());
            return Ok(Some(call.id));
        }
        let mut inner = self.wait_for_turn(inner);
        let thought_ns = u64::try_from(
            came.saturating_duration_since(inner.agent_has_it)
                .as_nanos(),
        )
        .unwrap_or(u64::MAX);
        match inner
            .episodes
            .called(&call.call, Some(thought_ns), redacted)
        {
            Ok(kind) => {
                self.setup.report.count(|counts| match kind {
                    Kind::Step => counts.calls += 1,
                    Kind::Session => counts.session_calls += 1,
                });
                let id = call.id.clone();
                // An id that is used again is that of this call.
                inner.refused.retain(|refused| refused.id != id);
                inner.open = Some(PendingCall::new(call, kind, unix_ns()));
                Ok(Some(id))
            }
            Err(trouble) => self
                .unrecorded(&mut inner, call.id, &call.call.name, &trouble)
                .map(|()| None),
        }
    }

    fn several_calls(&self, calls: &[Call]) -> Result<Option<Value>, RejectedRequest> {
        let mut inner = self.wait_for_turn(self.lock());
        let id = calls
            .first()
            .map(|call| call.id.clone())
            .unwrap_or_default();
        let trouble = RecordingError(
            "a batch of several calls cannot be recorded one by one; send them one at a time"
                .to_owned(),
        );
        self.unrecorded(&mut inner, id, "several calls at once", &trouble)
            .map(|()| None)
    }

    /// Takes a message of the server before it is passed on. An error instead: it has to be passed
    /// on in its place.
    pub(crate) fn server_says(&self, message: &[u8]) -> Result<(), RejectedRequest> {
        let came = Instant::now();
        let mut guard = self.lock();
        let inner = &mut *guard;
        inner.last_seen = came;
        if let Some(id) = &inner.lists_tools
            && let Some(tools) = tap::answer_to(id, message)
        {
            inner.lists_tools = None;
            let tools = tools.json(&mut inner.redactor, Scope::Schema);
            inner
                .episodes
                .set_tools(tools, inner.redactor.take_redactions());
            return Ok(());
        }
        // A stream that is resumed may bring it again.
        let again = |refused: &&RejectedRequest| tap::answer_to(&refused.id, message).is_some();
        if let Some(refused) = inner.refused.iter().find(again) {
            return Err(refused.clone());
        }
        let Some(answer) = inner
            .open
            .as_mut()
            .and_then(|open| open.answered_by(message))
        else {
            return Ok(());
        };
        let (tap::Answer::Result(value) | tap::Answer::Error(value)) = &answer;
        self.count_rounded(tap::rounded_integers(value, message));
        let answer = answer.content(&mut inner.redactor);
        self.close(inner, answer, came)
    }

    fn count_rounded(&self, integers: u64) {
        if integers > 0 {
            let report = &self.setup.report;
            report.count(|counts| counts.rounded_integers += integers);
        }
    }

    /// Notes that the result of a call will not come the way it should have, if it has not come; where the stream can be
    /// resumed it is soon to come on another.
    pub(crate) fn adrift(&self, call: &Value, resumable: bool) {
        let mut inner = self.lock();
        if let Some(open) = inner.open.as_mut().filter(|open| open.id == *call) {
            open.lose_response(resumable);
            self.answered.notify_all();
        }
    }

    /// Notes that a call (none: whichever is open) failed on its way, or that its
    /// result cannot be read.
    pub(crate) fn unanswered(&self, call: Option<&Value>, why: &str) {
        let mut inner = self.lock();
        if inner
            .open
            .as_ref()
            .is_some_and(|open| call.is_none_or(|call| open.id == *call))
        {
            self.give_up(&mut inner, why);
        }
    }

    /// Counts what was too large to be looked into.
    pub(crate) fn too_large(&self, what: &str) {
        self.setup.report.count(|counts| counts.too_large += 1);
        let why = format!(
            "{what} is larger than {} bytes, and passes unrecorded",
            self.setup.message_max
        );
        self.setup.emit(ProxyEvent::RecordingFailed {
            session: &self.name,
            problem: &why,
        });
    }

    /// Ends the episode that runs.
    pub(crate) fn end(&self, why: &str) {
        let mut inner = self.lock();
        self.give_up(&mut inner, why);
        inner.episodes.end(EndReason::Aborted);
    }

    /// For how long nothing came, where nothing is awaited.
    pub(crate) fn idle(&self) -> Option<Duration> {
        let inner = self.inner.try_lock().ok()?;
        let open = inner.open.as_ref();
        open.is_none_or(PendingCall::may_be_abandoned)
            .then(|| inner.last_seen.elapsed())
    }

    fn wait_for_turn<'a>(&self, mut inner: MutexGuard<'a, Inner>) -> MutexGuard<'a, Inner> {
        let until = Instant::now() + PATIENCE;
        let one_way_in = self.one_way_in.load(Ordering::Acquire);
        while inner
            .open
            .as_ref()
            .is_some_and(|open| open.holds_the_next(one_way_in))
        {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                break;
            }
            inner = self
                .answered
                .wait_timeout(inner, left)
                .unwrap_or_else(PoisonError::into_inner)
                .0;
        }
        self.give_up(&mut inner, "no result had come when the next call was made");
        inner
    }

    /// Closes the open call without a result.
    fn give_up(&self, inner: &mut Inner, why: &str) {
        if let Some(open) = &inner.open {
            self.setup.report.count(|counts| counts.unanswered += 1);
            let why = format!("no result: {}", open.why_unanswered(why));
            let mut content = ToolResultContent::none(&inner.redactor.text(&why));
            content.redacted = inner.redactor.take_redactions();
            // Nobody waits for it, so nobody can be refused.
            let _ = self.close(inner, content, Instant::now());
        }
    }

    fn close(
        &self,
        inner: &mut Inner,
        answer: ToolResultContent,
        came: Instant,
    ) -> Result<(), RejectedRequest> {
        let Some(open) = inner.open.take() else {
            return Ok(());
        };
        let took_ns = u64::try_from(came.saturating_duration_since(open.passed_on).as_nanos())
            .unwrap_or(u64::MAX);
        let timing = Timing {
            called_unix_ns: open.called_unix_ns,
            took_ns,
        };
        let recorded = inner.episodes.answered(&open.kind, answer, timing);
        inner.agent_has_it = Instant::now();
        self.answered.notify_all();
        match recorded {
            Ok(()) => Ok(()),
            Err(trouble) => {
                let outcome = self.unrecorded(inner, open.id, "a result", &trouble);
                if let Err(refused) = &outcome {
                    if inner.refused.len() == REFUSED_MAX {
                        inner.refused.pop_front();
                    }
                    inner.refused.push_back(refused.clone());
                }
                outcome
            }
        }
    }

    /// What the policy for write trouble says.
    fn unrecorded(
        &self,
        inner: &mut Inner,
        id: Value,
        what: &str,
        trouble: &RecordingError,
    ) -> Result<(), RejectedRequest> {
        let RecordingError(why) = trouble;
        let (outcome, then) = match self.setup.on_full {
            OnFull::Stop => (
                "is refused",
                Err(RejectedRequest {
                    id,
                    why: format!("reel record cannot record this, so it stops here: {why}"),
                }),
            ),
            OnFull::Continue => ("goes on UNRECORDED", Ok(())),
        };
        self.setup.report.count(|counts| match self.setup.on_full {
            OnFull::Stop => counts.refused += 1,
            OnFull::Continue => counts.unrecorded += 1,
        });
        inner.episodes.missed();
        self.setup.emit(ProxyEvent::RecordingFailed {
            session: &self.name,
            problem: &format!("{what} {outcome}: {why}"),
        });
        then
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn unix_ns() -> u64 {
    let now = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default();
    u64::try_from(now.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests;
