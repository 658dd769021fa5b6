//! Training examples: what a policy saw and should answer, as the formats that trainers
//! load (docs/spec.md#sft-data and docs/spec.md#dataset-formats).
//!
//! Owns the prompt, the removal of what is privileged, the formats, images on disk, splits and
//! what a dataset says of itself. Never reads a trace or a table: it is given episodes as plain
//! text and images as pixels.

mod briefing;
mod card;
mod dataset;
mod episode;
mod error;
mod example;
mod format;
mod image;
mod json;
pub mod lint;
mod manifest;
mod preferences;
mod privileged;
mod refusal;
mod rollout;
mod shard;
mod split;
mod tokens;

pub use briefing::{PublicReceptacle, TaskBriefing};
pub use card::{CARD, DATASET_INFO, card, dataset_info, size_category, write_card};
pub use dataset::{DatasetWriter, Description, PreparedRow, WriterOptions};
pub use episode::{AgentSetup, Episode, ImageId, Source, Step};
pub use error::DatasetError;
pub use example::{
    EpisodeInfo, Example, ExampleOptions, Examples, SharedText, Style, Turn, examples,
};
pub use format::Format;
pub use image::{Encoding, ImageOptions, ImageStore, PIXELS_MAX, PIXELS_MIN, StoredImage, resize};
pub use json::quoted;
pub use manifest::{Counts, FileEntry, MANIFEST, Manifest, PromptTemplate, UNFINISHED, files};
pub use preferences::{PREFERENCES, PreferenceDescription, VALUES, write_preference_card};
pub use privileged::{Leak, LeakKind, PrivilegedFacts, find_leak, strip};
pub use refusal::{RefusalReason, RefusedDecision};
pub use rollout::{Rollout, TASK_LIST, task_list};
pub use shard::{Shard, Shards};
pub use split::{Leakage, LeakageCheck, Ratios, Split, Splits};
pub use tokens::{
    BytesOverFour, CONTEXT_TOKENS, QWEN3_VL_SIDE, TOKENS_PER_TURN, TokenCount, TokenCounter,
    TokenReport, Tokenizer, TokenizerFile, image_tokens,
};
