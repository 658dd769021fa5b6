//! The turns of a trajectory as calls with what came of them.

use std::{
    io,
    path::{Path, PathBuf},
};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use reel_trace::decode_webp;
use reel_world::{
    ErrorCode, FRAME_HEIGHT, FRAME_WIDTH, Frame, Outcome, SPOKEN_TURN, Tool, ToolCall,
    record::{PolicyOutput, StateDigests, StepInput, StepRecord},
};
use serde_json::json;

use super::{
    CallResult, Content, OURS, Part, Source, Step,
    reading::{Episode, read_file},
};
use crate::{
    image,
    observe::{self, CallObservation, ObservedState},
    outcome,
};

/// Most characters of the name of an image in a message; its data may stand in its place.
const NAME_CHARACTERS: usize = 80;
/// Largest image that is read.
const IMAGE_BYTES_MAX: u64 = 64 << 20;

/// A call of a trajectory with what came of it.
pub(super) struct Decision {
    pub(super) input: StepInput,
    pub(super) result: Outcome,
    pub(super) frame: Option<Frame>,
    pub(super) kept: Option<StepRecord>,
}

/// What a trajectory tells before the first turn of the agent.
#[derive(Default)]
pub(super) struct Opening {
    pub(super) system: String,
    pub(super) instruction: String,
    pub(super) frame: Option<Frame>,
}

impl Episode<'_> {
    /// The turns as calls, and what was told before the first.
    pub(super) fn read(&mut self, turns: Vec<Step>) -> (Opening, Vec<Decision>) {
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
            let (mut text, mut frame) = self.content(turn.message, &place);
            for result in turn.observation.into_iter().flat_map(|seen| seen.results) {
                let (more, image) = self.result(result, &place);
                join(&mut text, &more);
                self.replace(&mut frame, image, &place);
            }
            match (decisions.last_mut(), turn.source) {
                (None, Source::System) => {
                    join(&mut opening.system, &text);
                    self.no_image(frame, &place);
                }
                (None, _) => {
                    join(&mut opening.instruction, &text);
                    self.replace(&mut opening.frame, frame, &place);
                }
                (Some(last), _) => {
                    join(&mut last.result.text, &text);
                    self.replace(&mut last.frame, frame, &place);
                }
            }
        }
        (opening, decisions)
    }

    /// A turn of the agent: one decision for each call, the first of which has what was said.
    fn decide(&mut self, mut turn: Step, place: &str, decisions: &mut Vec<Decision>) {
        let kept = turn.extra.remove(OURS);
        let kept = self.kept::<StepRecord>(kept, &format!("{place}: extra"));
        let (raw, frame) = self.content(turn.message, place);
        self.no_image(frame, place);
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
            decisions.push(Decision::new(ToolCall::new(SPOKEN_TURN, json!({}))));
        }
        let mut is_answered = vec![false; ids.len()];
        for result in turn.observation.into_iter().flat_map(|seen| seen.results) {
            let of = result.source_call_id.clone();
            // Calls with the same id have their results in turn.
            let number = of.as_ref().and_then(|id| {
                let mut named = (0..ids.len()).filter(|number| ids[*number] == *id);
                let first = named.next()?;
                let next = [first]
                    .into_iter()
                    .chain(named)
                    .find(|number| !is_answered[*number]);
                Some(next.unwrap_or(first))
            });
            number.inspect(|number| is_answered[*number] = true);
            if let (Some(id), None) = (&of, number) {
                let id = id.escape_debug();
                self.notes.push(format!("{place}: a result names call {id}, which is none of this turn; it goes to the last one"));
            }
            let number = number.map_or(decisions.len() - 1, |number| first + number);
            let (text, frame) = self.result(result, place);
            let decision = &mut decisions[number];
            join(&mut decision.result.text, &text);
            self.replace(&mut decision.frame, frame, place);
        }
        for (number, decision) in decisions[first..].iter_mut().enumerate() {
            let text = &decision.result.text;
            let ours = Tool::parse(&decision.input.call).is_ok();
            let failed = (ids.get(number)).is_some_and(|id| self.facts.failed_calls.contains(id));
            decision.result.error = ErrorCode::from_message(text)
                .filter(|_| ours)
                .or(failed.then_some(ErrorCode::BackendError));
        }
        let spoke = policy != PolicyOutput::default();
        decisions[first].input.policy = spoke.then_some(policy);
        // A document of ours has one call a turn.
        decisions[first].kept = kept.filter(|_| decisions.len() == first + 1);
    }

    /// Keeps the last of several images.
    fn replace(&mut self, frame: &mut Option<Frame>, next: Option<Frame>, place: &str) {
        if next.is_some() {
            self.no_image(frame.take(), place);
            *frame = next;
        }
    }

    /// Names an image for which a trace has no place.
    fn no_image(&mut self, frame: Option<Frame>, place: &str) {
        if frame.is_some() {
            self.lose(format!(
                "{place}: an image is left out: a trace has one after each call"
            ));
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
                    Ok(image) => self.replace(&mut frame, Some(image), place),
                    Err(why) => {
                        let name: String =
                            source.path.escape_debug().take(NAME_CHARACTERS).collect();
                        self.lose(format!("{place}: image {name} is left out: {why}"));
                    }
                },
                Part::Audio { source } => {
                    self.lose(format!(
                        "{place}: sound {} is left out",
                        source.path.escape_debug()
                    ));
                }
            }
        }
        (texts, frame)
    }

    /// The file of this path in the folder of the document. A document names no other files: whoever imports what a
    /// stranger sent would find pictures of this machine in traces and exports.
    fn beside(&self, path: &str) -> Result<PathBuf, String> {
        let told = |error: io::Error| error.to_string();
        let folder = self.source.parent().unwrap_or(Path::new(""));
        let file = folder.join(path).canonicalize().map_err(told)?;
        let folder = Path::new(".").join(folder).canonicalize().map_err(told)?;
        if !file.starts_with(folder) {
            return Err("it lies outside of the document's folder".to_owned());
        }
        Ok(file)
    }

    /// An image within the document or beside it; addresses are not asked.
    fn image(&self, path: &str) -> Result<Frame, String> {
        let bytes = if let Some(data) = path.strip_prefix("data:") {
            let (_, data) = data
                .split_once(";base64,")
                .ok_or("its data is not in base64")?;
            STANDARD
                .decode(data)
                .map_err(|error| format!("its data is not in base64: {error}"))?
        } else if path.contains("://") {
            return Err("it lies elsewhere; download it and name the file".to_owned());
        } else {
            read_file(&self.beside(path)?, IMAGE_BYTES_MAX)?
        };
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
}

