//! How long examples are, in tokens: of texts by a tokenizer or a rule of thumb, of images
//! as Qwen-VL counts them, against the context of training (docs/spec.md#sft-data). Estimates:
//! a trainer's template decides.

use std::{collections::BTreeMap, fmt, fs, path::Path, sync::Arc};

use reel_world::Digest;
use serde::Serialize;

use crate::{DatasetError, Example, SharedText, StoredImage, Turn, example::call_json};

/// The context of training, in tokens.
pub const CONTEXT_TOKENS: u32 = 8_192;

/// Tokens that Qwen's template puts around a turn.
pub const TOKENS_PER_TURN: u32 = 5;
/// Side of an image's token in Qwen3-VL, in pixels.
pub const QWEN3_VL_SIDE: u32 = 32;
/// Tokens that stand around an image.
const TOKENS_PER_FRAME: u32 = 2;
/// Width of the histogram's bars, in tokens.
const BAR_TOKENS: u32 = 1_024;

/// Counts the tokens of a text.
pub trait Tokenizer: fmt::Debug + Send + Sync {
    /// For people: what counts, and how well.
    fn name(&self) -> &str;
    /// Number of tokens in the text, without those that a template adds.
    fn count(&self, text: &str) -> u32;
}

/// A rule of thumb for English and JSON: a token is four bytes. With Qwen's vocabulary our system
/// prompts have 6% less, users' turns as many, and answers 7% more.
#[derive(Clone, Copy, Debug, Default)]
pub struct BytesOverFour;

impl Tokenizer for BytesOverFour {
    fn name(&self) -> &str {
        "rule of thumb: bytes / 4"
    }

    fn count(&self, text: &str) -> u32 {
        u32::try_from(text.len().div_ceil(4)).unwrap_or(u32::MAX)
    }
}

/// A model's own tokenizer, from its `tokenizer.json`.
pub struct TokenizerFile {
    name: String,
    tokenizer: tokenizers::Tokenizer,
}

impl fmt::Debug for TokenizerFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)
    }
}

impl TokenizerFile {
    /// Reads it.
    ///
    /// # Errors
    /// When the file cannot be read or is no tokenizer.
    pub fn open(path: &Path) -> Result<Self, DatasetError> {
        let error = |reason: String| DatasetError::Tokenizer {
            reason,
            path: path.to_owned(),
        };
        let bytes = fs::read(path).map_err(|reason| error(reason.to_string()))?;
        let tokenizer = tokenizers::Tokenizer::from_bytes(&bytes)
            .map_err(|reason| error(reason.to_string()))?;
        let file = path.file_name().unwrap_or_default().to_string_lossy();
        Ok(Self {
            name: format!("{file} {}", Digest::of(&bytes).short()),
            tokenizer,
        })
    }
}

impl Tokenizer for TokenizerFile {
    fn name(&self) -> &str {
        &self.name
    }

    fn count(&self, text: &str) -> u32 {
        match self.tokenizer.encode_fast(text, false) {
            Ok(encoding) => u32::try_from(encoding.len()).unwrap_or(u32::MAX),
            // a text that it cannot read is as long as it can be
            Err(_) => u32::try_from(text.len()).unwrap_or(u32::MAX),
        }
    }
}

/// Tokens of an image: one for each square of `side` pixels after rounding the image to whole
/// squares, and what stands around it; the side is 28 for Qwen2.5-VL (patches of 14, two by two)
/// and 32 for Qwen3-VL (patches of 16, two by two).
pub fn image_tokens(width: u32, height: u32, side: u32) -> u32 {
    let squares = |pixels: u32| ((pixels + side / 2) / side.max(1)).max(1);
    squares(width)
        .saturating_mul(squares(height))
        .saturating_add(TOKENS_PER_FRAME)
}

/// Tokens of one example.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize)]
pub struct TokenCount {
    /// Of its texts, with what a template puts around turns.
    pub text: u32,
    /// Tokens of its images, with those that stand around each image.
    pub image: u32,
}

impl TokenCount {
    /// Tokens of the texts and the images together.
    pub fn total(self) -> u32 {
        self.text.saturating_add(self.image)
    }
}

/// Counts examples; texts that examples of an episode share are counted once. Parts are counted
/// apart, so that a real tokenizer's sum may be off by a token a part.
pub struct TokenCounter<'t> {
    tokenizer: &'t dyn Tokenizer,
    image_side: u32,
    shared: Vec<(Arc<SharedText>, u32)>,
}

/// System message, setting and tools of one episode.
const SHARED_TEXTS: usize = 3;

impl<'t> TokenCounter<'t> {
    /// Counts by a tokenizer, and images in squares of
    /// `image_side` pixels (see [`image_tokens`]).
    pub fn new(tokenizer: &'t dyn Tokenizer, image_side: u32) -> Self {
        Self {
            tokenizer,
            image_side,
            shared: Vec::new(),
        }
    }

