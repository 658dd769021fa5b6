//! `reel trace recover`: restores what unfinished, torn or damaged recordings hold.

use std::{collections::BTreeMap, fs, path::PathBuf};

use anyhow::Context;
use reel_live::restore;
use reel_trace::{Recovery, RecoveryStatus, TraceError};

use crate::{ExitStatus, inputs, progress};

/// Restore every whole step of recordings that were killed, ran into a full disk, or were truncated
/// or damaged later, and write finished traces. An episode without an end ends as aborted.
///
/// `x.mcap.part` becomes `x.mcap`, a truncated `x.mcap` becomes `x.recovered.mcap`; an existing
/// file is never replaced. The recording stays, unless it is a part and the trace holds all of it.
///
/// Examples:
///   reel trace recover traces-out
///   reel trace recover traces-out/FDP_home_0001--oracle--0.mcap.part --json
///   reel trace recover damaged --out restored
///
/// Exit code 0: nothing was lost, or an earlier run has said what; 3: something was lost and is named; 2: a
/// recording could not be read or written at all.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Recordings (.mcap.part or .mcap), or folders of them
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Folder for the recovered traces, instead of beside the recordings; nothing is deleted then
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object per recording
    #[arg(long)]
    json: bool,
}

/// Restores the given recordings and prints what each gave and lost.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let paths = inputs::recordings(&arguments.paths)?;
    if let Some(out) = &arguments.out {
        fs::create_dir_all(out)
            .with_context(|| format!("cannot make the folder {}", out.display()))?;
    }
    let bar = progress::bar(paths.len(), "recover");
    let results: Vec<Result<Recovery, TraceError>> = paths
        .iter()
        .map(|path| {
            let result = restore(path, arguments.out.as_deref());
            bar.inc(1);
            result
        })
        .collect();
    bar.finish_and_clear();
    let mut failed = 0;
    let mut recoveries = Vec::new();
    for result in results {
        match result {
            Ok(recovery) => recoveries.push(recovery),
            Err(error) => {
                failed += 1;
                eprintln!("reel: {error}");
            }
        }
    }
    for recovery in &recoveries {
        if arguments.json {
            println!("{}", serde_json::to_string(recovery)?);
        } else if recovery.restored != RecoveryStatus::NotNeeded || paths.len() == 1 {
            print!("{}", text(recovery));
        }
    }
    let lossy = recoveries
        .iter()
        .filter(|recovery| !recovery.lost.is_empty() && !recovery.reported)
        .count();
    if !arguments.json && paths.len() > 1 {
        println!("{}", summary(&recoveries, lossy));
    }
    Ok(if failed > 0 {
        ExitStatus::BadInput
    } else if lossy > 0 {
        ExitStatus::Partial
    } else {
        ExitStatus::Success
    })
}

fn text(recovery: &Recovery) -> String {
    let (source, trace, steps) = (
        recovery.source.display(),
        recovery.trace.display(),
        recovery.steps,
    );
    let end = if recovery.end_recorded {
        "with its end"
    } else {
        "ends as aborted"
    };
    let mut text = match recovery.restored {
        RecoveryStatus::NotNeeded => format!("{source}: whole, nothing to recover\n"),
        RecoveryStatus::Written => format!("{source}: {steps} steps restored, {end}: {trace}\n"),
        RecoveryStatus::Before => format!("{source}: its {steps} steps are already in {trace}\n"),
        RecoveryStatus::Nothing => format!("{source}: nothing can be restored; {trace} says so\n"),
    };
    let when = if recovery.reported {
        "lost before"
    } else {
        "lost"
    };
    for lost in &recovery.lost {
        text.push_str(&format!("  {when}: {lost}\n"));
    }
    if recovery.reported {
        text.push_str(
            "  the trace says so, too: delete the recording when nobody wants to look at it\n",
        );
    }
    // Where something was lost, that says why.
    for problem in recovery
        .problems
        .iter()
        .filter(|_| recovery.lost.is_empty())
    {
        text.push_str(&format!("  was wrong: {problem}\n"));
    }
    if recovery.source_deleted {
        text.push_str(&format!(
            "  {source} is deleted, the trace holds all of it\n"
        ));
    }
    text
}

fn summary(recoveries: &[Recovery], lossy: usize) -> String {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for recovery in recoveries {
        let what = match recovery.restored {
            RecoveryStatus::NotNeeded => "whole",
            RecoveryStatus::Written => "restored",
            RecoveryStatus::Before => "restored before",
            RecoveryStatus::Nothing => "with nothing to restore",
        };
        *counts.entry(what).or_default() += 1;
    }
    let counts: Vec<String> = counts
        .iter()
        .map(|(what, count)| format!("{count} {what}"))
        .collect();
    format!(
        "{} recordings: {}; {lossy} lost something",
        recoveries.len(),
        counts.join(", ")
    )
}
