//! `reel diff`: two traces of one task side by side, or two runs of the same tasks.

mod runs;

use std::path::PathBuf;

use reel_replay::compare;

use crate::{ExitStatus, inputs};

pub use runs::Summary;

/// Show two traces of one task side by side, from the first difference on: calls, results,
/// changes of the world graph, reward. Between the columns stands | where the calls differ, ~ where
/// the same call has another result, = where all is the same.
///
/// Of two runs (folders of traces; with --store policies or runs of the store) it pairs the episodes
/// by task and seed and says why one run fails where the other succeeds: for each flip the first
/// call that differs, the class of the failure and the decisive call, grouped by class change.
///
/// Examples:
///   reel diff trace.mcap branch.mcap
///   reel diff a.mcap b.mcap --json | jq '.rows[0]'
///   reel diff traces-old traces-new            # why did it regress?
///   reel diff bench/old bench/new --examples 1
///   reel diff --store store planner wrong-object
///
/// Exit code 0: the same episode, or no flip; 1: they differ; 2: they play different tasks, or cannot be read.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Trace for the left column, or the first run
    #[arg(value_name = "A")]
    a: PathBuf,
    /// Trace for the right column, or the second run
    #[arg(value_name = "B")]
    b: PathBuf,
    /// A and B are policies or runs (`run_id`) of this store; classes are those of its table
    /// `classes`
    #[cfg(feature = "analytics")]
    #[arg(long, value_name = "STORE")]
    store: Option<String>,
    /// Of two runs: examples of each class change
    #[arg(long, value_name = "N", default_value_t = 3)]
    examples: usize,
    /// Print the comparison as one JSON object
    #[arg(long)]
    json: bool,
}

/// Compares two traces of one task, or two runs, and prints the result.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    #[cfg(feature = "analytics")]
    if let Some(store) = &arguments.store {
        return runs::compare_in_store(store, arguments);
    }
    if arguments.a.is_dir() || arguments.b.is_dir() {
        return runs::compare_folders(arguments);
    }
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