    /// Counts one; `image` finds its images, and those it does not find count nothing.
    pub fn count(
        &mut self,
        example: &Example,
        frame: impl Fn(&crate::ImageId) -> Option<StoredImage>,
    ) -> TokenCount {
        let frames = example.images().filter_map(frame);
        let image = frames
            .map(|it| image_tokens(it.width, it.height, self.image_side))
            .sum();
        let mut text = example.tools.as_ref().map_or(0, |tools| self.shared(tools));
        for turn in &example.turns {
            text += TOKENS_PER_TURN;
            text += match turn {
                Turn::System(system) => self.shared(system),
                Turn::User {
                    setting, situation, ..
                } => self.shared(setting) + self.tokenizer.count(situation),
                Turn::Answer(answer) => self.tokenizer.count(answer),
                Turn::Call {
                    thought,
                    name,
                    arguments,
                    ..
                } => {
                    self.tokenizer.count(thought)
                        + self.tokenizer.count(&call_json(name, arguments))
                }
                Turn::Outcome { text, .. } => self.tokenizer.count(text),
            };
        }
        TokenCount { text, image }
    }

    fn shared(&mut self, text: &Arc<SharedText>) -> u32 {
        if let Some((_, count)) = self
            .shared
            .iter()
            .find(|(known, _)| Arc::ptr_eq(known, text))
        {
            return *count;
        }
        let count = self.tokenizer.count(text.as_str());
        self.shared.truncate(SHARED_TEXTS - 1);
        self.shared.insert(0, (Arc::clone(text), count));
        count
    }
}

/// The lengths of a dataset's examples against a budget.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct TokenReport {
    /// What counted the texts.
    pub tokenizer: String,
    /// Side of an image's token, in pixels.
    pub image_side: u32,
    /// The context of training.
    pub budget: u32,
    /// Number of examples that were counted.
    pub examples: u64,
    /// Examples that are longer than the budget.
    pub over: u64,
    /// Length of the longest example, in tokens of texts and images.
    pub longest: u32,
    /// Tokens of all texts.
    pub text: u64,
    /// Tokens of all images.
    pub image: u64,
    /// How many examples have up to so many tokens (and more than the bar before).
    pub histogram: BTreeMap<u32, u64>,
}

impl TokenReport {
    /// A report that has counted no examples yet.
    pub fn new(tokenizer: &dyn Tokenizer, image_side: u32, budget: u32) -> Self {
        Self {
            tokenizer: tokenizer.name().to_owned(),
            image_side,
            budget,
            examples: 0,
            over: 0,
            longest: 0,
            text: 0,
            image: 0,
            histogram: BTreeMap::new(),
        }
    }

    /// Adds one example by its numbers of tokens.
    pub fn add(&mut self, count: TokenCount) {
        let total = count.total();
        self.examples += 1;
        self.over += u64::from(total > self.budget);
        self.longest = self.longest.max(total);
        self.text += u64::from(count.text);
        self.image += u64::from(count.image);
        *self
            .histogram
            .entry(total.div_ceil(BAR_TOKENS).max(1).saturating_mul(BAR_TOKENS))
            .or_default() += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_as_qwen_counts_them() {
        assert_eq!(image_tokens(364, 252, 28), 13 * 9 + 2);
        assert_eq!(image_tokens(352, 256, 32), 11 * 8 + 2);
        assert_eq!(image_tokens(1, 1, 28), 1 + 2);
    }

    #[test]
    fn a_models_own_tokenizer_counts() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tokenizer.json");
        let vocabulary = r#"{"pick": 0, "the": 1, "mug": 2, "?": 3}"#;
        let model = format!(r#"{{"type": "WordLevel", "vocab": {vocabulary}, "unk_token": "?"}}"#);
        fs::write(&path, format!(r#"{{"version": "1.0", "pre_tokenizer": {{"type": "Whitespace"}}, "model": {model}}}"#))
            .unwrap();
        let tokenizer = TokenizerFile::open(&path).unwrap();
        assert_eq!(
            [
                tokenizer.count("pick the mug"),
                tokenizer.count("pick a mug, now"),
                tokenizer.count("")
            ],
            [3, 5, 0]
        );
        assert!(tokenizer.name().starts_with("tokenizer.json "));
        for (text, word) in [("{}", "no tokenizer"), ("", "no tokenizer")] {
            fs::write(&path, text).unwrap();
            let error = TokenizerFile::open(&path).err().unwrap().to_string();
            assert!(
                error.contains(word) && error.contains("tokenizer.json"),
                "{error}"
            );
        }
    }

    #[test]
    fn the_report_counts_what_is_over() {
        let mut report = TokenReport::new(&BytesOverFour, 28, CONTEXT_TOKENS);
        for (text, image) in [(8_000, 192), (8_000, 193), (1, 0)] {
            report.add(TokenCount { text, image });
        }
        assert_eq!(
            (report.examples, report.over, report.longest),
            (3, 1, 8_193)
        );
        assert_eq!(
            report.histogram,
            BTreeMap::from([(1_024, 1), (8_192, 1), (9_216, 1)])
        );
    }
}
