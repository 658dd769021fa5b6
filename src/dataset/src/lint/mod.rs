//! What is wrong with a training set, ours or anybody's: reads the formats of
//! docs/spec.md#dataset-formats and reports with examples.
//!
//! Owns the reading of rows into one common form ([`Example`]), the checks, the report and the
//! showing of an example. Never changes a file and never asks a model; what a trainer's loader
//! would do silently is said aloud.

mod checks;
mod dataset;
mod error;
mod example;
mod files;
mod formats;
mod image;
mod json;
mod parquet_rows;
mod report;
mod show;

pub use crate::Format;
pub use checks::{LintOptions, lint};
pub use dataset::{Dataset, DatasetFile, Rows};
pub use error::{LintError, RowError};
pub use example::{Example, Image, ImageSource, Part, Role, RowLocation, Turn};
pub use files::row_files;
pub use image::{ImageError, ImageFormat, ImageHeader};
pub use json::{JsonError, JsonText, JsonTexts};
pub use reel_world::answer::{AssistantTurn, Call};
pub use report::{CheckReport, ExampleRef, Finding, Report, Severity, write_checks};
pub use show::{image_bytes, show};
