//! `reel dev mint`: writes a corpus of golden traces anew, for a reason.

use std::path::PathBuf;

use reel_replay::{MintOptions, mint};

use crate::ExitStatus;

/// Execute the inputs of every trace of a corpus with this simulator, write them anew
/// without images, and note the reason in the corpus' NOTES.md. Traces of another
/// simulator move to v<N>/. A trace of this simulator's number that gives something else is
/// refused: raise SIM_VERSION first.
///
/// Examples:
///   reel dev mint --corpus traces/golden --reason "doors close softly now: damping 2 instead of 1"
///   reel dev mint --corpus traces/golden --reason "an object that rolls" --add traces-out/FDP_home_0001--oracle--0.mcap
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Folder of the golden traces
    #[arg(long, value_name = "DIR")]
    corpus: PathBuf,
    /// What changed and why, for those who wonder later
    #[arg(long, value_name = "TEXT")]
    reason: String,
    /// Traces to take in; each must replay exactly
    #[arg(long, value_name = "TRACE", num_args = 1..)]
    add: Vec<PathBuf>,
}

/// Re-executes the traces of a corpus, rewrites them and prints what changed.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let minted = mint(&MintOptions {
        corpus: &arguments.corpus,
        reason: &arguments.reason,
        add: &arguments.add,
    })?;
    for trace in minted
        .traces
        .iter()
        .filter(|trace| trace.added || trace.rewritten)
    {
        println!(
            "{}: {}",
            trace.name.display(),
            if trace.added {
                "added".to_owned()
            } else {
                trace.changes.to_string()
            }
        );
    }
    let (all, added, rewritten) = (
        minted.traces.len(),
        minted.added(),
        minted.rewritten().count(),
    );
    println!(
        "simulator {}: {all} traces, {added} added, {rewritten} rewritten",
        minted.sim_version
    );
    Ok(ExitStatus::Success)
}
