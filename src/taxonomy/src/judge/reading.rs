//! A case read step by step: after each step, without what comes after it, whether it is decisive.

use reel_llm::client::{Reply, Request};

use super::{Case, JudgeError, JudgeOptions, answer, answered, prompt};

/// Which step the model held for decisive, and why.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct DecisiveStep {
    /// Number of the step in the episode.
    pub step: u32,
    /// The model's reason, one line.
    pub comment: String,
}

/// The first step that the model holds for decisive; `None` where it held none. An answer that
/// cannot be read is asked for once more, with what is wrong.
pub(super) fn decisive(
    case: &Case,
    options: &JudgeOptions,
    ask: &dyn Fn(&Request) -> Result<Reply, JudgeError>,
) -> Result<Option<DecisiveStep>, JudgeError> {
    for (index, step) in case.transcript.iter().enumerate() {
        let so_far = Case {
            transcript: case.transcript[..=index].to_vec(),
            frames: case
                .frames
                .iter()
                .filter(|frame| frame.step <= step.step)
                .cloned()
                .collect(),
            ..case.clone()
        };
        let request = prompt::step_request(&so_far, options);
        let parse = |text: &str| {
            let read = answer::parse_step(text);
            read.map_err(|problem| format!("step {}: {problem}", step.step))
        };
        let (_, read) = answered(case, request, ask, parse)?;
        if let Some(comment) = read {
            return Ok(Some(DecisiveStep {
                step: step.step,
                comment,
            }));
        }
    }
    Ok(None)
}
