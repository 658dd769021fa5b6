//! Contexts beyond a budget: what the trainer cuts off is the end, which is the answer.
//!
//! Sure: an estimate. Text is counted by [`text_tokens`], within some 15% of Qwen's tokenizer on English with JSON; pictures at
//! their own size by the pixels that make a token. Memory: constant.

use super::{Check, Seen, seen::Look};
use crate::{Example, Severity, Turn, report::Findings};

pub(super) struct Length {
    tokens_max: u64,
    pixels_per_token: u64,
    longest: u64,
    sum: u64,
    rows: u64,
}

impl Length {
    pub(super) fn new(tokens_max: u64, pixels_per_token: u64) -> Self {
        Self { tokens_max, pixels_per_token: pixels_per_token.max(1), longest: 0, sum: 0, rows: 0 }
    }

    /// The tokens of a row: of its text and of its pictures.
    fn tokens(&self, example: &Example, pictures: &[Look]) -> (u64, u64) {
        let turn = |turn: &Turn| {
            let calls: u64 = turn.calls().map(|call| text_tokens(&call.canonical())).sum();
            turn.texts().map(text_tokens).sum::<u64>() + calls + TURN_TOKENS
        };
        let tools = example.tools.as_ref().map_or(0, |tools| text_tokens(&tools.to_string()));
        let pixels = pictures.iter().filter_map(|look| look.picture).map(|picture| picture.pixels());
        let pictures = pixels.map(|pixels| pixels.div_ceil(self.pixels_per_token) + PICTURE_TOKENS).sum();
        (example.turns.iter().map(turn).sum::<u64>() + tools, pictures)
    }
}

/// Tokens around a turn and around a picture in the chat templates of Qwen.
const TURN_TOKENS: u64 = 5;
const PICTURE_TOKENS: u64 = 2;

/// An estimate of a text's tokens: a word of letters up to 7 bytes is one, each further 5 bytes another; digits and signs are
/// one each, but for runs of signs, which go by twos; letters beyond ASCII are one each.
pub(super) fn text_tokens(text: &str) -> u64 {
    let (mut tokens, mut letters, mut signs) = (0, 0_u64, 0_u64);
    let mut flush = |letters: &mut u64, signs: &mut u64| {
        if *letters > 0 {
            tokens += 1 + letters.saturating_sub(3) / 5;
        }
        tokens += signs.div_ceil(2);
        (*letters, *signs) = (0, 0);
    };
    let mut others = 0;
    for c in text.chars() {
        if c.is_ascii_alphabetic() {
            if signs > 0 {
                flush(&mut letters, &mut signs);
            }
            letters += 1;
        } else if c == ' ' {
            flush(&mut letters, &mut signs);
        } else if c.is_ascii_punctuation() || c == '\n' {
            if letters > 0 {
                flush(&mut letters, &mut signs);
            }
            signs += 1;
        } else {
            flush(&mut letters, &mut signs);
            others += 1;
        }
    }
    flush(&mut letters, &mut signs);
    tokens + others
}

impl Check for Length {
    fn about(&self) -> (&'static str, &'static str) {
        ("length", "contexts that are probably longer than the budget: the answer is what is cut off")
    }

    fn see(&mut self, seen: &Seen, found: &mut Findings) {
        let (text, pictures) = self.tokens(seen.example, &seen.pictures);
        let all = text + pictures;
        self.longest = self.longest.max(all);
        self.sum += all;
        self.rows += 1;
        if all > self.tokens_max {
            let told = format!("about {all} tokens ({text} of text, {pictures} of pictures), budget {}", self.tokens_max);
            found.add("over budget", Severity::Error, &[seen.place()], || (told, String::new()));
        }
    }

    fn finish(&mut self, found: &mut Findings) {
        found.note(format!(
            "about {} tokens a row, at most {}, budget {}",
            self.sum / self.rows.max(1),
            self.longest,
            self.tokens_max
        ));
    }
}
