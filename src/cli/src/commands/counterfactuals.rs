//! `reel counterfactuals`: what the plausible other calls of every step would have come to.

use std::path::PathBuf;

use reel_counterfactual::plausible::{PlayedCall, PlayedOutcome, play_all};
#[cfg(feature = "analytics")]
use reel_tables::CounterfactualRow;
use reel_trace::Trace;
use serde_json::{Value, json};

use crate::{ExitStatus, inputs, progress};

/// Episodes whose rows go into the store at a time: what a stopped command has played before stays.
#[cfg(feature = "analytics")]
const EPISODES_AT_ONCE: usize = 16;

/// Play what one other call would have changed: at every step of an episode the calls that an agent
/// might have made instead (what a competent agent would call, its question where several things fit,
/// other markers in view, other receptacles of the same category), once with the recorded calls after
/// it, and, where these fail, once with a competent agent. Nothing is predicted: every outcome was
/// played in the simulator.
///
/// Examples:
///   reel counterfactuals traces-out/episode.mcap
///   reel counterfactuals --store store              # every failed episode; rows go into table `counterfactuals`
///   reel counterfactuals --store store traces-out/episode.mcap
///   reel query --store store "SELECT tool, origin, count(*) FROM counterfactuals WHERE with_recorded_success GROUP BY ALL"
///   reel branch episode.mcap --at 7 --call '{"name": "pick", "arguments": {"marker_id": 3}}' --then parent   # keep one
///
/// Exit code 0: every trace was played; 1: some were not (3 with --store); 2: wrong usage.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Trace files, or folders of them; with --store and without paths its failed episodes
    #[arg(value_name = "PATH", required_unless_present_any = inputs::INSTEAD_OF_PATHS)]
    paths: Vec<PathBuf>,
    #[command(flatten)]
    assets: inputs::Assets,
    /// Keep the outcomes in table `counterfactuals` of this store
    #[cfg(feature = "analytics")]
    #[arg(long, value_name = "STORE")]
    store: Option<String>,
    /// Calls played at a time; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print the episodes with all outcomes as JSON, one a line
    #[arg(long)]
    json: bool,
}

/// Plays the plausible calls of the episodes, prints and stores what came of them.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let files = arguments.assets.trace_files()?;
    #[cfg(feature = "analytics")]
    let mut store = (arguments.store.as_ref())
        .map(|store| arguments.assets.store(store, None))
        .transpose()?;
    #[cfg(feature = "analytics")]
    let paths = match &store {
        Some(store) if arguments.paths.is_empty() => store
            .failed_traces()?
            .into_iter()
            .map(PathBuf::from)
            .collect(),
        _ => inputs::traces(&files, &arguments.paths)?,
    };
    #[cfg(not(feature = "analytics"))]
    let paths = inputs::traces(&files, &arguments.paths)?;
    let workers = inputs::workers(arguments.jobs);
    let mut unreadable = false;
    #[cfg(feature = "analytics")]
    let mut unwritten: Vec<(String, Vec<CounterfactualRow>)> = Vec::new();
    for path in &paths {
        let played = files
            .read(path)
            .map_err(anyhow::Error::from)
            .and_then(|trace| Ok((played(&trace, workers)?, trace)));
        let (calls, trace) = match played {
            Ok(played) => played,
            Err(reason) => {
                eprintln!("reel: {reason:#}");
                unreadable = true;
                continue;
            }
        };
        if arguments.json {
            println!("{}", as_json(&trace, &calls));
        } else {
            print(&trace, &calls);
        }
        #[cfg(feature = "analytics")]
        if let Some(store) = &mut store {
            unwritten.push((trace.header.episode_id.clone(), rows(&trace, &calls)?));
            if unwritten.len() == EPISODES_AT_ONCE {
                keep(store, &mut unwritten)?;
            }
        }
    }
    #[cfg(feature = "analytics")]
    if let Some(store) = &mut store {
        keep(store, &mut unwritten)?;
        if !arguments.json {
            println!("kept in table `counterfactuals` of {}", store.location());
        }
        if unreadable {
            return Ok(ExitStatus::Partial);
        }
    }
    Ok(match unreadable {
        true => ExitStatus::CheckFailed,
        false => ExitStatus::Success,
    })
}

