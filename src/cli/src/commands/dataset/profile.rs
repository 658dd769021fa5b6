//! `reel dataset profile`: what is in a set of any origin.

use std::path::PathBuf;

use reel_data_profile::{ProfileOptions, Table, profile};

use crate::{ExitStatus, progress};

/// Describe the columns of Parquet and JSON files of any origin: types, missing and distinct
/// values, distributions of numbers and lengths, frequent values, repeated rows, balance of
/// classes, and turns, answers and images of conversations.
///
/// JSON is one object a line or one list of objects; gzip and zstd are unpacked. Structs are laid
/// flat, with names joined by dots. A number after ~ is an estimate (distinct values beyond
/// 20,000), one after >= a lower bound.
///
/// Examples:
///   reel dataset profile sft
///   reel dataset profile 'data/train-*.parquet' --key id --by source
///   reel dataset profile rows.jsonl --json
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Files, folders or patterns of one set
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Columns that should name a row once; rows that repeat them are counted
    #[arg(long, value_name = "COLUMN", value_delimiter = ',')]
    key: Vec<String>,
    /// Columns whose values are classes; the rows of each class are counted
    #[arg(long, value_name = "COLUMN", value_delimiter = ',')]
    by: Vec<String>,
    /// Frequent values shown of each column
    #[arg(long, value_name = "N", default_value_t = 3)]
    top: usize,
    /// Print the profile as one JSON object
    #[arg(long)]
    json: bool,
}

/// Profiles a set and prints what it holds.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let options = ProfileOptions {
        keys: arguments.key.clone(),
        by: arguments.by.clone(),
        top: arguments.top,
    };
    let spinner = progress::spinner();
    spinner.set_message("reading");
    let profile = Table::open(&arguments.paths).and_then(|table| profile(&table, &options));
    spinner.finish_and_clear();
    let profile = profile?;
    if arguments.json {
        println!("{}", serde_json::to_string(&profile)?);
    } else {
        print!("{profile}");
    }
    Ok(ExitStatus::Success)
}
