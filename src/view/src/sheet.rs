//! Images that belong together on one sheet, each with a title and a few words.

use reel_world::{FRAME_HEIGHT, FRAME_WIDTH};

use crate::{
    ViewError,
    canvas::{
        Canvas, Font,
        colours::{BLUE, CARD, FAINT, INK, PAPER},
        wrap,
    },
};

const COLUMNS_MAX: usize = 4;
const MARGIN: usize = 16;
const PADDING: usize = 8;
const LINE: usize = 18;
const TEXT_LINES: usize = 5;
const WIDTH: usize = FRAME_WIDTH / 2;
const HEIGHT: usize = FRAME_HEIGHT / 2;

/// One image of a sheet.
#[derive(Clone, PartialEq, Debug)]
pub struct SheetImage {
    /// RGB, as large as a frame; none leaves its place empty.
    pub image: Option<Vec<u8>>,
    /// In bold below it.
    pub title: String,
    /// Text below the title, of which at most five lines are shown.
    pub text: String,
}

/// A grid of images under a title, as PNG: 320 x 240 an image, four a row.
///
/// # Errors
/// When it cannot be encoded.
pub fn sheet(title: &str, cards: &[SheetImage]) -> Result<Vec<u8>, ViewError> {
    let columns = cards.len().clamp(2, COLUMNS_MAX);
    let width = MARGIN + columns * (WIDTH + MARGIN);
    let titles = wrap(title, (width - 2 * MARGIN) / Font::Title.width(), 2);
    let texts: Vec<Vec<String>> = cards
        .iter()
        .map(|card| {
            wrap(
                &card.text,
                (WIDTH - 2 * PADDING) / Font::Small.width(),
                TEXT_LINES,
            )
        })
        .collect();
    let lines = 1 + texts.iter().map(Vec::len).max().unwrap_or(0);
    let card_height = HEIGHT + 2 * PADDING + lines * LINE;
    let header = 2 * MARGIN + titles.len() * 30;
    let mut canvas = Canvas::new(
        width,
        header + cards.len().div_ceil(columns) * (card_height + MARGIN),
        PAPER,
    );
    for (index, line) in titles.iter().enumerate() {
        canvas.text(MARGIN, MARGIN + index * 30, line, Font::Title, INK);
    }
    for (index, (card, text)) in cards.iter().zip(&texts).enumerate() {
        let x = MARGIN + index % columns * (WIDTH + MARGIN);
        let y = header + index / columns * (card_height + MARGIN);
        canvas.fill(x, y, WIDTH, card_height, CARD);
        if let Some(frame) = &card.image {
            canvas.paste_halved(x, y, frame, FRAME_WIDTH, FRAME_HEIGHT);
        }
        let mut line = y + HEIGHT + PADDING;
        canvas.text(x + PADDING, line, &card.title, Font::SmallBold, BLUE);
        for words in text {
            line += LINE;
            canvas.text(x + PADDING, line, words, Font::Small, FAINT);
        }
    }
    Ok(canvas.png()?)
}
