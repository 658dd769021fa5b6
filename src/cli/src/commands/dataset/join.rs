//! `reel dataset join`: two sets into one file, by equal keys.

use std::path::PathBuf;

use reel_data_profile::{JoinHow, JoinOptions, join};

use crate::{ExitStatus, commands::dataset::diff::open_pair, progress};

/// Join two sets by equal keys into a new file, and tell how many rows and keys did not match.
///
/// Rows keep the order of LEFT. RIGHT is held in memory in parts of 256 MiB of files, so name the
/// larger set first. Rows without a key match nothing. The output appears when it is whole, and an
/// existing file is not replaced.
///
/// Examples:
///   reel dataset join sft labels.jsonl --on episode_id,call --how left --out labelled.parquet
///   reel dataset join train.parquet test.parquet --on prompt --how semi --out leaked.jsonl
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// File, folder or pattern of the set whose rows are kept in order
    #[arg(value_name = "LEFT")]
    left: PathBuf,
    /// File, folder or pattern of the set that is joined to it
    #[arg(value_name = "RIGHT")]
    right: PathBuf,
    /// Columns that both sets have and whose values have to be equal
    #[arg(long, required = true, value_name = "KEY", value_delimiter = ',')]
    on: Vec<String>,
    /// The rows to keep: inner (pairs), left (all of LEFT), semi (of LEFT, with a match),
    /// anti (of LEFT, without one)
    #[arg(long, value_name = "HOW", default_value = "inner", value_parser = how)]
    how: JoinHow,
    /// The file to write: .parquet or .jsonl
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Print the counts as one JSON object
    #[arg(long)]
    json: bool,
}

fn how(name: &str) -> Result<JoinHow, String> {
    match name {
        "inner" => Ok(JoinHow::Inner),
        "left" => Ok(JoinHow::Left),
        "semi" => Ok(JoinHow::Semi),
        "anti" => Ok(JoinHow::Anti),
        _ => Err("there are inner, left, semi and anti".to_owned()),
    }
}

/// Joins two sets and prints the counts.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let options = JoinOptions {
        on: arguments.on.clone(),
        how: arguments.how,
        out: arguments.out.clone(),
    };
    let spinner = progress::spinner();
    spinner.set_message("joining");
    let report = open_pair(&arguments.left, &arguments.right)
        .and_then(|(left, right)| join(&left, &right, &options));
    spinner.finish_and_clear();
    let report = report?;
    if arguments.json {
        println!("{}", serde_json::to_string(&report)?);
    } else {
        print!("{report}");
    }
    Ok(ExitStatus::Success)
}
