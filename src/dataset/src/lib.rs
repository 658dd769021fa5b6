//! Training examples: what a policy saw and should answer, as the formats that trainers load (SPEC sections 4, 8 and 11).
//!
//! Owns the prompt, the removal of what is privileged, the formats, pictures on disk, splits and what a dataset says of
//! itself. Never reads a trace or a table: it is given episodes as plain text and pictures as pixels.

mod episode;
mod error;
mod example;
mod format;
mod json;
mod picture;
mod privileged;
mod prompt;
mod shard;
mod split;

pub use episode::{Episode, ImageId, Receptacle, Source, Step};
pub use error::DatasetError;
pub use example::{About, Example, ExampleOptions, Examples, Refusal, Refused, Style, Text, Turn, examples};
pub use format::Format;
pub use picture::{Encoding, PIXELS_MAX, PIXELS_MIN, Picture, PictureOptions, Pictures};
pub use privileged::{Leak, LeakKind, Secrets, privileged, strip};
pub use prompt::{SYSTEM_MULTI_TURN, SYSTEM_SINGLE_TURN, prompt_digest, tool_list};
pub use shard::{Shard, Shards};
pub use split::{Leakage, LeakageCheck, Ratios, Split, Splits};
