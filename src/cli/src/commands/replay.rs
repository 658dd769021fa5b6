//! `reel replay`: re-executes traces and compares everything.

use std::{collections::BTreeMap, path::PathBuf};

use reel_replay::{Verdict, verify_all};

use crate::{Answer, inputs, progress};

/// Re-execute traces from their inputs and compare every digest, picture, text, reward and metric.
/// On a difference it names the call, the physics step, the body and the field, with both values.
///
/// Examples:
///   reel replay traces-out
///   reel replay traces-out/FDP_home_0001--oracle--0.mcap --json
///
/// Exit code 0: all identical; 1: something differs or a trace was refused.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Trace files, or folders of them
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Traces at a time; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print one JSON object a trace
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<Answer> {
    let paths = inputs::traces(&arguments.paths)?;
    let bar = progress::bar(paths.len(), "replay");
    let verdicts = verify_all(&paths, inputs::workers(arguments.jobs), |_, _| bar.inc(1));
    bar.finish_and_clear();
    let mut totals = [0u64; 3];
    for (path, verdict) in paths.iter().zip(&verdicts) {
        if arguments.json {
            let mut line = serde_json::to_value(verdict)?;
            line["trace"] = path.display().to_string().into();
            println!("{line}");
        } else if let Verdict::Exact { calls, physics_steps, pictures } = verdict {
            totals[0] += u64::from(*calls);
            totals[1] += physics_steps;
            totals[2] += u64::from(*pictures);
            if paths.len() == 1 {
                println!("{}: {verdict}", path.display());
            }
        } else {
            println!("{}: {verdict}", path.display());
        }
    }
    let exact = verdicts.iter().filter(|verdict| verdict.is_exact()).count();
    if !arguments.json && paths.len() > 1 {
        let [calls, physics_steps, pictures] = totals;
        println!(
            "{exact} of {} traces replay exactly: {calls} calls, {physics_steps} physics steps, {pictures} pictures",
            paths.len()
        );
        for (kind, count) in kinds(&verdicts) {
            println!("  {kind}: {count}");
        }
    }
    Ok(if exact == paths.len() { Answer::Yes } else { Answer::No })
}

fn kinds(verdicts: &[Verdict]) -> BTreeMap<&'static str, usize> {
    let mut kinds = BTreeMap::new();
    for verdict in verdicts {
        let kind = match verdict {
            Verdict::Exact { .. } => continue,
            Verdict::Diverged { .. } => "diverged",
            Verdict::OtherSimulator { .. } => "recorded by another simulator version",
            Verdict::NotReplayable { .. } => "not replayable",
            Verdict::Refused { .. } => "refused",
        };
        *kinds.entry(kind).or_default() += 1;
    }
    kinds
}
