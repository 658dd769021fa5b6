//! What is in a data set of any origin: profiles, differences between two versions, and joins of
//! Parquet and JSONL files, on the streaming engine of Polars.
//!
//! Owns the reading of files into one table ([`Table`]), the statistics ([`Profile`]), the
//! comparison ([`Diff`]) and the join ([`join`]). Every pass over the rows is streamed: memory
//! depends on the number of columns and on the limits named beside each operation, not on the
//! bytes of the set. Never changes a file that it reads, and never asks what a training row means;
//! that is `reel_dataset::lint`.

mod accumulate;
mod conversation;
mod diff;
mod drift;
mod duplicates;
mod error;
mod join;
mod json_shape;
mod leaves;
mod parquet_check;
mod profile;
mod report;
mod sketch;
mod sources;
mod table;

pub use diff::{
    Balance, ColumnDrift, Diff, DiffOptions, KeyChanges, RowChanges, SchemaChange, diff,
};
pub use drift::{PSI_THRESHOLD, js_divergence, psi};
pub use duplicates::Duplicates;
pub use error::DataError;
pub use join::{JoinHow, JoinOptions, JoinReport, join};
pub use profile::{
    ClassCount, ColumnProfile, ConversationProfile, Numbers, Profile, ProfileOptions, profile,
};
pub use sketch::{Counts, QuantileSketch, TopValue};
pub use sources::{FileFormat, SourceFile};
pub use table::{Column, Table};
