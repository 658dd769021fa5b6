//! What was answered in a recording: taken from its records where they hold all of it, else made
//! again by executing it, with every digest compared.

use reel_episode::Briefing;
use reel_live::{CallResult, PrivilegedState, StartedEpisode};
use reel_mcp::{Response, image, tool_result};
use reel_replay::{Detail, Replay, Verdict};
use reel_trace::{AnsweredRequest, Trace};
use reel_world::{
    Frame,
    record::{EndReason, StepRecord},
};
use rmcp::model::CallToolResult;
use serde_json::{Value, json};

use crate::{Tape, TapeError, tape::RecordedAnswer};

/// The answer to a call.
#[derive(Clone, Debug)]
pub(crate) enum Answer {
    /// What Reel's own server says.
    Ours(Box<CallToolResult>),
    /// The answer of another server, as it came.
    Recorded(RecordedAnswer),
}

/// How an episode begins in a session.
#[derive(Clone, Debug, Default)]
pub(crate) struct Beginning {
    /// The id by which its task was asked for, if it was.
    pub requested: Option<String>,
    /// The place of the recording in the order.
    pub index: usize,
    /// How many recordings there are.
    pub of: usize,
    /// How many episodes were begun in the session before.
    pub number: u32,
}

/// The answers of a recording.
#[derive(Clone, Debug)]
pub(crate) struct Answers {
    pub start: Answer,
    pub steps: Vec<Answer>,
}

impl Answers {
    /// The answers of a recording.
    ///
    /// # Errors
    /// When the recording does not hold them, and does not replay.
    pub fn of(tape: &Tape, beginning: &Beginning) -> Result<Self, TapeError> {
        let trace = tape.trace();
        if !tape.is_simulated() {
            return of_other_server(tape);
        }
        let from_records = !tape.profile().is_published() && holds_images(trace);
        if from_records {
            return from_record(trace, beginning);
        }
        by_replay(trace, beginning).map_err(|verdict| TapeError::NotExact {
            path: tape.path().to_owned(),
            verdict: Box::new(verdict),
        })
    }
}

/// The answers of another server: as they came where the recording keeps them, else a result with the
/// recorded text and image.
fn of_other_server(tape: &Tape) -> Result<Answers, TapeError> {
    let trace = tape.trace();
    let answer =
        |request: AnsweredRequest, text: &str, failed: bool| -> Result<Answer, TapeError> {
            if let Some(recorded) = tape.recorded(request) {
                return Ok(Answer::Recorded(recorded));
            }
            let step = match request {
                AnsweredRequest::Step(step) => Some(step),
                AnsweredRequest::Start | AnsweredRequest::ToolList => None,
            };
            let frame = trace.frame_rgb(step)?.map(Frame::of_rgb);
            let text = Some(text).filter(|text| !text.is_empty());
            let text = text.map(|text| json!({"type": "text", "text": text}));
            let image = frame.map(|frame| json!(image(&frame)));
            let content: Vec<Value> = text.into_iter().chain(image).collect();
            let result = json!({"content": content, "isError": failed});
            Ok(Answer::Recorded(RecordedAnswer::Result(result)))
        };
    let begun = answer(AnsweredRequest::Start, &trace.task.instruction, false)?;
    let steps = trace.steps.iter().map(|step| {
        let (text, failed) = (&step.outcome.text, !step.outcome.is_ok());
        answer(AnsweredRequest::Step(step.step), text, failed)
    });
    Ok(Answers {
        start: begun,
        steps: steps.collect::<Result<_, _>>()?,
    })
}

/// Whether the trace holds every image that the agent got.
fn holds_images(trace: &Trace) -> bool {
    let has = |step: Option<u32>| trace.image(step).is_some();
    let shown = |step: &&StepRecord| step.digests.frame.is_some();
    has(None)
        && trace
            .steps
            .iter()
            .filter(shown)
            .all(|step| has(Some(step.step)))
}

/// The answers as the records hold them: all that profile `paper` shows.
fn from_record(trace: &Trace, beginning: &Beginning) -> Result<Answers, TapeError> {
    let frame = |step: Option<u32>| -> Result<Option<Frame>, TapeError> {
        Ok(trace.frame_rgb(step)?.map(Frame::of_rgb))
    };
    let state = |step: Option<&StepRecord>| PrivilegedState {
        graphs: trace.start.graphs.clone(),
        objects_by_receptacle: Vec::new(),
        markers: step.map(|step| step.markers.clone()),
        held: step.and_then(|step| step.held.clone()),
        landmark: None,
        robot: trace.start.robot,
    };
    let first = frame(None)?.unwrap_or_else(Frame::new);
    let start = started(trace, beginning, first, state(None));
    let ended = trace.end.as_ref().map(|end| end.reason);
    let last = trace.steps.len();
    let steps = trace.steps.iter().enumerate().map(|(index, step)| {
        let ended = ended.filter(|_| index + 1 == last);
        let made = CallResult {
            step: step.clone(),
            frame: frame(Some(step.step))?,
            head_frame: None,
            view: state(Some(step)),
            ended: ended.filter(|reason| *reason != EndReason::Aborted),
        };
        Ok(said(trace, &Response::CallMade(Box::new(made))))
    });
    let steps = steps.collect::<Result<Vec<_>, TapeError>>()?;
    Ok(Answers { start, steps })
}

/// The answers as the simulator makes them again.
fn by_replay(trace: &Trace, beginning: &Beginning) -> Result<Answers, Verdict> {
    let (mut replay, frame) = Replay::start(trace, Detail::Full)?;
    let state = PrivilegedState::of(replay.episode());
    let start = started(trace, beginning, frame, state);
    let published = trace.header.profile.is_published();
    let mut steps = Vec::with_capacity(trace.steps.len());
    while let Some(output) = replay.step()? {
        let episode = replay.episode();
        let shows_all = output.frame.is_none() && published;
        let made = CallResult {
            head_frame: shows_all.then(|| episode.render_frame()),
            view: PrivilegedState::of(episode),
            ended: episode.ended(),
            step: output.record,
            frame: output.frame,
        };
        steps.push(said(trace, &Response::CallMade(Box::new(made))));
    }
    replay.finish(|_, _| {})?;
    Ok(Answers { start, steps })
}

fn started(trace: &Trace, beginning: &Beginning, frame: Frame, view: PrivilegedState) -> Answer {
    let begun = StartedEpisode {
        task: trace.task.clone(),
        briefing: Briefing::new(&trace.task, &trace.scene),
        requested: beginning.requested.clone(),
        index: beginning.index,
        of: beginning.of,
        number: beginning.number,
        frame,
        view,
        taken_over: None,
    };
    said(
        trace,
        &Response::EpisodeStarted(Box::new(begun), trace.scene.clone()),
    )
}

fn said(trace: &Trace, response: &Response) -> Answer {
    Answer::Ours(Box::new(tool_result(trace.header.profile, response)))
}
