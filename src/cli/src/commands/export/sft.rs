//! `reel export sft`: supervised training sets out of a store.

use std::{collections::HashSet, path::PathBuf};

use anyhow::{Context, bail};
use reel_dataset::{Format, PictureFormat, SplitBy, Style};
use reel_export::{Selection, SftOptions, SftReport, Words};
use reel_query::Session;
use reel_tables::Store;

use crate::{Answer, inputs, progress};

/// Training examples from the episodes of a store: what the agent saw before a decision, and what it should do. Only episodes
/// that replay bit for bit become rows; every row names its trace, call, verdict, reward preset and rules. Broken off, the
/// same command goes on where it stopped. Same store version, same options: same bytes.
///
/// Example:
///   reel ingest traces --store store
///   reel export sft --store store --out sft --format trl,parquet
///   reel dataset lint sft
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The store: a folder or s3://bucket/folder
    #[arg(long, value_name = "STORE", default_value = "store")]
    store: String,
    /// An earlier version of the store
    #[arg(long, value_name = "N")]
    version: Option<u64>,
    /// Folder of the dataset
    #[arg(long, value_name = "DIR", default_value = "sft")]
    out: PathBuf,
    /// Formats: parquet, trl, trl-completion, openai, ms-swift, llama-factory, qwen-vl
    #[arg(long, value_name = "NAMES", value_delimiter = ',', default_value = "parquet", value_parser = parse::<Format>)]
    format: Vec<Format>,
    /// How a decision is put: single-turn (the paper's), multi-turn (an episode with native tool calls), multi-turn-prefix
    #[arg(long, value_name = "STYLE", default_value = "single-turn", value_parser = parse::<Style>)]
    style: Style,
    /// Only episodes that fulfil this condition on table `episodes`, in SQL, e.g. "family = 'SUL' AND spl > 0.5"
    #[arg(long = "where", value_name = "SQL")]
    condition: Option<String>,
    /// Failed and broken-off episodes too, up to their decisive step (run `reel taxonomy` before)
    #[arg(long)]
    failed: bool,
    /// With --failed: decisions from the decisive step on too
    #[arg(long, requires = "failed")]
    after_decisive: bool,
    /// Episodes with a discounted return below this are left out
    #[arg(long, value_name = "RETURN", allow_negative_numbers = true)]
    return_min: Option<f64>,
    /// At most so many episodes a task
    #[arg(long, value_name = "N")]
    per_task: Option<usize>,
    /// Decisions that were mistakes are examples too: failed calls, wrong picks and places
    #[arg(long)]
    mistakes: bool,
    /// Decisions right after a mistake are no examples
    #[arg(long)]
    no_recoveries: bool,
    /// Decisions whose own History contradicts the record are examples too, their History mended
    #[arg(long)]
    contradictions: bool,
    /// Cut to the median size: family, tool
    #[arg(long, value_name = "WHAT", value_delimiter = ',', value_parser = ["family", "tool"])]
    balance: Vec<String>,
    /// Whose words: auto (a model's own where it spoke, else written by rules), rules, recorded
    #[arg(long, value_name = "WORDS", default_value = "auto", value_parser = parse::<Words>)]
    words: Words,
    /// What is kept together in a part of the dataset: task or scene
    #[arg(long, value_name = "WHAT", default_value = "task", value_parser = parse::<SplitBy>)]
    split: SplitBy,
    /// Share of the validation part
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    validation: f64,
    /// Share of the test part
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    test: f64,
    /// Pictures: png, webp (both lossless), jpeg or none
    #[arg(long, value_name = "FORMAT", default_value = "png", value_parser = pictures)]
    images: Option<PictureFormat>,
    /// Most pixels of a picture; 0: as they were taken (640 x 480)
    #[arg(long, value_name = "PIXELS", default_value_t = 100_352)]
    pixels: u32,
    /// Tokens of an example beyond which it is counted as too long
    #[arg(long, value_name = "TOKENS", default_value_t = 8_192)]
    budget: u32,
    /// Episodes that were not verified too; their rows say so
    #[arg(long)]
    allow_unverified: bool,
    /// Replay nothing: only what earlier exports verified counts as verified
    #[arg(long)]
    no_replay: bool,
    /// Examples in a file
    #[arg(long, value_name = "N", default_value_t = 5_000)]
    rows_per_file: usize,
    /// Of every draw: splits, caps, balance, wordings
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Licence of the data, as the dataset card names it
    #[arg(long, value_name = "NAME", default_value = "other")]
    license: String,
    /// Threads; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}