impl Decision {
    /// The record of the step, of our own as far as there is one, and its image.
    pub(super) fn record(self, step: u32, state: &ObservedState) -> (StepRecord, Option<Frame>) {
        let Self {
            input,
            result,
            frame,
            kept,
        } = self;
        let digests = digests(frame.as_ref());
        let Some(mut record) = kept else {
            let tool = Tool::parse(&input.call).ok();
            let shown = CallObservation {
                reply: outcome::reply(tool.as_ref(), &result),
                input,
                tool,
                outcome: result,
                frame: digests.frame,
            };
            return (observe::record(step, shown, state, state), frame);
        };
        record.digests = digests;
        record.outcome.text = result.text;
        let kept = std::mem::replace(&mut record.input.call, input.call);
        if !kept.arguments.is_null() || !kept.name.is_empty() {
            record.input.call.arguments = kept.arguments;
        }
        if let Some(said) = input.policy {
            let policy = record.input.policy.get_or_insert_default();
            (policy.raw, policy.reasoning) = (said.raw, said.reasoning);
            policy.tokens = said.tokens.or(policy.tokens);
        }
        (record, frame)
    }

    fn new(call: ToolCall) -> Self {
        Self {
            input: StepInput::from_call(call),
            result: Outcome::ok(""),
            frame: None,
            kept: None,
        }
    }
}

/// Digests of a moment of which only the image is known.
pub(super) fn digests(frame: Option<&Frame>) -> StateDigests {
    StateDigests {
        frame: frame.map(Frame::digests),
        ..StateDigests::default()
    }
}

/// Adds a text on a line of its own.
fn join(text: &mut String, more: &str) {
    if !text.is_empty() && !more.is_empty() {
        text.push('\n');
    }
    text.push_str(more);
}
