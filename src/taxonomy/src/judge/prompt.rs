//! A case as a request: the prompt file, then the record between two lines, then images.

use std::ops::Range;

use reel_llm::client::{Message, Part, Request, Role};
use reel_world::Digest;
use serde_json::json;

use super::{Case, CaseImage, CaseStep, JudgeOptions, JudgeReading, reading::DecisiveStep};

/// What the judge is told before it gets a record.
pub(super) const PROMPT: &str = include_str!("../../prompts/judge.md");

/// Most bytes of one text of a step.
const TEXT_BYTES_MAX: usize = 2_000;
/// Texts are not shortened below this many bytes: rather, steps in the middle go.
const TEXT_BYTES_MIN: usize = 250;
/// Room for the line that says what was left out.
const NOTE_BYTES: usize = 150;

/// What the judge is told before it gets a record up to a step.
const STEP_PROMPT: &str = include_str!("../../prompts/judge-step.md");

/// The version of the prompts of a reading: the digest of their files.
pub fn version(reading: JudgeReading) -> Digest {
    match reading {
        JudgeReading::Whole => Digest::of(PROMPT.as_bytes()),
        JudgeReading::Steps => Digest::of(format!("{STEP_PROMPT}{PROMPT}").as_bytes()),
    }
}

/// What the model is asked about a case. `found` is the step that it held for decisive when it read
/// the case step by step.
pub(super) fn request(
    case: &Case,
    options: &JudgeOptions,
    found: Option<&DecisiveStep>,
) -> Request {
    let question = match found {
        None => "Why did this episode fail? Answer with the one JSON object.".to_owned(),
        Some(found) => format!(
            "Reading it step by step, you held step {} for the decisive one: {} Why did this episode fail? Answer with the one JSON object; its `step` is {}, unless the whole record shows that you were wrong.",
            found.step,
            json!(found.comment),
            found.step
        ),
    };
    asked(case, options, PROMPT, &question)
}

/// What the model is asked about the last step of a case that ends there.
pub(super) fn step_request(case: &Case, options: &JudgeOptions) -> Request {
    let step = case.transcript.last().map_or(0, |step| step.step);
    let question = format!(
        "Is step {step}, the last of this record, the decisive one? Answer with the one JSON object."
    );
    asked(case, options, STEP_PROMPT, &question)
}

fn asked(case: &Case, options: &JudgeOptions, prompt: &str, question: &str) -> Request {
    let record = record(
        case,
        options
            .transcript_bytes
            .max(JudgeOptions::TRANSCRIPT_BYTES_MIN),
    );
    // Nobody who writes into the record knows the digest of all of it.
    let code = Digest::of(record.as_bytes()).short();
    let record = format!("BEGIN RECORD {code}\n{record}END RECORD {code}");
    let system = Message::text(Role::System, prompt);
    if case.frames.is_empty() || options.frames == 0 {
        return Request {
            messages: vec![
                system,
                Message::text(Role::User, format!("{record}\n\n{question}")),
            ],
            ..Request::default()
        };
    }
    let mut parts = vec![Part::Text(record)];
    for image in spread(&case.frames, options.frames) {
        parts.push(Part::Text(format!(
            "What the robot saw after step {}:",
            image.step
        )));
        parts.push(Part::Image {
            media_type: image.media_type.clone(),
            bytes: image.bytes.clone(),
        });
    }
    parts.push(Part::Text(question.to_owned()));
    Request {
        messages: vec![system, Message::new(Role::User, parts)],
        ..Request::default()
    }
}

/// What the model is told about an answer that cannot be read.
pub(super) fn retry_prompt(what: &str) -> String {
    format!(
        "Your answer cannot be used: {what}. Answer again, with the one JSON object and nothing else."
    )
}

/// The record, at most so many bytes: a JSON object a line, so that no text of it can begin a line
/// of its own. What is too long loses the middle of its texts first, then steps in the middle.
fn record(case: &Case, bytes_max: usize) -> String {
    let mut text_max = TEXT_BYTES_MAX;
    loop {
        let first = first_line(case, text_max);
        let lines: Vec<String> = case
            .transcript
            .iter()
            .map(|turn| line(turn, text_max))
            .collect();
        if first.len() + lines.iter().map(String::len).sum::<usize>() <= bytes_max {
            return first + &lines.concat();
        }
        if text_max <= TEXT_BYTES_MIN {
            return without_middle(case, first, &lines, bytes_max);
        }
        text_max = (text_max / 2).max(TEXT_BYTES_MIN);
    }
}

fn first_line(case: &Case, text_max: usize) -> String {
    let mut first = json!({"instruction": shortened(&case.instruction, text_max)});
    if let Some(truth) = &case.truth {
        first["truth"] = json!(truth);
    }
    if case.reduced {
        first["reduced"] = json!(true);
    }
    format!("{first}\n")
}

