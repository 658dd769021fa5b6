//! `reel diff`: two traces of one task side by side.

use std::path::PathBuf;

use reel_replay::compare;

use crate::{ExitStatus, inputs};

/// Show two traces of one task side by side, from the first difference on: calls, results,
/// changes of the world graph, reward. Between the columns stands | where the calls differ, ~ where
/// the same call has another result, = where all is the same.
///
/// Examples:
///   reel diff trace.mcap branch.mcap
///   reel diff a.mcap b.mcap --json | jq '.rows[0]'
///
/// Exit code 0: the same episode; 1: they differ; 2: they play different tasks, or cannot be read.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Trace for the left column
    #[arg(value_name = "A")]
    a: PathBuf,
    /// Trace for the right column
    #[arg(value_name = "B")]
    b: PathBuf,
    /// Print the comparison as one JSON object
    #[arg(long)]
    json: bool,
}

/// Compares two traces of one task and prints them side by side.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let files = inputs::trace_files();
    let beside = compare(&files.read(&arguments.a)?, &files.read(&arguments.b)?)?;
    if arguments.json {
        println!("{}", serde_json::to_string(&beside)?);
    } else {
        print!("{}", reel_view::side_by_side(&beside));
    }
    Ok(if beside.is_same() {
        ExitStatus::Success
    } else {
        ExitStatus::CheckFailed
    })
}
