//! A session that answers from recordings: which one it plays, where it is in it, and what follows
//! where the agent left it. Speaks no protocol and reads no clock.

use std::{path::PathBuf, sync::Arc};

use reel_live::LiveError;
use reel_mcp::{Response, refuse, tool_result};
use reel_trace::AnsweredRequest;
use reel_world::{Lifecycle, Profile, Tool, ToolCall, record::StepInput};
use rmcp::model::{CallToolResult, ContentBlock};
use serde_json::json;

use crate::{
    Deviation, EpisodeReport, EpisodeStatus, Tape, TapeError, Tapes,
    answers::{Answer, Answers, Beginning},
    deviation,
    future::{LiveFuture, Player},
    tape::RecordedAnswer,
};

/// What all sessions of a server share.
#[derive(Clone, Debug)]
pub struct TapeSettings {
    /// Folder for the traces of what follows off tape.
    pub branches: PathBuf,
    /// Name of the policy in these traces; `None` if it is what the client calls itself.
    pub policy: Option<String>,
}

/// The key of `_meta` under which an answer says that it is not from the recording.
const OFF_TAPE: &str = "reel/replay";

/// A session that answers from recordings.
pub struct TapeSession {
    tapes: Arc<Tapes>,
    settings: Arc<TapeSettings>,
    name: String,
    policy: String,
    /// The place of the recording that comes next.
    next: usize,
    begun: u32,
    now: Phase,
    reports: Vec<EpisodeReport>,
}

/// A recording that is played.
struct Played {
    index: usize,
    beginning: Beginning,
    /// The steps of the recording in the order in which the agent takes them.
    order: Vec<usize>,
    /// How many recorded calls were made.
    position: usize,
    deviation: Option<Deviation>,
    reason: Option<String>,
}

/// How many of the recorded calls after the next are looked at for one that came early.
const CALLS_AHEAD: usize = 16;

impl Played {
    /// The recorded step whose call is next; after the last, how many there are.
    fn step(&self) -> usize {
        let step = self.order.get(self.position).copied();
        step.unwrap_or(self.position)
    }

    /// The place in the order of the recorded call that this one is, among those that may be next.
    fn place_of(&self, call: &ToolCall, tape: &Tape) -> Option<usize> {
        tape.made_at_once(self.position).find(|place| {
            let step = self.order.get(*place);
            step.is_some_and(|step| is_call_of(tape, *step, call))
        })
    }

    /// The step of another server, soon after the next one, whose call this one is.
    fn later_step(&self, call: &ToolCall, tape: &Tape) -> Option<u32> {
        if tape.is_simulated() {
            return None;
        }
        let later = self.order.iter().skip(self.position + 1);
        let mut later = later.take(CALLS_AHEAD).copied();
        let step = later.find(|step| is_call_of(tape, *step, call))?;
        u32::try_from(step).ok()
    }

    /// How a call, or the end of the agent, deviates from the recorded call that is next.
    fn deviation_of(&self, call: Option<&ToolCall>, tape: &Tape) -> Option<Deviation> {
        let step = u32::try_from(self.step()).unwrap_or(u32::MAX);
        deviation(step, tape.call(self.step()).as_ref(), call)
    }
}

/// Whether a step of a recording has this call.
fn is_call_of(tape: &Tape, step: usize, call: &ToolCall) -> bool {
    deviation(0, tape.call(step).as_ref(), Some(call)).is_none()
}

enum Phase {
    /// No recording was begun.
    Idle,
    OnTape(Played, Answers),
    /// The simulator goes on.
    Live(Played, Box<LiveFuture>),
    /// Nothing can be answered but what was expected.
    Lost(Played),
    /// All recordings were played.
    Completed(Played),
}

impl TapeSession {
    /// A session that begins with the first recording.
    pub fn new(tapes: Arc<Tapes>, settings: Arc<TapeSettings>, name: String) -> Self {
        Self {
            policy: settings
                .policy
                .clone()
                .unwrap_or_else(|| "client".to_owned()),
            tapes,
            settings,
            name,
            next: 0,
            begun: 0,
            now: Phase::Idle,
            reports: Vec::new(),
        }
    }

    /// Who plays, where the settings do not say it.
    pub fn set_policy(&mut self, name: &str) {
        if self.settings.policy.is_none() {
            name.clone_into(&mut self.policy);
        }
    }

    /// The recording that is played, or the one that comes next, or the first if all were played.
    pub fn tape(&self) -> &Tape {
        let index = self.played().map_or(self.next, |played| played.index);
        let tape = self.tapes.get(index).or_else(|| self.tapes.get(0));
        tape.expect("there is at least one recording")
    }

