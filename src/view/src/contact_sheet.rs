//! All images of an episode on one sheet, each with its call, its outcome and its reward.

use reel_trace::Trace;
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, record::EndReason, record::StepRecord};

use crate::{
    ViewError,
    canvas::{
        Canvas, Colour, Font,
        colours::{BLUE, CARD, FAINT, GREEN, INK, PAPER, RED},
        wrap,
    },
};

const COLUMNS_MAX: usize = 4;
const MARGIN: usize = 16;
const CARD_WIDTH: usize = FRAME_WIDTH / 2;
const IMAGE_HEIGHT: usize = FRAME_HEIGHT / 2;
const PADDING: usize = 8;
const STRIP: usize = 4;
const CALL_LINES: usize = 2;
const OUTCOME_LINES: usize = 3;
const LINE: usize = 18;

const NO_IMAGE: Colour = [225, 229, 235];

/// One card of the sheet.
struct Cell {
    image: Option<Vec<u8>>,
    title: String,
    reward: Option<f64>,
    call: Vec<String>,
    outcome: Vec<String>,
    colour: Colour,
}

/// A grid of all images of an episode with captions, under a title, as PNG: 320 x 240 an image,
/// four a row. A step without a new image has a grey card; a lean trace has grey cards only.
///
/// # Errors
/// When an image of the trace is damaged.
pub fn contact_sheet(trace: &Trace) -> Result<Vec<u8>, ViewError> {
    let cards = cards(trace)?;
    let columns = cards.len().clamp(1, COLUMNS_MAX);
    let rows = cards.len().div_ceil(columns);
    let width = MARGIN + columns.max(2) * (CARD_WIDTH + MARGIN);
    let (verdict, verdict_colour) = verdict(trace);
    let title = format!(
        "{}  ({}, seed {})",
        trace.header.task_id, trace.header.policy.name, trace.header.seed
    );
    let text_columns = (width - 2 * MARGIN) / Font::Title.width();
    let titles = wrap(&title, text_columns, 2);
    let small_columns = (width - 2 * MARGIN) / Font::Small.width();
    let instruction = wrap(&trace.task.instruction, small_columns, 4);
    let verdicts = wrap(&verdict, small_columns, 2);
    let header = MARGIN + titles.len() * 30 + (instruction.len() + verdicts.len()) * 20 + MARGIN;
    let caption = cards
        .iter()
        .map(|card| card.call.len() + card.outcome.len())
        .max()
        .unwrap_or(0);
    let card_height = STRIP + IMAGE_HEIGHT + 2 * PADDING + (1 + caption) * LINE;
    let mut canvas = Canvas::new(width, header + rows * (card_height + MARGIN), PAPER);
    let mut y = MARGIN;
    let mut write = |lines: &[String], font: Font, colour: Colour, step: usize| {
        for line in lines {
            canvas.text(MARGIN, y, line, font, colour);
            y += step;
        }
    };
    write(&titles, Font::Title, INK, 30);
    write(&instruction, Font::Small, INK, 20);
    write(&verdicts, Font::SmallBold, verdict_colour, 20);
    for (index, card) in cards.iter().enumerate() {
        let x = MARGIN + index % columns * (CARD_WIDTH + MARGIN);
        draw(
            &mut canvas,
            card,
            x,
            header + index / columns * (card_height + MARGIN),
            card_height,
        );
    }
    Ok(canvas.png()?)
}

fn cards(trace: &Trace) -> Result<Vec<Cell>, ViewError> {
    let start = Cell {
        image: trace.frame_rgb(None)?,
        title: "start".into(),
        reward: None,
        call: lines(&trace.scene.scene_id, CALL_LINES),
        outcome: lines("before the first decision", OUTCOME_LINES),
        colour: BLUE,
    };
    let mut cards = vec![start];
    for record in &trace.steps {
        cards.push(Cell {
            image: trace.frame_rgb(Some(record.step))?,
            title: format!("step {}", record.step),
            reward: Some(record.reward_total()),
            call: lines(&call(record), CALL_LINES),
            outcome: lines(&outcome(record), OUTCOME_LINES),
            colour: if record.outcome.is_ok() { GREEN } else { RED },
        });
    }
    Ok(cards)
}

fn lines(text: &str, lines_max: usize) -> Vec<String> {
    wrap(
        text,
        (CARD_WIDTH - 2 * PADDING) / Font::Small.width(),
        lines_max,
    )
}

/// The tool and the values of its arguments.
fn call(record: &StepRecord) -> String {
    let call = &record.input.call;
    let values: Vec<_> = call.values().collect();
    format!("{} {}", call.name, values.join(", "))
}

/// What the agent was told, an error by its code.
pub(crate) fn outcome(record: &StepRecord) -> String {
    match record.outcome.error {
        Some(code) => format!("{code}: {}", record.outcome.text),
        None => record.outcome.text.clone(),
    }
}

/// How it ended, in one line.
fn verdict(trace: &Trace) -> (String, Colour) {
    let Some(end) = &trace.end else {
        return ("the trace breaks off".into(), RED);
    };
    let metrics = &end.metrics;
    let (word, colour) = if metrics.success {
        ("success", GREEN)
    } else {
        ("failure", RED)
    };
    let how = match end.reason {
        EndReason::Finished => "finished",
        EndReason::Horizon => "reached the horizon",
        EndReason::Fault => "ended by a fault",
        EndReason::Aborted => "aborted",
    };
    let (done, reward) = (100.0 * metrics.completion, metrics.total_reward);
    (
        format!(
            "{word}: {how} after {} decisions, {done:.0}% done, reward {reward:+.2}, {} asks",
            metrics.length, metrics.asks
        ),
        colour,
    )
}

fn draw(canvas: &mut Canvas, card: &Cell, x: usize, y: usize, height: usize) {
    canvas.fill(x, y, CARD_WIDTH, height, CARD);
    canvas.fill(x, y, CARD_WIDTH, STRIP, card.colour);
    match &card.image {
        Some(rgb) => canvas.paste_halved(x, y + STRIP, rgb, FRAME_WIDTH, FRAME_HEIGHT),
        None => {
            canvas.fill(x, y + STRIP, CARD_WIDTH, IMAGE_HEIGHT, NO_IMAGE);
            let note = "no new image";
            let note_x = x + (CARD_WIDTH - note.len() * Font::Small.width()) / 2;
            canvas.text(
                note_x,
                y + STRIP + (IMAGE_HEIGHT - Font::Small.height()) / 2,
                note,
                Font::Small,
                FAINT,
            );
        }
    }
    let (left, mut line) = (x + PADDING, y + STRIP + IMAGE_HEIGHT + PADDING);
    canvas.text(left, line, &card.title, Font::SmallBold, card.colour);
    if let Some(reward) = card.reward {
        let text = format!("{reward:+.2}");
        let right = x + CARD_WIDTH - PADDING - text.len() * Font::SmallBold.width();
        canvas.text(
            right,
            line,
            &text,
            Font::SmallBold,
            if reward < 0.0 { RED } else { GREEN },
        );
    }
    line += LINE;
    for text in &card.call {
        canvas.text(left, line, text, Font::SmallBold, INK);
        line += LINE;
    }
    for text in &card.outcome {
        canvas.text(left, line, text, Font::Small, FAINT);
        line += LINE;
    }
}