fn played(trace: &Trace, workers: usize) -> anyhow::Result<Vec<PlayedCall>> {
    let bar = progress::bar(0, &trace.header.task_id);
    let calls = play_all(
        trace,
        workers,
        |calls| bar.set_length(calls as u64),
        || bar.inc(1),
    );
    bar.finish_and_clear();
    Ok(calls?)
}

fn as_json(trace: &Trace, calls: &[PlayedCall]) -> Value {
    json!({
        "trace": trace.path, "episode_id": trace.header.episode_id, "trace_digest": trace.chain(),
        "success": trace.end.as_ref().map(|end| end.metrics.success),
        "completion": trace.end.as_ref().map(|end| end.metrics.completion),
        "steps": trace.steps.len(), "counterfactuals": calls,
    })
}

/// What rescues the episode, step by step; calls that change nothing are only counted.
fn print(trace: &Trace, calls: &[PlayedCall]) {
    let success = trace.end.as_ref().map(|end| end.metrics.success);
    let said = match success {
        Some(true) => "success",
        Some(false) => "failure",
        None => "not ended",
    };
    let header = &trace.header;
    println!(
        "{}  {}  {said}, {} steps",
        header.episode_id,
        header.task_id,
        trace.steps.len()
    );
    let planned = |one: &&PlayedCall| one.with_planner.is_some_and(|then| then.success);
    for one in calls
        .iter()
        .filter(|one| one.with_recorded.success || planned(one))
    {
        let then = match one.with_recorded.success {
            true => "the recorded calls then succeed".to_owned(),
            false => one.with_planner.map_or_else(String::new, planner_succeeds),
        };
        let plausible = &one.plausible;
        println!(
            "  step {:>3}  {}  ({}): {then}",
            plausible.step,
            plausible.call,
            plausible.origin.name()
        );
    }
    let alone = calls.iter().filter(|one| one.with_recorded.success).count();
    println!(
        "  {} calls played: {alone} rescue it alone, {} with a competent agent after them",
        calls.len(),
        calls.iter().filter(planned).count()
    );
}

fn planner_succeeds(then: PlayedOutcome) -> String {
    format!(
        "a competent agent then succeeds, {} decisions in all",
        then.length
    )
}

#[cfg(feature = "analytics")]
fn keep(
    store: &mut reel_tables::Store,
    unwritten: &mut Vec<(String, Vec<CounterfactualRow>)>,
) -> anyhow::Result<()> {
    let (episodes, rows): (Vec<String>, Vec<Vec<CounterfactualRow>>) = unwritten.drain(..).unzip();
    store.put_counterfactuals(&episodes, &rows.concat())?;
    Ok(())
}

#[cfg(feature = "analytics")]
fn rows(trace: &Trace, calls: &[PlayedCall]) -> anyhow::Result<Vec<CounterfactualRow>> {
    let small = |number: u32| i32::try_from(number).unwrap_or(i32::MAX);
    let row = |one: &PlayedCall| {
        let PlayedCall {
            plausible,
            with_recorded,
            with_planner,
        } = one;
        Ok(CounterfactualRow {
            episode_id: trace.header.episode_id.clone(),
            trace_digest: trace.chain().to_string(),
            step: small(plausible.step),
            call: serde_json::to_string(&plausible.call)?,
            tool: plausible.call.name.clone(),
            origin: plausible.origin.name().to_owned(),
            with_recorded_success: with_recorded.success,
            with_recorded_completion: with_recorded.completion,
            with_planner_success: with_planner.map(|then| then.success),
            with_planner_completion: with_planner.map(|then| then.completion),
            with_planner_length: with_planner.map(|then| small(then.length)),
        })
    };
    calls.iter().map(row).collect()
}