    /// How the recordings went that were played to their end.
    pub fn take_reports(&mut self) -> Vec<EpisodeReport> {
        std::mem::take(&mut self.reports)
    }

    /// Ends what is played, as where the agent goes away.
    pub fn end(&mut self) {
        let now = std::mem::replace(&mut self.now, Phase::Idle);
        if let Some(report) = self.report(now) {
            self.reports.push(report);
        }
    }

    /// Answers a call of a tool, recorded or not.
    pub(crate) fn call(&mut self, input: StepInput) -> Answer {
        if !self.tapes.is_simulated() && self.is_recorded(&input.call) {
            return self.step(input);
        }
        let profile = self.profile();
        let running = self.is_running();
        match profile.tool(&input.call).ok() {
            Some(Tool::Lifecycle(Lifecycle::ListTasks)) => {
                let ids = self
                    .tapes
                    .iter()
                    .map(|tape| tape.trace().task.task_id.clone());
                self.ours(&Response::Tasks(ids.collect()))
            }
            Some(Tool::Lifecycle(Lifecycle::ListReceptacles))
                if !profile.is_published() || !running =>
            {
                self.ours(&Response::Receptacles(self.tape().trace().scene.clone()))
            }
            Some(Tool::Lifecycle(Lifecycle::FinishWithId { task_id })) => {
                let from = self.next;
                match self.tapes.find(&task_id, from) {
                    Some(index) => self.begin(index, Some(task_id)),
                    None => self.refuse(&input.call, &LiveError::UnknownTask(task_id)),
                }
            }
            Some(Tool::Finish) if self.tapes.is_simulated() || !running => self.finish(input),
            _ => self.step(input),
        }
    }

    fn profile(&self) -> Profile {
        self.tape().profile()
    }

    fn played(&self) -> Option<&Played> {
        match &self.now {
            Phase::Idle => None,
            Phase::OnTape(played, _)
            | Phase::Live(played, _)
            | Phase::Lost(played)
            | Phase::Completed(played) => Some(played),
        }
    }

    /// Whether a call is one of another server's recording that may be next.
    fn is_recorded(&self, call: &ToolCall) -> bool {
        let tape = self.tape();
        match &self.now {
            Phase::OnTape(played, _) => played.place_of(call, tape).is_some(),
            Phase::Idle => tape
                .made_at_once(0)
                .any(|step| is_call_of(tape, step, call)),
            Phase::Live(..) | Phase::Lost(_) | Phase::Completed(_) => false,
        }
    }

    /// Whether the episode would take a call.
    fn is_running(&self) -> bool {
        match &self.now {
            Phase::Idle | Phase::Completed(_) => false,
            Phase::OnTape(played, _) => {
                played.position < self.tape().len() || self.tape().ended().is_none()
            }
            Phase::Live(_, future) => future.is_running(),
            Phase::Lost(_) => true,
        }
    }

    /// `finish`: the last call of an episode that runs, and the beginning of the next.
    fn finish(&mut self, input: StepInput) -> Answer {
        let last = self.is_running().then(|| self.step(input));
        let deviation = self.played().and_then(|played| played.deviation.clone());
        if let (Phase::Lost(_), Some(answer)) = (&self.now, last) {
            return answer;
        }
        let answer = if self.next < self.tapes.len() {
            self.begin(self.next, None)
        } else {
            self.complete()
        };
        match deviation {
            Some(deviation) => off_tape(answer, &deviation),
            None => answer,
        }
    }

    /// Says that all recordings were played.
    fn complete(&mut self) -> Answer {
        let now = std::mem::replace(&mut self.now, Phase::Idle);
        self.now = match now {
            // Its recording may still be left, by a call after its last one.
            Phase::OnTape(played, _) if played.deviation.is_none() => Phase::Completed(played),
            Phase::Completed(played) => Phase::Completed(played),
            now => {
                self.reports.extend(self.report(now));
                Phase::Idle
            }
        };
        self.ours(&Response::Completed)
    }

    /// Ends what is played and begins the recording at a place in the order.
    fn begin(&mut self, index: usize, requested: Option<String>) -> Answer {
        self.end();
        let beginning = Beginning {
            requested,
            index,
            of: self.tapes.len(),
            number: self.begun,
        };
        self.next = index + 1;
        self.begun += 1;
        let tape = &self.tapes.iter().nth(index).cloned();
        let Some(tape) = tape else {
            return self.ours(&Response::Completed);
        };
        let mut played = Played {
            index,
            beginning,
            order: (0..tape.len()).collect(),
            position: 0,
            deviation: None,
            reason: None,
        };
        match answers(tape, &played.beginning) {
            Ok(answers) => {
                let start = answers.start.clone();
                self.now = Phase::OnTape(played, answers);
                start
            }
            Err(error) => {
                let text = error.to_string();
                played.reason = Some(text.clone());
                self.now = Phase::Lost(played);
                Answer::Ours(Box::new(unanswerable(&text)))
            }
        }
    }