fn without_middle(case: &Case, first: String, lines: &[String], bytes_max: usize) -> String {
    let left_out = middle(lines, bytes_max.saturating_sub(first.len() + NOTE_BYTES));
    let (from, to) = (
        case.transcript[left_out.start].step,
        case.transcript[left_out.end - 1].step,
    );
    let note = format!(
        "the record is too long: {} steps, {from} to {to}, are left out here",
        left_out.len()
    );
    let (before, after) = (
        lines[..left_out.start].concat(),
        lines[left_out.end..].concat(),
    );
    format!("{first}{before}{}\n{after}", json!({"note": note}))
}

fn line(turn: &CaseStep, text_max: usize) -> String {
    let short = |text: &str| shortened(text, text_max);
    let turn = CaseStep {
        step: turn.step,
        call: short(&turn.call),
        outcome: short(&turn.outcome),
        error: short(&turn.error),
        acted_on: short(&turn.acted_on),
        reasoning: short(&turn.reasoning),
        history: short(&turn.history),
        question: short(&turn.question),
        answer: short(&turn.answer),
    };
    serde_json::to_string(&turn).expect("a turn is always JSON") + "\n"
}

/// Which lines have to go so that the others fit: about as many bytes stay before
/// as after. Never none.
fn middle(lines: &[String], room: usize) -> Range<usize> {
    let (mut start, mut end) = (0, lines.len());
    let (mut before, mut after) = (0, 0);
    while start + 1 < end {
        let at_start = before <= after;
        let bytes = if at_start {
            lines[start].len()
        } else {
            lines[end - 1].len()
        };
        if before + after + bytes > room {
            break;
        }
        match at_start {
            true => (start, before) = (start + 1, before + bytes),
            false => (end, after) = (end - 1, after + bytes),
        }
    }
    start..end
}

/// Beginning and end of a text that is too long.
fn shortened(text: &str, bytes_max: usize) -> String {
    if text.len() <= bytes_max {
        return text.to_owned();
    }
    let head = text.floor_char_boundary(bytes_max / 2);
    let tail = text.ceil_char_boundary(text.len() - bytes_max / 2);
    format!(
        "{} [... {} bytes left out ...] {}",
        &text[..head],
        tail - head,
        &text[tail..]
    )
}

/// So many images with even gaps, the last one always.
fn spread(images: &[CaseImage], count: usize) -> impl Iterator<Item = &CaseImage> {
    let count = count.min(images.len());
    (1..=count).map(move |nth| &images[(nth * images.len()).div_ceil(count) - 1])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(steps: u32, words: &str) -> Case {
        let turn = |step| CaseStep {
            step,
            call: "finish()".to_owned(),
            reasoning: words.to_owned(),
            ..CaseStep::default()
        };
        Case {
            instruction: format!("bring me the mug {words}"),
            transcript: (0..steps).map(turn).collect(),
            ..Case::default()
        }
    }

    #[test]
    fn a_record_keeps_to_its_bytes() {
        for (steps, words) in [
            (1, "a"),
            (30, "b"),
            (3000, "c"),
            (40, &*"d\n\"".repeat(3000)),
            (1, &*"\u{1}".repeat(9000)),
            (20, &*"ü😀".repeat(999)),
        ] {
            for bytes_max in [2_000, 5_000, 60_000] {
                let text = record(&case(steps, words), bytes_max);
                assert!(
                    text.len() <= bytes_max,
                    "{steps} steps of {}: {} of {bytes_max}",
                    words.len(),
                    text.len()
                );
                let lines: Vec<serde_json::Value> = text
                    .lines()
                    .map(|line| serde_json::from_str(line).unwrap())
                    .collect();
                let whole = lines
                    .iter()
                    .filter(|line| line.get("step").is_some())
                    .count()
                    == steps as usize;
                assert!(
                    whole != lines.iter().any(|line| line.get("note").is_some()),
                    "{text}"
                );
            }
        }
    }

    #[test]
    fn the_middle_goes_first() {
        let text = record(&case(100, &"x".repeat(100)), 2_000);
        let steps: Vec<u64> = text
            .lines()
            .filter_map(|line| {
                serde_json::from_str::<serde_json::Value>(line).ok()?["step"].as_u64()
            })
            .collect();
        let gap = steps
            .windows(2)
            .position(|pair| pair[1] != pair[0] + 1)
            .unwrap();
        assert_eq!((steps[0], *steps.last().unwrap()), (0, 99));
        assert!(
            steps.len() > 10 && gap.abs_diff(steps.len() / 2) <= 1,
            "{steps:?}"
        );
        let note = format!(
            "{} steps, {} to {}, are left out",
            100 - steps.len(),
            steps[gap] + 1,
            steps[gap + 1] - 1
        );
        assert!(text.contains(&note), "{text}");
    }

    #[test]
    fn images_are_spread_to_the_last() {
        let image = |step| CaseImage {
            step,
            media_type: "image/png".to_owned(),
            bytes: vec![0],
        };
        let images: Vec<CaseImage> = (0..10).map(image).collect();
        let steps = |count| {
            spread(&images, count)
                .map(|image| image.step)
                .collect::<Vec<_>>()
        };
        assert_eq!(steps(0), [] as [u32; 0]);
        assert_eq!(steps(1), [9]);
        assert_eq!(steps(3), [3, 6, 9]);
        assert_eq!(steps(99), (0..10).collect::<Vec<_>>());
    }
}
