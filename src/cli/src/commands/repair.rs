//! `reel repair`: the smallest change that makes a failed episode succeed.

use std::path::PathBuf;

use anyhow::bail;
use reel_counterfactual::blame::{Edit, Repair, blame, repair};
use reel_trace::Trace;
use serde_json::{Value, json};

use crate::{ExitStatus, inputs};

/// Find the smallest change of a failed episode's calls that makes it succeed: calls inserted,
/// replaced or deleted from the decisive step on, by search over branches. Every one of the
/// changes is necessary. The result is a trace, a branch of the failed one. A smallest change may
/// need what the agent could not know at that moment (a lucky pick among several that fit); then
/// reel says which call takes what for known. For training pairs use `reel export preferences`,
/// whose choices need no such knowledge.
///
/// Examples:
///   reel repair trace.mcap                          # writes trace--repaired.mcap here
///   reel repair trace.mcap --out better.mcap --json
///   reel diff trace.mcap trace--repaired.mcap
///
/// Exit code 1: the episode succeeded, or nothing makes it succeed.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The trace of a failed episode
    #[arg(value_name = "TRACE")]
    trace: PathBuf,
    /// The trace to write; without it TRACE--repaired.mcap in this folder
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    assets: inputs::Assets,
    /// Print JSON: the edits, the calls, and what they take for known
    #[arg(long)]
    json: bool,
}

/// Repairs a failed episode, writes the new trace and prints the edits.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let trace = arguments
        .assets
        .read(&inputs::trace_files(), &arguments.trace)?;
    let found = blame(&trace);
    let Some(decisive) = &found.decisive else {
        eprintln!(
            "reel: nothing to repair: the episode did not fail, or nothing was lost in it: {}",
            trace.path.display()
        );
        return Ok(ExitStatus::CheckFailed);
    };
    let stem = reel_trace::trace_stem(&trace.path);
    let out = arguments
        .out
        .clone()
        .unwrap_or_else(|| PathBuf::from(format!("{stem}--repaired.mcap")));
    if out.exists() && trace.path.exists() && out.canonicalize()? == trace.path.canonicalize()? {
        bail!(
            "{} is the failed episode; give the repaired one another name",
            out.display()
        );
    }
    let repaired = match repair(&trace, decisive, Some(&out))? {
        Ok(repaired) => repaired,
        Err(why) => {
            eprintln!("reel: cannot be repaired: {why}: {}", trace.path.display());
            return Ok(ExitStatus::CheckFailed);
        }
    };
    if arguments.json {
        println!("{}", in_json(&trace, &repaired));
        return Ok(ExitStatus::Success);
    }
    println!(
        "{}: {} change(s), found with {} branches",
        trace.path.display(),
        repaired.edits.len(),
        repaired.tried
    );
    let old = |at: usize| trace.steps[at].input.call.to_string();
    for edit in &repaired.edits {
        match edit {
            Edit::Replace { at, call } => println!("  call {at:>2}  {}  ->  {call}", old(*at)),
            Edit::Insert { before, call } => println!("  before {before:>2}  {call}"),
            Edit::Delete { at } => println!("  call {at:>2}  without {}", old(*at)),
        }
    }
    for presumed in &repaired.presumed {
        println!(
            "  unknown  call {:>2}  {} needs to know {}",
            presumed.at, presumed.call, presumed.knowledge
        );
    }
    let verdict = if repaired.verified {
        "replays exactly"
    } else {
        "DOES NOT REPLAY EXACTLY"
    };
    println!("trace: {}: {verdict}", out.display());
    Ok(ExitStatus::Success)
}

fn in_json(trace: &Trace, repaired: &Repair) -> Value {
    let mut line = json!(repaired);
    line["parent"] = json!(trace.path);
    line
}