    /// Answers a call of an episode.
    fn step(&mut self, input: StepInput) -> Answer {
        if matches!(self.now, Phase::Idle) && !self.tapes.is_simulated() {
            // Servers without a tool around episodes: the first call begins the only one.
            if let refused @ Answer::Ours(_) = self.begin(self.next, None) {
                return refused;
            }
        }
        match std::mem::replace(&mut self.now, Phase::Idle) {
            Phase::Idle => self.refuse(&input.call, &LiveError::NoEpisode),
            Phase::Completed(mut played) => {
                self.leave(&mut played, &input.call);
                self.now = Phase::Completed(played);
                self.refused_off_tape(&input.call, &LiveError::NoEpisode)
            }
            Phase::OnTape(played, answers) => self.step_on_tape(played, answers, input),
            Phase::Live(played, mut future) => {
                let made = future.call(input.clone());
                self.now = Phase::Live(played, future);
                self.live_answer(&input.call, made)
            }
            Phase::Lost(played) => {
                let answer = lost(&played, &input.call);
                self.now = Phase::Lost(played);
                answer
            }
        }
    }

    fn step_on_tape(&mut self, mut played: Played, answers: Answers, input: StepInput) -> Answer {
        let call = &input.call;
        self.leave(&mut played, call);
        if played.deviation.is_none() {
            let answer = answers.steps.get(played.step()).cloned();
            played.position += 1;
            let is_last = played.position == answers.steps.len();
            self.now = Phase::OnTape(played, answers);
            if let Some(Answer::Recorded(recorded)) = answer.as_ref().filter(|_| is_last) {
                self.go_on_after(&recorded.clone());
            }
            return answer.unwrap_or_else(|| self.refuse(&input.call, &LiveError::NoEpisode));
        }
        let Some(tape) = self.tapes.get(played.index) else {
            return self.refuse(call, &LiveError::NoEpisode);
        };
        if let (true, Some(reason)) = (played.position >= tape.len(), tape.ended()) {
            let simulated = tape.is_simulated();
            self.now = if simulated {
                Phase::OnTape(played, answers)
            } else {
                Phase::Lost(played)
            };
            if simulated {
                return self.refused_off_tape(call, &LiveError::Over(reason));
            }
            return self.step(input);
        }
        let player = Player {
            settings: &self.settings,
            session: &self.name,
            policy: &self.policy,
        };
        let opened = match tape.is_simulated() {
            true => LiveFuture::open(tape, played.position, &player),
            false => Err("its server is not here".to_owned()),
        };
        match opened {
            Ok(future) => self.now = Phase::Live(played, Box::new(future)),
            Err(why) => {
                played.reason = Some(why);
                self.now = Phase::Lost(played);
            }
        }
        self.step(input)
    }

    /// Begins the next recording where the last answer of another server began it: one that tells the
    /// next task.
    fn go_on_after(&mut self, last: &RecordedAnswer) {
        let next = self.tapes.get(self.next);
        let start = next.and_then(|tape| tape.recorded(AnsweredRequest::Start));
        if start.as_ref() == Some(last) {
            self.begin(self.next, None);
        }
    }

    /// Notes the first deviation.
    fn leave(&self, played: &mut Played, call: &ToolCall) {
        let Some(tape) = self.tapes.get(played.index) else {
            return;
        };
        if played.deviation.is_some() {
            return;
        }
        if let Some(place) = played.place_of(call, tape) {
            played.order[played.position..=place].rotate_right(1);
            return;
        }
        played.deviation = played.deviation_of(Some(call), tape).map(|left| Deviation {
            recorded_as: played.later_step(call, tape),
            ..left
        });
    }

    fn live_answer(
        &self,
        call: &ToolCall,
        made: Result<reel_live::CallResult, LiveError>,
    ) -> Answer {
        let answer = match made {
            Ok(made) => self.ours(&Response::CallMade(Box::new(made))),
            Err(error) => self.refuse(call, &error),
        };
        self.marked(answer)
    }

    fn refused_off_tape(&self, call: &ToolCall, error: &LiveError) -> Answer {
        self.marked(self.refuse(call, error))
    }

