//! `reel show`: a trace as a readable transcript.

use std::path::PathBuf;

use anyhow::Context;
use reel_trace::Trace;
use serde_json::json;

use crate::Answer;

/// Print a trace as a readable transcript: calls, outcomes, graph changes, reward.
///
/// Examples:
///   reel show traces-out/FDP_home_0001--oracle--0.mcap
///   reel show trace.mcap --json | jq '.steps[].outcome.text'
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The trace
    #[arg(value_name = "TRACE")]
    trace: PathBuf,
    /// Print header, steps and end as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<Answer> {
    let (trace, lost) = Trace::read_partial(&arguments.trace).context("cannot show the trace")?;
    if arguments.json {
        let whole = json!({ "header": trace.header, "task": trace.task, "scene": trace.scene, "start": trace.start, "steps": trace.steps, "end": trace.end });
        println!("{whole}");
    } else {
        print!("{}", reel_view::transcript(&trace));
    }
    if let Some(lost) = lost {
        eprintln!("reel: {}: {lost}", arguments.trace.display());
        return Ok(Answer::Loss);
    }
    Ok(Answer::Yes)
}
