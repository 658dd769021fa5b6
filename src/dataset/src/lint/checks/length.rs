//! Contexts beyond a budget: what the trainer cuts off is the end, which is the answer.
//!
//! Sure: an estimate, unless the model's own tokenizer counts. Images count at their
//! own size. Memory: constant.

use std::sync::Arc;

use crate::{TOKENS_PER_TURN, Tokenizer, image_tokens};

use super::{Check, LintOptions, RowFacts, row_facts::ImageProbe};
use crate::lint::{Example, Severity, Turn, report::Findings};

pub(super) struct Length {
    tokens_max: u64,
    image_side: u32,
    tokenizer: Arc<dyn Tokenizer>,
    longest: u64,
    sum: u64,
    rows: u64,
}

impl Length {
    pub(super) fn new(options: &LintOptions) -> Self {
        let (tokens_max, image_side) = (options.context_tokens_max, options.image_side);
        Self {
            tokens_max,
            image_side,
            tokenizer: Arc::clone(&options.tokenizer),
            longest: 0,
            sum: 0,
            rows: 0,
        }
    }

    /// The tokens of a row: of its text and of its images.
    fn tokens(&self, example: &Example, frames: &[ImageProbe]) -> (u64, u64) {
        let count = |text: &str| u64::from(self.tokenizer.count(text));
        let turn = |turn: &Turn| {
            let calls: u64 = turn.calls().map(|call| count(&call.canonical())).sum();
            turn.texts().map(count).sum::<u64>() + calls + u64::from(TOKENS_PER_TURN)
        };
        let tools = example
            .tools
            .as_ref()
            .map_or(0, |tools| count(&tools.to_string()));
        let frames = frames.iter().filter_map(|look| look.header);
        let frames = frames
            .map(|it| u64::from(image_tokens(it.width, it.height, self.image_side)))
            .sum();
        (example.turns.iter().map(turn).sum::<u64>() + tools, frames)
    }
}

impl Check for Length {
    fn about(&self) -> (&'static str, &'static str) {
        (
            "length",
            "contexts that are probably longer than the budget: the answer is what is cut off",
        )
    }

    fn see(&mut self, seen: &RowFacts, found: &mut Findings) {
        let (text, frames) = self.tokens(seen.example, &seen.images);
        let all = text + frames;
        self.longest = self.longest.max(all);
        self.sum += all;
        self.rows += 1;
        if all > self.tokens_max {
            let told = format!(
                "about {all} tokens ({text} of text, {frames} of images), budget {}",
                self.tokens_max
            );
            found.add("over budget", Severity::Error, &[seen.place()], || {
                (told, String::new())
            });
        }
    }

    fn finish(&mut self, found: &mut Findings) {
        found.note(format!(
            "about {} tokens a row, at most {}, budget {}, counted by {}",
            self.sum / self.rows.max(1),
            self.longest,
            self.tokens_max,
            self.tokenizer.name()
        ));
    }
}