    /// An answer that says where the agent left the recording, if it did.
    fn marked(&self, answer: Answer) -> Answer {
        match self.played().and_then(|played| played.deviation.as_ref()) {
            Some(deviation) => off_tape(answer, deviation),
            None => answer,
        }
    }

    fn ours(&self, response: &Response) -> Answer {
        Answer::Ours(Box::new(tool_result(self.profile(), response)))
    }

    fn refuse(&self, call: &ToolCall, error: &LiveError) -> Answer {
        Answer::Ours(Box::new(refuse(self.profile(), &call.name, error)))
    }

    /// How a recording went that is not played any more.
    fn report(&self, now: Phase) -> Option<EpisodeReport> {
        let (mut played, future) = match now {
            Phase::Idle => return None,
            Phase::OnTape(played, _) | Phase::Lost(played) | Phase::Completed(played) => {
                (played, None)
            }
            Phase::Live(played, future) => (played, Some(future)),
        };
        let tape = self.tapes.get(played.index)?;
        let is_refused = played.reason.is_some() && played.deviation.is_none();
        if played.deviation.is_none() && played.position > 0 {
            played.deviation = played.deviation_of(None, tape);
        }
        let trace = tape.trace();
        let end = trace.end.as_ref();
        let recorded = end.and_then(|end| end.success(&trace.task));
        let (branch, success) = match future.map(|future| future.end()) {
            None if played.deviation.is_none() && !is_refused => (None, recorded),
            None => (None, None),
            Some(Ok((ended, branch))) => {
                let judged = ended.filter(|_| trace.task.has_goal());
                (branch, judged.map(|ended| ended.success))
            }
            Some(Err(error)) => {
                played.reason = Some(error.to_string());
                (None, None)
            }
        };
        let status = match &played {
            _ if is_refused => EpisodeStatus::Refused,
            Played {
                deviation: Some(_), ..
            } => EpisodeStatus::Deviated,
            Played { position: 0, .. } if !tape.is_empty() => EpisodeStatus::Unplayed,
            _ => EpisodeStatus::OnTape,
        };
        let count = |number: usize| u32::try_from(number).unwrap_or(u32::MAX);
        Some(EpisodeReport {
            session: self.name.clone(),
            trace: tape.path().to_owned(),
            task_id: tape.trace().task.task_id.clone(),
            status,
            calls_on_tape: count(played.position),
            calls_recorded: count(tape.len()),
            deviation: played.deviation,
            branch,
            success,
            reason: played.reason,
        })
    }
}

impl Drop for TapeSession {
    fn drop(&mut self) {
        // What runs in the simulator becomes a whole trace.
        self.end();
    }
}

fn answers(tape: &Tape, beginning: &Beginning) -> Result<Answers, TapeError> {
    Answers::of(tape, beginning)
}

/// An answer of the simulator that says in its `_meta` where the agent left the recording.
fn off_tape(answer: Answer, deviation: &Deviation) -> Answer {
    match answer {
        Answer::Ours(mut result) => {
            let mut meta = result.meta.take().unwrap_or_default();
            let said = json!({"on_tape": false, "deviation": deviation});
            meta.insert(OFF_TAPE.to_owned(), said);
            result.meta = Some(meta);
            Answer::Ours(result)
        }
        recorded @ Answer::Recorded(_) => recorded,
    }
}

/// What is answered where nothing was recorded and nothing can go on: what was expected, and what
/// came instead.
fn lost(played: &Played, call: &ToolCall) -> Answer {
    let Some(deviation) = &played.deviation else {
        let why = played.reason.as_deref().unwrap_or("it was not begun");
        return Answer::Ours(Box::new(unanswerable(why)));
    };
    let why = played.reason.as_deref().unwrap_or("nothing was recorded");
    let text = format!(
        "The agent left the recording at {deviation}. No answer to {call} is known: {why}."
    );
    let mut result = CallToolResult::error(vec![ContentBlock::text(text)]);
    result.structured_content = Some(json!({
        "step": deviation.step,
        "expected": deviation.expected,
        "actual": deviation.actual,
        "difference": deviation.differences,
        "call": call,
    }));
    off_tape(Answer::Ours(Box::new(result)), deviation)
}

/// Says that a recording cannot be answered from.
fn unanswerable(why: &str) -> CallToolResult {
    let mut result = CallToolResult::error(vec![ContentBlock::text(why)]);
    let error = json!({"code": "not_replayable"});
    result.structured_content = Some(json!({"ok": false, "text": why, "error": error}));
    result
}
